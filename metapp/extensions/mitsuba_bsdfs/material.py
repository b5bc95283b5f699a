"""A BRDF as a network that Mitsuba evaluates: of a fit's file, or of an NBRDF folder."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError
from torch import Tensor

from data_tools.readers.nbrdf import read_nbrdf
from metapp.apps import app_of, recipes_of
from metapp.apps.brdf.network import network_of, shapes_of
from metapp.learning.task import Params
from metapp.storage.files import read_tensors


class Material(NamedTuple):
    """A BRDF as a network of two hidden layers.

    Attributes:
        layers: weights [out, in] and biases [out] of each of the three, float32.
        featured: whether it reads `metapp.apps.brdf.featured.inputs_of`, with hidden layers x sigmoid(x); else half
            and difference vector, with ReLU.
        reflectance: linear RGB [..., 3] in 1/sr, >= 0, of angles (theta_h, theta_d, phi_d) [..., 3] in rad; of an
            anisotropic one also phi_h, [..., 4].
        turn: azimuth of the axes in rad of an anisotropic one, which reads `metapp.apps.brdf.anisotropic.inputs_of`.
        darkest: what it ends at is log(f cos theta_i cos theta_o + darkest), with that product at least this; 0: it is
            log(1 + f).
    """

    layers: tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]
    featured: bool
    reflectance: Callable[[Tensor], Tensor]
    turn: float | None = None
    darkest: float = 0.0


def read_material(path: Path) -> Material:
    """Read the network of a BRDF: a fit's .safetensors file, or an NBRDF folder.

    Raises:
        ValueError: there is none, or it is damaged.
    """
    theta = _parameters(path) if path.is_file() else _from_nbrdf(path)
    network = network_of(theta)
    folded = network.folded(theta)
    layers = tuple((weights.float().numpy(), bias.float().numpy()) for weights, bias in folded.layers)
    evaluate = functools.partial(network.evaluate, theta)
    return Material(layers, folded.inputs != "nbrdf", evaluate, folded.turn, folded.darkest)


def _parameters(path: Path) -> Params:
    try:
        theta = read_tensors(path)
    except (SafetensorError, OSError) as error:
        raise ValueError(f"{path}: not readable ({error}), expected the .safetensors file of a BRDF fit.") from None
    shapes = {key: value.shape for key, value in theta.items()}
    recipes = recipes_of("brdf").values()
    networks = {app_of("brdf", recipe, rule=rule).network for recipe in recipes for rule in recipe.meta}
    if shapes not in [shapes_of(network) for network in networks]:
        names = ", ".join(sorted(theta)) or "none"
        raise ValueError(f"{path}: tensors {names[:80]}, expected those of a BRDF fit; take its params.safetensors.")
    if not all(bool(value.isfinite().all()) for value in theta.values()):
        raise ValueError(f"{path}: NaN or infinite values, expected finite parameters; fit again.")
    return theta


def _from_nbrdf(path: Path) -> Params:
    parts = {part: torch.from_numpy(array) for part, array in read_nbrdf(path).items()}
    weights = {f"w{layer}": parts[f"fc{layer}"].T for layer in (1, 2, 3)}
    return weights | {f"b{layer}": parts[f"b{layer}"][:, None] for layer in (1, 2, 3)}
