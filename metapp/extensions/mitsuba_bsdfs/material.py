"""The parameters of a BRDF's network that Mitsuba evaluates: of a fit's file, or of an NBRDF folder."""

from __future__ import annotations

from pathlib import Path

import torch
from safetensors import SafetensorError

from data_tools.readers.nbrdf import read_nbrdf
from metapp.apps import app_of, recipes_of
from metapp.apps.brdf.network import shapes_of
from metapp.learning.task import Params
from metapp.storage.files import read_tensors


def read_parameters(path: Path) -> Params:
    """The parameters of a BRDF's network, without a task axis: of a fit's .safetensors file, or of an NBRDF folder.

    Raises:
        ValueError: there is none, or it is damaged.
    """
    if not path.is_file():
        parts = {part: torch.from_numpy(array) for part, array in read_nbrdf(path).items()}
        weights = {f"w{layer}": parts[f"fc{layer}"].T for layer in (1, 2, 3)}
        return weights | {f"b{layer}": parts[f"b{layer}"][:, None] for layer in (1, 2, 3)}
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
