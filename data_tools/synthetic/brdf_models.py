"""Reflection models that the synthetic BRDFs are put together from: isotropic, reciprocal, energy conserving.

A model takes the cosines of a pair of directions above the horizon; models nest, as a coat over a metal.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from data_tools.synthetic.interfaces import (
    fresnel_conductor,
    fresnel_dielectric,
    rough_reflectance,
    rough_transmittance,
)
from metapp.appearance.geometry import Cosines, gauss_legendre
from metapp.appearance.reflection import (
    MicrofacetKind,
    fresnel_schlick,
    microfacet_lobe,
)

Rgb = tuple[float, float, float]
IsotropicModel = Callable[
    [Cosines], Tensor
]  # cosines [...] -> BRDF [..., 3], wherever both directions are above the horizon

# Complex indices (eta, k) for linear RGB: what Mitsuba 3.9.1, variant scalar_rgb, makes of the spectra it ships. Those
# of iron and titanium, which it does not ship, are at 650, 550 and 450 nm: Johnson and Christy 1974.
CONDUCTORS: dict[str, tuple[Rgb, Rgb]] = {
    "gold": ((0.143036, 0.375307, 1.442045), (3.982997, 2.385556, 1.603359)),
    "silver": ((0.155276, 0.116728, 0.138388), (4.828354, 3.122222, 2.146901)),
    "copper": ((0.201005, 0.92375, 1.102215), (3.913262, 2.453045, 2.14209)),
    "aluminium": ((1.657501, 0.880405, 0.521244), (9.223811, 6.269502, 4.837004)),
    "chromium": ((4.369668, 2.916505, 1.654905), (5.206547, 4.231306, 3.754699)),
    "nickel": ((2.367304, 1.663373, 1.467078), (4.498812, 3.050153, 2.345439)),
    "tungsten": ((4.370816, 3.300246, 2.998407), (3.500641, 2.604874, 2.273233)),
    "titanium-nitride": ((1.64845, 1.150516, 1.379824), (3.368328, 1.943498, 1.102068)),
    "vanadium-nitride": ((2.865602, 2.119189, 1.940091), (3.032242, 2.056116, 1.616306)),
    "tantalum": ((2.062721, 2.392939, 2.627929), (2.40836, 1.741486, 1.947028)),
    "copper-oxide": ((3.247541, 2.447805, 2.21022), (0.52109, 0.570031, 0.722179)),
    "amorphous-carbon": ((2.944046, 2.227136, 1.968162), (0.887465, 0.799298, 0.81529)),
    "iron": ((2.9114, 2.9497, 2.5845), (3.0893, 2.9318, 2.7670)),
    "titanium": ((2.7407, 2.5418, 2.2670), (3.8143, 3.4345, 3.0385)),
    "rhodium": ((2.585794, 1.860216, 1.554263), (6.782260, 4.702987, 3.976073)),
    "iridium": ((3.086300, 2.082190, 1.617914), (5.592153, 4.067088, 3.267312)),
}

_TABLE_SIZE = 64


def _interpolate(table: Tensor, cos: Tensor) -> Tensor:
    place = cos.clamp(0, 1) * (len(table) - 1)
    below = place.detach().long().clamp_max(len(table) - 2)
    table = table.to(cos)
    lower = table[below]
    return lower + (place - below) * (table[below + 1] - lower)


def _grid() -> Tensor:
    # Not 0 itself, where a direction sees no facet from the front.
    return torch.linspace(0, 1, _TABLE_SIZE, dtype=torch.float64).clamp_min(1e-6)


def directional_albedo(model: IsotropicModel, cos: Tensor, points: int = 48) -> Tensor:
    """Share of the light from one direction that a BRDF without sharp lobes reflects, by quadrature.

    Args:
        model: the BRDF.
        cos: cosines of the direction, [N], float64.
        points: nodes per axis over the outgoing hemisphere.

    Returns:
        [N, 3].
    """
    nodes, weights = gauss_legendre(points)
    azimuth = (torch.arange(points, dtype=torch.float64) + 0.5) * (math.pi / points)
    incident, outgoing, phi = torch.broadcast_tensors(cos[:, None, None], nodes[:, None], azimuth)
    sines = ((1 - incident**2) * (1 - outgoing**2)).sqrt()
    difference = ((1 + incident * outgoing + sines * phi.cos()) / 2).clamp_min(1e-12).sqrt()
    half = (incident + outgoing) / (2 * difference)
    values = model(Cosines(incident, outgoing, half, difference))
    result: Tensor = (values * (outgoing * weights[:, None])[..., None]).sum((1, 2)) * (2 * math.pi / points)
    return result


def diffuse(albedo: Rgb) -> IsotropicModel:
    """Lambert's law."""

    def model(at: Cosines) -> Tensor:
        return at.half.new_tensor(albedo).div(math.pi).expand(*at.half.shape, 3)

    return model


def oren_nayar(albedo: Rgb, sigma: float) -> IsotropicModel:
    """Rough diffuse facets: Oren and Nayar (1994) in Fujii's form, which keeps energy; `sigma` in [0, 1]."""
    norm = 1 / (math.pi + (math.pi / 2 - 2 / 3) * sigma)

    def model(at: Cosines) -> Tensor:
        s = 2 * at.difference**2 - 1 - at.incident * at.outgoing
        # The quotient has a pole where both directions graze; the floor moves it under the horizon.
        t = torch.where(s > 0, torch.maximum(at.incident, at.outgoing).clamp_min(0.02), 1.0)
        return (norm * (1 + sigma * s / t)).clamp_min(0)[..., None] * at.half.new_tensor(albedo)

    return model


