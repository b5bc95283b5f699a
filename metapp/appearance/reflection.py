"""Reflection by rough surfaces: microfacets, their masking, and Fresnel's equations by Schlick.

Everything is differentiable and takes any leading axes, dtype and device; shapes broadcast. Cosines are with the
surface normal unless said otherwise.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

import torch
from torch import Tensor

from metapp.appearance.geometry import Cosines

MicrofacetKind = Literal["ggx", "beckmann"]
Fresnel = Callable[[Tensor], Tensor]  # cosines [..., 1] -> reflectance [..., C]


def fresnel_schlick(cos: Tensor, f0: Tensor | float) -> Tensor:
    """Evaluate Schlick's approximation (1994) of Fresnel's reflectance; shapes broadcast.

    Args:
        cos: cosine of the angle between light and facet, in [0, 1].
        f0: reflectance at normal incidence, in [0, 1].

    >>> fresnel_schlick(torch.tensor([1.0, 0.0]), 0.04)
    tensor([0.0400, 1.0000])
    """
    return f0 + (1 - f0) * (1 - cos).clamp_min(0) ** 5


def ggx_distribution(cos_h: Tensor, alpha: Tensor | float) -> Tensor:
    """Evaluate the density D of facet normals per sr, GGX (Walter et al. 2007); D cos_h integrates to 1.

    Args:
        cos_h: cosine of the angle between facet and surface normal.
        alpha: roughness, > 0; broadcasts.

    >>> ggx_distribution(torch.tensor(1.0), 1.0) * torch.pi
    tensor(1.)
    """
    # (1 - c)(1 + c), not 1 - c^2: exact in float32 next to the peak.
    spread = (1 - cos_h) * (1 + cos_h) + (alpha * cos_h) ** 2
    return torch.where(cos_h > 0, alpha * alpha / (math.pi * spread * spread), 0.0)


def beckmann_distribution(cos_h: Tensor, alpha: Tensor | float) -> Tensor:
    """Evaluate the density D of facet normals per sr, Beckmann (Walter et al. 2007); D cos_h integrates to 1.

    Args:
        cos_h: cosine of the angle between facet and surface normal.
        alpha: roughness, > 0; broadcasts.
    """
    cos_squared = cos_h.clamp_min(1e-3) ** 2  # the exponential is zero long before
    steepness = (1 - cos_h) * (1 + cos_h) / (cos_squared * alpha * alpha)
    return torch.where(cos_h > 0, (-steepness).exp() / (math.pi * alpha * alpha * cos_squared * cos_squared), 0.0)


def masking_over_cosine(cos: Tensor, alpha: Tensor | float, kind: MicrofacetKind) -> Tensor:
    """Evaluate Smith's masking G1 over the cosine `cos`, by which every use divides it: finite at grazing angles.

    Args:
        cos: cosine of the angle between a direction and the surface normal; below 0 counts as 0.
        alpha: roughness, > 0; broadcasts.
        kind: "ggx" or "beckmann".
    """
    cos = cos.clamp_min(0)
    if kind == "ggx":
        return 2 / (cos + ((1 - cos) * (1 + cos) * alpha * alpha + cos * cos).sqrt())
    if kind == "beckmann":
        sine = ((1 - cos) * (1 + cos)).clamp_min(torch.finfo(cos.dtype).tiny).sqrt()
        ratio = cos / (alpha * sine)
        is_masked = ratio < 1.6
        ratio = ratio.clamp_max(1.6)
        # Walter et al. 2007, equation 27: within 0.35 % of the exact integral.
        quotient = (3.535 + 2.181 * ratio) / ((1 + 2.276 * ratio + 2.577 * ratio * ratio) * alpha * sine)
        return torch.where(is_masked, quotient, 1 / torch.where(is_masked, 1.0, cos))
    raise ValueError(f"microfacet kind: {kind!r}, expected 'ggx' or 'beckmann'")


def microfacet_lobe(at: Cosines, alpha: Tensor | float, fresnel: Fresnel, kind: MicrofacetKind = "ggx") -> Tensor:
    """Evaluate reflection by rough facets (Torrance and Sparrow 1967), with separable Smith masking.

    It is D F G / (4 cos_i cos_o), one scattering event: energy is lost to the others.

    Args:
        at: cosines [...].
        alpha: roughness [...] or a number, > 0.
        fresnel: reflectance [..., C] of the cosine [..., 1] between light and facet.
        kind: "ggx" or "beckmann".

    Returns:
        BRDF [..., C] in 1/sr, 0 below the horizon, finite at grazing angles.
    """
    density = (ggx_distribution if kind == "ggx" else beckmann_distribution)(at.half, alpha)
    reflection = density * masking_over_cosine(at.incident, alpha, kind) * masking_over_cosine(at.outgoing, alpha, kind)
    reflection = torch.where((at.incident > 0) & (at.outgoing > 0), reflection / 4, 0.0)
    return reflection[..., None] * fresnel(at.difference[..., None])
