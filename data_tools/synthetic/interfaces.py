"""Smooth and rough interfaces: reflectance by Fresnel's equations, and transmittance.

All functions take any leading axes, dtype and device; cosines are with the surface normal unless said otherwise.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from metapp.appearance.geometry import gauss_legendre
from metapp.appearance.reflection import Fresnel, MicrofacetKind, masking_over_cosine


def fresnel_dielectric(cos: Tensor, eta: Tensor | float) -> Tensor:
    """Return the unpolarised reflectance in [0, 1] of a smooth dielectric interface, 1 under total internal reflection.

    Args:
        cos: cosine on the side the light comes from, in [0, 1].
        eta: index of refraction of the other side over this side; below 1 seen from within.
    """
    transmitted_squared = 1 - (1 - cos * cos) / (eta * eta)
    transmitted = transmitted_squared.clamp_min(torch.finfo(cos.dtype).tiny).sqrt()
    parallel = (eta * cos - transmitted) / (eta * cos + transmitted)
    perpendicular = (cos - eta * transmitted) / (cos + eta * transmitted)
    return torch.where(transmitted_squared > 0, (parallel**2 + perpendicular**2) / 2, 1.0)


def fresnel_conductor(cos: Tensor, eta: Tensor | float, k: Tensor | float) -> Tensor:
    """Return the unpolarised reflectance in [0, 1] of a smooth conductor of complex index eta + i k.

    The equations are in Moeller's "Optics".

    Args:
        cos: cosine with the normal, in [0, 1], on the side of air.
        eta: real part, > 0.
        k: extinction coefficient, >= 0.
    """
    cos_squared = cos * cos
    sin_squared = 1 - cos_squared
    product = cos.new_tensor(1.0) * (eta * k)
    real = eta * eta - k * k - sin_squared
    modulus = (real * real + 4 * product * product).clamp_min(torch.finfo(cos.dtype).tiny).sqrt()
    # The textbook's a = sqrt((modulus + real) / 2) cancels for metals like silver; its product with b is eta * k.
    larger = ((modulus + real.abs()) / 2).sqrt()
    a = torch.where(real >= 0, larger, product / larger)
    perpendicular = (modulus + cos_squared - 2 * cos * a) / (modulus + cos_squared + 2 * cos * a)
    sum_ = modulus * cos_squared + sin_squared * sin_squared
    parallel = perpendicular * (sum_ - 2 * cos * a * sin_squared) / (sum_ + 2 * cos * a * sin_squared)
    return (perpendicular + parallel) / 2


def smith_masking(cos: Tensor, alpha: Tensor | float, kind: MicrofacetKind) -> Tensor:
    """Return Smith's masking G1 in [0, 1], the visible share of the facets; exact for GGX, Walter's fit for Beckmann.

    Args:
        cos: cosine of the direction with the macroscopic normal; masked entirely at and below 0.
        alpha: roughness > 0, broadcast.
        kind: "ggx" or "beckmann".
    """
    return masking_over_cosine(cos, alpha, kind) * cos.clamp_min(0)


def _visible_facets(cos: Tensor, alpha: float, kind: MicrofacetKind) -> tuple[Tensor, Tensor, Tensor]:
    """Return the facets that are seen from directions with cosines [...], for quadrature over facet normals.

    Returns:
        The facets' cosines with the normal (cos_h) and with the direction (cos_d), and quadrature weights, each [...,
            64, 48]. The weights sum to 1 but for the quadrature's error; they are 0 for facets seen from behind.
    """
    nodes, weights = (part.to(cos)[:, None] for part in gauss_legendre(64))
    # Normals are distributed as D cos_h, and a quantile of it gives the slope. Each azimuth stands for its mirror
    # image, too.
    slope_squared = nodes / (1 - nodes) if kind == "ggx" else -(1 - nodes).log()
    cos_h = (1 + alpha * alpha * slope_squared).rsqrt()
    sin_h = (1 - cos_h * cos_h).sqrt()
    azimuth = (torch.arange(48, dtype=cos.dtype, device=cos.device) + 0.5) * (math.pi / 48)
    cos = cos[..., None, None]
    cos_d = (cos * cos_h + (1 - cos * cos).clamp_min(0).sqrt() * sin_h * azimuth.cos()).clamp_min(0)
    return cos_h, cos_d, masking_over_cosine(cos, alpha, kind) * cos_d / cos_h * weights / 48


def rough_reflectance(cos: Tensor, alpha: float, fresnel: Fresnel, kind: MicrofacetKind = "ggx") -> Tensor:
    """Return the share of the light from one direction that a microfacet lobe reflects, by quadrature.

    With `fresnel_dielectric` of eta > 1 this is the reflectance of a rough coat; of eta < 1, the share it keeps inside.

    Args:
        cos: cosines [...] of the direction, in (0, 1].
        alpha: roughness > 0.
        fresnel: function from cosines [..., 1] to reflectance [..., C].
        kind: "ggx" or "beckmann".

    Returns:
        Reflectance [..., C] in [0, 1], to about 1e-3 (less well in the last degrees before grazing).
    """
    cos_h, cos_d, weights = _visible_facets(cos, alpha, kind)
    outgoing = 2 * cos_d * cos_h - cos[..., None, None]
    share = weights * smith_masking(outgoing, alpha, kind)
    return (share[..., None] * fresnel(cos_d[..., None])).sum((-3, -2))


def rough_transmittance(cos: Tensor, alpha: float, eta: float, kind: MicrofacetKind = "ggx") -> Tensor:
    """Return the share of the light from one direction that passes a rough dielectric interface in one event.

    The model is Walter et al.'s (2007).

    Args:
        cos: cosines [...] of the direction, in (0, 1].
        alpha: roughness > 0.
        eta: index of refraction of the far side over the near side, > 0.
        kind: "ggx" or "beckmann".

    Returns:
        Transmittance [...] in [0, 1]; with `rough_reflectance` less than 1 in sum, by the masking of facets.
    """
    cos_h, cos_d, weights = _visible_facets(cos, alpha, kind)
    refracted_cos = (1 - (1 - cos_d * cos_d) / (eta * eta)).clamp_min(0).sqrt()
    inward_cos = refracted_cos * cos_h + (cos[..., None, None] - cos_d * cos_h) / eta  # with the inward normal
    return (weights * (1 - fresnel_dielectric(cos_d, eta)) * smith_masking(inward_cos, alpha, kind)).sum((-2, -1))