def conductor(eta: Rgb, k: Rgb, alpha: float, kind: MicrofacetKind) -> IsotropicModel:
    """Bare rough metal; the same model as Mitsuba's `roughconductor`."""

    def fresnel(cos: Tensor) -> Tensor:
        return fresnel_conductor(cos, cos.new_tensor(eta), cos.new_tensor(k))

    return lambda at: microfacet_lobe(at, alpha, fresnel, kind)


def dielectric_coating(base: IsotropicModel, alpha: float, kind: MicrofacetKind, eta: float = 1.5) -> IsotropicModel:
    """A rough dielectric interface over another model, which gets the light that the interface lets through, twice.

    Args:
        base: the model under the coat, in terms of the directions outside it.
        alpha: roughness of the coat.
        kind: its facets.
        eta: its index of refraction.

    Returns:
        The coated model. It keeps energy: base <= 1 gives reflected + transmitted <= 1.
    """

    def interface(cos: Tensor) -> Tensor:
        return fresnel_dielectric(cos, eta)

    through = rough_transmittance(_grid(), alpha, eta, kind)

    def model(at: Cosines) -> Tensor:
        both_ways = _interpolate(through, at.incident) * _interpolate(through, at.outgoing)
        return microfacet_lobe(at, alpha, interface, kind) + both_ways[..., None] * base(at)

    return model


def internal_reflectance(alpha: float, kind: MicrofacetKind, eta: float) -> float:
    """Share of diffuse light from within that a rough dielectric interface of index `eta` > 1 keeps inside."""
    nodes, weights = gauss_legendre(_TABLE_SIZE)
    kept = rough_reflectance(nodes, alpha, lambda cos: fresnel_dielectric(cos, 1 / eta), kind)[:, 0]
    return float((2 * weights * nodes * kept).sum())


def plastic(albedo: Rgb, alpha: float, kind: MicrofacetKind, eta: float = 1.49) -> IsotropicModel:
    """A rough coat on a diffuse body, light bouncing between the two; Mitsuba's `roughplastic` with `nonlinear`.

    The bounces deepen the colour: the body's albedo a becomes a / (1 - a R), R the coat's reflectance from within.
    """
    kept = internal_reflectance(alpha, kind, eta)
    red, green, blue = (a / ((1 - a * kept) * eta * eta) for a in albedo)
    return dielectric_coating(diffuse((red, green, blue)), alpha, kind, eta)


def absorbing_layer(base: IsotropicModel, tint: Rgb, eta: float = 1.5) -> IsotropicModel:
    """A clear coloured layer over a model: `tint` is the transmittance of a straight way in and out, in (0, 1]."""

    def model(at: Cosines) -> Tensor:
        ways = [(1 - (1 - cos * cos) / eta**2).rsqrt() for cos in (at.incident, at.outgoing)]
        return at.half.new_tensor(tint) ** ((ways[0] + ways[1]) / 2)[..., None] * base(at)

    return model


def flakes(colour: Rgb, alpha: float) -> IsotropicModel:
    """Metal flakes scattered about the surface's plane: a wide lobe of the given colour."""

    def fresnel(cos: Tensor) -> Tensor:
        return fresnel_schlick(cos, cos.new_tensor(colour))

    return lambda at: microfacet_lobe(at, alpha, fresnel, "ggx")


def sheen(base: IsotropicModel, colour: Rgb, roughness: float) -> IsotropicModel:
    """Fibres standing on a base: Estevez and Kulla's "Charlie" (2017) with Neubelt and Pettineo's visibility.

    Args:
        base: the model under the fibres; it gets the light that they let through, both ways.
        colour: of the fibres, dimmed so that they reflect at most 0.7 of the light.
        roughness: in (0, 1]; lower draws the sheen to the rim.

    Returns:
        The model. Unlike the published one it is energy conserving by its albedo's complement, hence reciprocal.
    """
    power = 1 / roughness

    def fibres(at: Cosines) -> Tensor:
        sine = (1 - at.half * at.half).clamp_min(1e-12) ** (power / 2)
        around = 4 * (at.incident + at.outgoing - at.incident * at.outgoing).clamp_min(1e-3)
        return ((2 + power) / (2 * math.pi) * sine / around)[..., None] * at.half.new_tensor([1.0, 1.0, 1.0])

    albedo = directional_albedo(fibres, _grid())[:, 0]
    dim = min(1.0, 0.7 / float(albedo.max() * max(colour)))
    through = 1 - albedo * (dim * max(colour))

    def model(at: Cosines) -> Tensor:
        both_ways = _interpolate(through, at.incident) * _interpolate(through, at.outgoing)
        return fibres(at) * at.half.new_tensor(colour) * dim + both_ways[..., None] * base(at)

    return model


def isotropic_mixture(first: IsotropicModel, second: IsotropicModel, share: float) -> IsotropicModel:
    """Two materials side by side, finer than the eye: `share` of the first, the rest of the second."""
    return lambda at: share * first(at) + (1 - share) * second(at)
