"""Plugins for Mitsuba 3: `import metapp.mitsuba`, before or after `mi.set_variant`, and scenes may name them.

    {"type": "neural_brdf", "filename": "gold.safetensors"}
    {"type": "neural_svbrdf", "diffuse": TEXTURE, "specular": TEXTURE, "roughness": TEXTURE}
    {"type": "metapp_guided_path", "max_depth": 8}

The last is an integrator, of an extension: Mitsuba's `path` with path guiding that it learns while it renders; see
`metapp.extensions.guided.integrator`. It is `guided_path`, too, unless a scene means that of Mueller et al. 2017.

In XML: `<bsdf type="neural_brdf"><string name="filename" value="gold.safetensors"/></bsdf>`. The file is a fit of the
BRDF application (`params/<task>.safetensors` of a run, or `Fit.save`), of any of its networks, or a folder with an
NBRDF network of six .npy files. Variants: llvm_ad_rgb, cuda_ad_rgb.

Import it before mitsuba where an old libLLVM is installed beside one that works: mitsuba keeps what it finds first.
"""

from __future__ import annotations

import functools
from pathlib import Path

import torch
from safetensors import SafetensorError

from data_tools.readers.nbrdf import read_nbrdf
from metapp import door
from metapp.apps import app_of, recipes_of
from metapp.apps.brdf.networks import network_of
from metapp.learning.task import Params
from metapp.rendering.bsdfs.neural_brdf import Material, register_neural_brdf
from metapp.rendering.bsdfs.neural_svbrdf import register_maps_bsdf
from metapp.storage.tensors import read_tensors


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
    networks = {app_of("brdf", recipe, rule=rule).setup for recipe in recipes for rule in recipe.meta}
    if shapes not in [network.shapes for network in networks]:
        found = ", ".join(sorted(theta)) or "none"
        raise ValueError(f"{path}: tensors {found[:80]}, expected those of a BRDF fit; take a file of its params/.")
    if not all(bool(value.isfinite().all()) for value in theta.values()):
        raise ValueError(f"{path}: NaN or infinite values, expected finite parameters; fit again.")
    return theta


def _from_nbrdf(path: Path) -> Params:
    parts = {part: torch.from_numpy(array) for part, array in read_nbrdf(path).items()}
    weights = {f"w{layer}": parts[f"fc{layer}"].T for layer in (1, 2, 3)}
    return weights | {f"b{layer}": parts[f"b{layer}"][:, None] for layer in (1, 2, 3)}


register_neural_brdf(read_material)
register_maps_bsdf()
for plugin in door.offers(door.Plugin):
    door.load(plugin.register)()
