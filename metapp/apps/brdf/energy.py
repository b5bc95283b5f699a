"""The share of light that BRDFs reflect, by quadrature over half vectors, and fits that reflect no more than all."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from metapp.appearance.geometry import (
    angle_cosines,
    directions_to_rusinkiewicz,
    gauss_legendre,
    half_difference_and_cosine,
)
from metapp.learning.recipe import Recipe

INCIDENT_RAD = torch.linspace(0, math.radians(85), 16, dtype=torch.float64)
POLAR_NODES, AZIMUTH_NODES = 48, 24  # nodes of half vectors, in theta_h and in half a circle about the normal
CROWDING_POWER = 3  # the power that crowds theta_h around 0, where lobes are
TARGET_ALBEDO = 0.995  # the share that fits which reflect more than all are brought to
MAX_SOLVES, DIMMING_FACTOR = 10, 0.99  # least squares, at most; then log(1 + f) times this, until it suffices
RELATIVE_RIDGE = 1e-9  # of the mean of the Gram matrix's diagonal


@functools.cache
def quadrature() -> tuple[Tensor, Tensor]:
    """Pairs of directions, those of one of INCIDENT_RAD in a row: angles [16, N, 3] in rad, weights [16, N], float64.

    Sums of weights times a reflectance are shares of the light.
    """
    (u, of_u), (v, of_v) = gauss_legendre(POLAR_NODES), gauss_legendre(AZIMUTH_NODES)
    theta, phi = (math.pi / 2) * u[:, None] ** CROWDING_POWER, math.pi * v
    solid = theta.sin() * (math.pi / 2) * CROWDING_POWER * (u ** (CROWDING_POWER - 1) * of_u)[:, None] * of_v
    parts = torch.broadcast_tensors(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos())
    half = torch.stack(parts, -1).flatten(0, 1)
    wi = torch.stack([INCIDENT_RAD.sin(), torch.zeros_like(INCIDENT_RAD), INCIDENT_RAD.cos()], -1)
    cosine = wi @ half.T
    wo = 2 * cosine[..., None] * half - wi[:, None]
    above = (cosine > 0) & (wo[..., 2] > 0)
    # both halves of the circle; a solid angle of half vectors is 4 cos theta_d times as large in wo
    weights = 2 * math.pi * solid.flatten() * 4 * cosine * wo[..., 2] * above
    wo = torch.where(above[..., None], wo, wi[:, None])
    return directions_to_rusinkiewicz(wi[:, None].expand_as(wo), wo), weights


def quadrature_places(theta: Tensor) -> Tensor:
    """The pairs of `quadrature` as networks read them, [T, 7, 16 N], for parameters [T, ...] like these."""
    return half_difference_and_cosine(quadrature()[0].flatten(0, 1)).to(theta).T.expand(len(theta), -1, -1)


def albedo(reflectance: Callable[[Tensor], Tensor]) -> Tensor:
    """The share of light from each of INCIDENT_RAD that an isotropic BRDF reflects, [16, 3], linear RGB.

    Args:
        reflectance: angles [..., 3] in rad -> reflectance [..., 3] in 1/sr.
    """
    angles, weights = quadrature()
    shares: Tensor = (reflectance(angles.float()).double() * weights[..., None]).sum(1)
    return shares


def conserve_energy(features: Tensor, last: Tensor) -> Tensor:
    """The closest last layer whose BRDF conserves energy; unchanged if it already does.

    Reflectance is divided by the excess at the steeper one of both directions, so that it stays reciprocal, and
    least squares bring the layer to that.

    Args:
        features: [F, 16 N], of the pairs of `quadrature`, whose weighted sum is log(1 + f).
        last: the layer, [3, F].
    """
    angles, weights = quadrature()
    features, layer, (cosine, other, *_) = (
        features.double().cpu(),
        last.double().cpu(),
        angle_cosines(angles.flatten(0, 1)),
    )
    if not layer.isfinite().all():
        return last  # such fits are refused
    both_rad = torch.stack([cosine, other]).clamp(0, 1).arccos()
    limited = torch.expm1(layer @ features).clamp_min(0)

    def shares() -> Tensor:
        reflected = torch.expm1(layer @ features).clamp_min(0)
        share: Tensor = (reflected.unflatten(1, weights.shape) * weights).sum(2).amax(0)
        return share

    for _ in range(MAX_SOLVES):
        if (share := shares()).amax() <= 1:
            break
        excess = torch.where(share > 1, share / TARGET_ALBEDO, 1.0)
        limited = limited / torch.as_tensor(np.interp(both_rad, INCIDENT_RAD, excess)).amax(0)
        # of log(1 + f cos theta), which fits are judged by, in log(1 + f)
        slope = cosine * (1 + limited) / (1 + limited * cosine)
        weighted = features * slope.square()[:, None]
        gram = weighted @ features.T
        penalty = (
            RELATIVE_RIDGE * gram.diagonal(dim1=1, dim2=2).mean(1)[:, None, None] * torch.eye(len(features)).to(gram)
        )
        off = torch.log1p(limited) - layer @ features
        layer = layer + torch.linalg.solve(gram + penalty, weighted @ off[..., None])[..., 0]
    while shares().amax() > 1:
        layer = DIMMING_FACTOR * layer
    return layer.to(last)


def set_conservation(recipe: Recipe, value: object) -> Recipe:
    """The recipe whose fits reflect no more than they receive.

    Raises:
        ValueError: its networks have no such choice.
    """
    apps = [recipe.app, *(each.app for each in recipe.meta.values() if each.app)]
    if not all(app.network.can_conserve for app in apps):
        raise ValueError("expected networks of isotropic BRDFs, as of --recipe full or quick")

    def conserving_app(app: Any) -> Any:
        return app and replace(app, conserve=value)

    meta = {name: replace(each, app=conserving_app(each.app)) for name, each in recipe.meta.items()}
    return replace(recipe, app=conserving_app(recipe.app), meta=meta)
