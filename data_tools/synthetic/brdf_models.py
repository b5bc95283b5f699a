"""Reflection models that the synthetic BRDFs are put together from: isotropic, reciprocal, energy conserving.

A model takes the cosines of a pair of directions above the horizon. Models nest: a coat takes the model below it, such
as a metal.
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

# Complex indices (eta, k) for linear RGB: what Mitsuba 3.9.1, variant scalar_rgb, makes of the spectra it ships. The
# indices of iron and titanium, which it does not ship, are at 650, 550 and 450 nm: Johnson and Christy 1974.
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

_TABLE_SIZE = 64  # cosines in a table of transmittance or albedo


def _interpolate(table: Tensor, cos: Tensor) -> Tensor:
    """Interpolate a table over cosines 0 to 1 linearly at `cos`."""
    position = cos.clamp(0, 1) * (len(table) - 1)
    lower_index = position.detach().long().clamp_max(len(table) - 2)
    table = table.to(cos)
    lower = table[lower_index]
    return lower + (position - lower_index) * (table[lower_index + 1] - lower)


def _grid() -> Tensor:
    # The first cosine is not 0 itself, where a direction sees no facet from the front.
    """Return the cosines [_TABLE_SIZE] at which tables hold values."""
    return torch.linspace(0, 1, _TABLE_SIZE, dtype=torch.float64).clamp_min(1e-6)


def directional_albedo(model: IsotropicModel, cos: Tensor, points: int = 48) -> Tensor:
    """Return the share of the light from one direction that a BRDF without sharp lobes reflects, by quadrature.

    Args:
        model: the BRDF.
        cos: cosines [N] of the direction with the normal, float64.
        points: nodes per axis over the outgoing hemisphere.

    Returns:
        The directional albedo [N, 3].
    """
    nodes, weights = gauss_legendre(points)
    azimuth = (torch.arange(points, dtype=torch.float64) + 0.5) * (math.pi / points)
    incident, outgoing, phi = torch.broadcast_tensors(cos[:, None, None], nodes[:, None], azimuth)
    sines = ((1 - incident**2) * (1 - outgoing**2)).sqrt()
    difference = ((1 + incident * outgoing + sines * phi.cos()) / 2).clamp_min(1e-12).sqrt()
    half = (incident + outgoing) / (2 * difference)
    values = model(Cosines(incident, outgoing, half, difference))
    albedo: Tensor = (values * (outgoing * weights[:, None])[..., None]).sum((1, 2)) * (2 * math.pi / points)
    return albedo


def diffuse(albedo: Rgb) -> IsotropicModel:
    """Return Lambert's model with a linear RGB albedo."""

    def model(cosines: Cosines) -> Tensor:
        return cosines.half.new_tensor(albedo).div(math.pi).expand(*cosines.half.shape, 3)

    return model


def oren_nayar(albedo: Rgb, sigma: float) -> IsotropicModel:
    """Return rough diffuse facets: Oren and Nayar (1994) in Fujii's form, which keeps energy.

    The roughness `sigma` is in [0, 1].
    """
    norm = 1 / (math.pi + (math.pi / 2 - 2 / 3) * sigma)

    def model(cosines: Cosines) -> Tensor:
        s = 2 * cosines.difference**2 - 1 - cosines.incident * cosines.outgoing
        # The quotient has a pole where both directions graze; the floor moves it under the horizon.
        t = torch.where(s > 0, torch.maximum(cosines.incident, cosines.outgoing).clamp_min(0.02), 1.0)
        return (norm * (1 + sigma * s / t)).clamp_min(0)[..., None] * cosines.half.new_tensor(albedo)

    return model


def conductor(eta: Rgb, k: Rgb, alpha: float, kind: MicrofacetKind) -> IsotropicModel:
    """Return bare rough metal, as Mitsuba's `roughconductor` models it."""

    def fresnel(cos: Tensor) -> Tensor:
        return fresnel_conductor(cos, cos.new_tensor(eta), cos.new_tensor(k))

    return lambda cosines: microfacet_lobe(cosines, alpha, fresnel, kind)


