"""Synthetic anisotropic BRDFs: metals, plastics, brushed metals, cloths, each laid down at a random azimuth.

Like the isotropic materials of `data_tools.synthetic.brdf` they are reciprocal, non-negative and reflect no more than
they receive. The test split has two families that the training split lacks: Ashikhmin and Shirley's metals, and
inclined fibres.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from data_tools.synthetic.brdf_anisotropic_models import (
    AnisotropicModel,
    Roughness,
    anisotropic_mixture,
    ashikhmin,
    brushed_grooves,
    facets,
    fibres,
    ward,
)
from data_tools.synthetic.brdf_draws import COUNTS, Draws, SyntheticBrdf, colour_name
from data_tools.synthetic.brdf_models import CONDUCTORS, Rgb
from data_tools.synthetic.interfaces import fresnel_conductor
from data_tools.synthetic.random_values import Split
from metapp.appearance.geometry import rotate_about_normal, rusinkiewicz_to_directions
from metapp.appearance.reflection import fresnel_schlick

FIRST_ANISOTROPIC_FAMILY_KEY = (
    100  # the first number of a family among the keys of draws; isotropic families stay below it
)


def _diffuse(albedo: Rgb) -> AnisotropicModel:
    """Return Lambert's model with a linear RGB albedo."""
    return lambda wi, wo: wi.new_tensor(albedo).div(math.pi).expand(*wi.shape[:-1], 3)


def _roughness(draw: Draws, narrowest: float, widest: float, ratio: tuple[float, float]) -> Roughness:
    """Draw roughnesses along and across a surface's grooves.

    The narrower one is spread evenly over its logarithm, from `narrowest` to `widest`; the wider one is larger by a
    factor from `ratio`, and at most 0.8.
    """
    low, high = ratio
    narrower = draw.alpha(narrowest, widest)
    return Roughness(min(0.8, narrower * low * (high / low) ** draw.between(0, 1)), narrower)


def _fresnel(draw: Draws) -> tuple[str, Callable[[Tensor], Tensor]]:
    """Draw the name and the Fresnel reflectance of a metal from `CONDUCTORS`, or of a metal of any colour."""
    if draw.chance(0.5):
        metal = list(CONDUCTORS)[int(draw.hue * len(CONDUCTORS))]
        eta, k = CONDUCTORS[metal]
        return metal, lambda cos: fresnel_conductor(cos, cos.new_tensor(eta), cos.new_tensor(k))
    colour = draw.colour(0.2, 0.95)
    return colour_name(colour), lambda cos: fresnel_schlick(cos, cos.new_tensor(colour))


def _draw_metal(draw: Draws) -> tuple[str, AnisotropicModel]:
    """Draw a metal whose facets are rougher in one direction than in the other."""
    name, fresnel = _fresnel(draw)
    return name, facets(_roughness(draw, 0.03, 0.25, (1.4, 10)), fresnel, draw.kind())


def _draw_plastic(draw: Draws) -> tuple[str, AnisotropicModel]:
    """Draw a diffuse body under an anisotropic coat."""
    colour = draw.colour()
    f0 = draw.between(0.03, 0.12)
    roughness, kind = _roughness(draw, 0.04, 0.25, (1.4, 8)), draw.kind()
    coat = facets(roughness, lambda cos: fresnel_schlick(cos, f0).expand(*cos.shape[:-1], 3), kind)
    body = _diffuse(colour)

    def model(wi: Tensor, wo: Tensor) -> Tensor:
        transmittance = (1 - fresnel_schlick(wi[..., 2:], f0)) * (1 - fresnel_schlick(wo[..., 2:], f0))
        return coat(wi, wo) + 0.9 * transmittance * body(wi, wo)

    return colour_name(colour), model


def _draw_ward(draw: Draws) -> tuple[str, AnisotropicModel]:
    """Draw Ward's lobe beside a diffuse material."""
    colour = draw.colour(0.05, 0.9)
    share = draw.between(0.2, 0.95)
    lobe = ward(_roughness(draw, 0.04, 0.25, (1.4, 8)), draw.colour(0.3, 0.95, (0.05, 0.5)))
    return colour_name(colour), anisotropic_mixture((share, lobe), (1 - share, _diffuse(colour)))


def _draw_brushed(draw: Draws) -> tuple[str, AnisotropicModel]:
    """Draw a brushed metal, whose grooves spread about one azimuth."""
    name, fresnel = _fresnel(draw)
    roughness = _roughness(draw, 0.03, 0.12, (4, 14))
    spread = draw.between(0.03, 0.35)
    return name, brushed_grooves(roughness, spread, fresnel, draw.kind())


