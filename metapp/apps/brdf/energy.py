"""The share of light that BRDFs reflect, by quadrature over half vectors, and fits that reflect no more than all."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import fields, replace
from typing import NamedTuple

import torch
from torch import Tensor

from metapp.appearance.geometry import directions_to_rusinkiewicz, gauss_legendre, half_difference_incident
from metapp.learning.recipe import Recipe, Setup

INCIDENT_RAD = torch.linspace(0, math.radians(85), 16, dtype=torch.float64)
POLAR, AZIMUTHS = 48, 24  # nodes of half vectors, in theta_h and in half a circle about the normal
CROWDED = 3  # the power that crowds theta_h around 0, where lobes are
MOST = 0.995  # the share that fits which reflect more than all are brought to
ROUNDS = 10  # of least squares, at most
DIMMER = 0.99  # of log(1 + f), again and again where these do not suffice
PENALTY = 1e-9  # of the mean of the Gram matrix's diagonal


class Quadrature(NamedTuple):
    """Pairs of directions, those of one angle of incidence in a row.

    Attributes:
        angles: [16, N, 3] in rad, as `directions_to_rusinkiewicz` has them.
        weights: [16, N]; sums of these times a reflectance are shares of the light.
        outgoing_rad: [16, N], the angle of `wo` from the normal.
    """

    angles: Tensor
    weights: Tensor
    outgoing_rad: Tensor

    @property
    def where(self) -> Tensor:
        """What networks read, [7, 16 N] float32."""
        return half_difference_incident(self.angles.flatten(0, 1)).float().T


@functools.cache
def quadrature() -> Quadrature:
    """Of INCIDENT_RAD and half vectors all around, float64."""
    (u, of_u), (v, of_v) = gauss_legendre(POLAR), gauss_legendre(AZIMUTHS)
    theta, phi = (math.pi / 2) * u[:, None] ** CROWDED, math.pi * v
    solid = theta.sin() * (math.pi / 2) * CROWDED * (u ** (CROWDED - 1) * of_u)[:, None] * of_v
    parts = torch.broadcast_tensors(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos())
    half = torch.stack(parts, -1).flatten(0, 1)
    wi = torch.stack([INCIDENT_RAD.sin(), torch.zeros_like(INCIDENT_RAD), INCIDENT_RAD.cos()], -1)
    cosine = wi @ half.T
    wo = 2 * cosine[..., None] * half - wi[:, None]
    above = (cosine > 0) & (wo[..., 2] > 0)
    # both halves of the circle; a solid angle of half vectors is 4 cos theta_d times as large in wo
    weights = 2 * math.pi * solid.flatten() * 4 * cosine * wo[..., 2] * above
    wo = torch.where(above[..., None], wo, wi[:, None])
    angles = directions_to_rusinkiewicz(wi[:, None].expand_as(wo), wo)
    return Quadrature(angles, weights, wo[..., 2].clamp(-1, 1).arccos())


def albedo(reflectance: Callable[[Tensor], Tensor]) -> Tensor:
    """The share of light from each of INCIDENT_RAD that an isotropic BRDF reflects, [16, 3], linear RGB.

    Args:
        reflectance: angles [..., 3] in rad -> reflectance [..., 3] in 1/sr.
    """
    angles, weights, _ = quadrature()
    shares: Tensor = (reflectance(angles.float()).double() * weights[..., None]).sum(1)
    return shares


def conserving(features: Tensor, last: Tensor) -> Tensor:
    """The last layer of a fit that reflects no more than it receives, near this one; the same where it does not.

    Reflectance is divided by what is too much at the steeper one of both directions, so that it stays reciprocal, and
    least squares bring the layer to that.

    Args:
        features: [F, 16 N], of the pairs of `quadrature`, whose weighted sum is log(1 + f).
        last: the layer, [3, F].
    """
    _, weights, outgoing = quadrature()
    features, layer, cosine = features.double(), last.double(), outgoing.cos().flatten()
    identity = torch.eye(len(features), dtype=features.dtype)
    limited = torch.expm1(layer @ features).clamp_min(0)

    def shares() -> Tensor:
        reflected = torch.expm1(layer @ features).clamp_min(0)
        share: Tensor = (reflected.unflatten(1, weights.shape) * weights).sum(2).amax(0)
        return share

    for _ in range(ROUNDS):
        if (share := shares()).amax() <= 1:
            break
        excess = torch.where(share > 1, share / MOST, 1.0)
        here = excess.repeat_interleave(outgoing.shape[1])
        limited = limited / torch.maximum(here, _between(outgoing.flatten(), excess))
        # of log(1 + f cos theta), which fits are judged by, in log(1 + f)
        slope = cosine * (1 + limited) / (1 + limited * cosine)
        weighted = features * slope.square()[:, None]
        gram = weighted @ features.T
        penalty = PENALTY * gram.diagonal(dim1=1, dim2=2).mean(1)[:, None, None] * identity
        off = torch.log1p(limited) - layer @ features
        layer = layer + torch.linalg.solve(gram + penalty, weighted @ off[..., None])[..., 0]
    while shares().amax() > 1:
        layer = DIMMER * layer
    return layer.to(last)


def _between(angles_rad: Tensor, values: Tensor) -> Tensor:
    """Values at INCIDENT_RAD at other angles; the last one beyond."""
    place = (angles_rad / INCIDENT_RAD[1]).clamp(0, len(values) - 1)
    lower = place.long().clamp_max(len(values) - 2)
    return torch.lerp(values[lower], values[lower + 1], place - lower)


def with_conservation(recipe: Recipe, value: object) -> Recipe:
    """The recipe whose fits reflect no more than they receive.

    Raises:
        ValueError: its networks have no such choice.
    """

    def of(setup: Setup) -> Setup:
        names = [field.name for field in fields(setup)]
        if "conserve" not in names or getattr(setup, "anisotropic", False):
            raise ValueError("expected networks of isotropic BRDFs, as of --recipe full or quick")
        return replace(setup, conserve=value)

    meta = {name: replace(each, setup=of(each.setup)) if each.setup else each for name, each in recipe.meta.items()}
    return replace(recipe, setup=of(recipe.setup), meta=meta)