def dielectric_coating(base: IsotropicModel, alpha: float, kind: MicrofacetKind, eta: float = 1.5) -> IsotropicModel:
    """Return a rough dielectric interface over another model.

    The other model gets the light that the interface lets through, on the way in and on the way out.

    Args:
        base: the model under the coat, in terms of the directions outside it.
        alpha: roughness of the coat.
        kind: kind of the coat's microfacets.
        eta: index of refraction of the coat.

    Returns:
        The coated model. It keeps energy: base <= 1 gives reflected + transmitted <= 1.
    """

    def interface(cos: Tensor) -> Tensor:
        return fresnel_dielectric(cos, eta)

    transmittance = rough_transmittance(_grid(), alpha, eta, kind)

    def model(cosines: Cosines) -> Tensor:
        transmittance_both_ways = _interpolate(transmittance, cosines.incident) * _interpolate(
            transmittance, cosines.outgoing
        )
        return microfacet_lobe(cosines, alpha, interface, kind) + transmittance_both_ways[..., None] * base(cosines)

    return model


def internal_reflectance(alpha: float, kind: MicrofacetKind, eta: float) -> float:
    """Return the share of diffuse light that a rough dielectric interface of index `eta` > 1 keeps inside."""
    nodes, weights = gauss_legendre(_TABLE_SIZE)
    reflectance = rough_reflectance(nodes, alpha, lambda cos: fresnel_dielectric(cos, 1 / eta), kind)[:, 0]
    return float((2 * weights * nodes * reflectance).sum())


def plastic(albedo: Rgb, alpha: float, kind: MicrofacetKind, eta: float = 1.49) -> IsotropicModel:
    """Return a rough coat on a diffuse body, as Mitsuba's `roughplastic` with `nonlinear` models it.

    Light bounces between coat and body, which deepens the colour: the body's albedo a becomes a / (1 - a R), R the
    coat's reflectance from within.
    """
    internal = internal_reflectance(alpha, kind, eta)
    red, green, blue = (a / ((1 - a * internal) * eta * eta) for a in albedo)
    return dielectric_coating(diffuse((red, green, blue)), alpha, kind, eta)


def absorbing_layer(base: IsotropicModel, tint: Rgb, eta: float = 1.5) -> IsotropicModel:
    """Return a clear coloured layer over a model.

    The `tint` is the transmittance of a straight way in and out, in (0, 1].
    """

    def model(cosines: Cosines) -> Tensor:
        path_lengths = [(1 - (1 - cos * cos) / eta**2).rsqrt() for cos in (cosines.incident, cosines.outgoing)]
        return cosines.half.new_tensor(tint) ** ((path_lengths[0] + path_lengths[1]) / 2)[..., None] * base(cosines)

    return model


def flakes(colour: Rgb, alpha: float) -> IsotropicModel:
    """Return metal flakes scattered about the surface's plane: a wide lobe of a colour."""

    def fresnel(cos: Tensor) -> Tensor:
        return fresnel_schlick(cos, cos.new_tensor(colour))

    return lambda cosines: microfacet_lobe(cosines, alpha, fresnel, "ggx")


def sheen(base: IsotropicModel, colour: Rgb, roughness: float) -> IsotropicModel:
    """Return fibres standing on a base: Estevez and Kulla's "Charlie" (2017) with Neubelt and Pettineo's visibility.

    Args:
        base: the model under the fibres; it gets the light that they let through, both ways.
        colour: colour of the fibres, dimmed so that they reflect at most 0.7 of the light.
        roughness: in (0, 1]; a lower one draws the sheen to the rim.

    Returns:
        The model. Unlike the published one it is energy conserving by its albedo's complement, hence reciprocal.
    """
    power = 1 / roughness

    def fibres(cosines: Cosines) -> Tensor:
        sine = (1 - cosines.half * cosines.half).clamp_min(1e-12) ** (power / 2)
        visibility_denominator = 4 * (
            cosines.incident + cosines.outgoing - cosines.incident * cosines.outgoing
        ).clamp_min(1e-3)
        return ((2 + power) / (2 * math.pi) * sine / visibility_denominator)[..., None] * cosines.half.new_tensor(
            [1.0, 1.0, 1.0]
        )

    albedo = directional_albedo(fibres, _grid())[:, 0]
    dim = min(1.0, 0.7 / float(albedo.max() * max(colour)))
    transmittance = 1 - albedo * (dim * max(colour))

    def model(cosines: Cosines) -> Tensor:
        transmittance_both_ways = _interpolate(transmittance, cosines.incident) * _interpolate(
            transmittance, cosines.outgoing
        )
        return fibres(cosines) * cosines.half.new_tensor(colour) * dim + transmittance_both_ways[..., None] * base(
            cosines
        )

    return model


def isotropic_mixture(first: IsotropicModel, second: IsotropicModel, share: float) -> IsotropicModel:
    """Return two materials side by side, finer than the eye: `share` of the first, the rest of the second."""
    return lambda cosines: share * first(cosines) + (1 - share) * second(cosines)