def _draw_cloth(draw: Draws) -> tuple[str, AnisotropicModel]:
    """Draw a cloth of two crossing threads and a diffuse part."""
    lobes = []
    colour = draw.colour(0.1, 0.9)
    for turn in (0.0, math.pi / 2):
        tint = colour if turn == 0 or draw.chance(0.5) else draw.colour(0.1, 0.9)
        tint = (0.2 + 0.8 * tint[0], 0.2 + 0.8 * tint[1], 0.2 + 0.8 * tint[2])
        roughness = Roughness(draw.between(0.3, 0.8), draw.between(0.06, 0.3))
        thread = facets(roughness, lambda cos, tint=tint: fresnel_schlick(cos, cos.new_tensor(tint)), "beckmann")  # type: ignore[misc]
        lobes.append((draw.between(0.1, 0.4), rotate_model(thread, turn)))
    return colour_name(colour), anisotropic_mixture(*lobes, (1 - sum(share for share, _ in lobes), _diffuse(colour)))


def _draw_ashikhmin(draw: Draws) -> tuple[str, AnisotropicModel]:
    """Draw Ashikhmin and Shirley's lobe beside a diffuse material."""
    colour, (across, along) = draw.colour(0.3, 0.9), _roughness(draw, 0.05, 0.2, (1.5, 8))
    share = draw.between(0.4, 1.0)
    lobe = ashikhmin((2 / along**2, 2 / across**2), colour)
    return colour_name(colour), anisotropic_mixture((share, lobe), (1 - share, _diffuse(draw.colour(0.05, 0.6))))


def _draw_fibres(draw: Draws) -> tuple[str, AnisotropicModel]:
    """Draw inclined fibres beside a diffuse material."""
    colour = draw.colour(0.1, 0.8)
    lobe = fibres(draw.between(0.08, 0.35), draw.between(0, 0.2), draw.colour(0.4, 0.9, (0.05, 0.5)))
    share = draw.between(0.3, 0.8)
    return colour_name(colour), anisotropic_mixture((share, lobe), (1 - share, _diffuse(colour)))


def rotate_model(model: AnisotropicModel, angle_rad: float) -> AnisotropicModel:
    """Return a model turned about the surface normal."""

    def rotated_model(wi: Tensor, wo: Tensor) -> Tensor:
        back_rad = wi.new_tensor(-angle_rad).expand(wi.shape[:-1])
        return model(rotate_about_normal(wi, back_rad), rotate_about_normal(wo, back_rad))

    return rotated_model


_FAMILIES: dict[str, Callable[[Draws], tuple[str, AnisotropicModel]]] = {
    "metal": _draw_metal,
    "brushed": _draw_brushed,
    "cloth": _draw_cloth,
    "ward": _draw_ward,
    "plastic": _draw_plastic,
    "ashikhmin": _draw_ashikhmin,
    "fibres": _draw_fibres,
}
TEST_ONLY_FAMILIES = ("ashikhmin", "fibres")  # families that only the test split has


def _evaluator(model: AnisotropicModel, turn: float) -> Callable[[Tensor], Tensor]:
    """Return the function that evaluates a model, turned by `turn` rad, at angles in rad; 0 below the horizon."""
    rotated_model = rotate_model(model, turn)

    def evaluate(angles: Tensor) -> Tensor:
        """Return the BRDF [..., 3] in 1/sr at angles [..., 4] in rad."""
        wi, wo = rusinkiewicz_to_directions(angles.double())
        above_horizon = (wi[..., 2] > 0) & (wo[..., 2] > 0)
        # Below the horizon a model may be anything; the normal as a direction keeps values finite.
        normal = wi.new_tensor([0.0, 0.0, 1.0])
        wi, wo = (torch.where(above_horizon[..., None], direction, normal) for direction in (wi, wo))
        return torch.where(above_horizon[..., None], rotated_model(wi, wo), 0.0).to(angles)

    return evaluate


def anisotropic_materials(split: Split, count: int | None = None, seed: int = 0) -> list[SyntheticBrdf]:
    """Draw the anisotropic materials of one split, whose families take turns; the test split has more families.

    Args:
        split: "train" or "test".
        count: how many; by default 80 for training, 20 for the test. A larger set begins with the smaller one.
        seed: seed of all draws, >= 0.

    Returns:
        Materials with unique names, which evaluate angles [..., 4] in rad.

    Raises:
        ValueError: for another split, or a negative count or seed.
    """
    count = COUNTS.get(split, 0) if count is None else count
    if split not in COUNTS or count < 0 or seed < 0:
        raise ValueError(f"anisotropic BRDFs: {split!r}, {count}, seed {seed}, expected train or test, and 0 or more.")
    families = [name for name in _FAMILIES if split == "test" or name not in TEST_ONLY_FAMILIES]
    materials = []
    for index in range(count):
        family = families[index % len(families)]
        draw = Draws(split, seed, FIRST_ANISOTROPIC_FAMILY_KEY + list(_FAMILIES).index(family), index // len(families))
        name, model = _FAMILIES[family](draw)
        number = f"{'t' if split == 'test' else ''}{index:02d}"
        materials.append(SyntheticBrdf(f"{family}-{name}-{number}", _evaluator(model, math.tau * draw.between(0, 1))))
    return materials
