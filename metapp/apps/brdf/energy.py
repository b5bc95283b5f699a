"""The share of light that a BRDF reflects, and fits that reflect no more light than they receive.

The share is an integral over outgoing directions. It is computed by quadrature over half vectors, in which a highlight
has its place at all angles of the light. A BRDF is known here by its reflectance, or by features and a linear layer;
which network it comes from is not.
"""

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

INCIDENT_RAD = torch.linspace(0, math.radians(85), 16, dtype=torch.float64)  # angles of the light from the normal
POLAR_NODES, AZIMUTH_NODES = 48, 24  # nodes of half vectors, in theta_h and in half a circle about the normal
CROWDING_POWER = 3  # the power that crowds theta_h around 0, where lobes are
TARGET_ALBEDO = 0.995  # the share of light that a fit is made to reflect at angles where it reflected more than all
MAX_SOLVES = 10  # solves of least squares, at most
DIMMING_FACTOR = 0.99  # factor of log(1 + f) of fits that these solves do not bring to conserve energy
RELATIVE_RIDGE = 1e-9  # the penalty of least squares, over the mean of the Gram matrix's diagonal


@functools.cache
def quadrature() -> tuple[Tensor, Tensor]:
    """Return pairs of directions and their weights, by which sums over reflectance are shares of the light.

    Returns:
        Angles theta_h, theta_d, phi_d [16, N, 3] in rad, a row for each of INCIDENT_RAD; and weights [16, N]. A row's
        sum of weights times reflectance is the share of that light which is reflected. Both are float64.
    """
    (u, u_weights), (v, v_weights) = gauss_legendre(POLAR_NODES), gauss_legendre(AZIMUTH_NODES)
    theta, phi = (math.pi / 2) * u[:, None] ** CROWDING_POWER, math.pi * v
    solid_angles = (
        theta.sin() * (math.pi / 2) * CROWDING_POWER * (u ** (CROWDING_POWER - 1) * u_weights)[:, None] * v_weights
    )
    components = torch.broadcast_tensors(theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos())
    half = torch.stack(components, -1).flatten(0, 1)
    wi = torch.stack([INCIDENT_RAD.sin(), torch.zeros_like(INCIDENT_RAD), INCIDENT_RAD.cos()], -1)
    cos_theta_d = wi @ half.T
    wo = 2 * cos_theta_d[..., None] * half - wi[:, None]
    is_visible = (cos_theta_d > 0) & (wo[..., 2] > 0)
    # 2 pi for both halves of the circle; a solid angle of half vectors is 4 cos theta_d times as large in wo
    weights = 2 * math.pi * solid_angles.flatten() * 4 * cos_theta_d * wo[..., 2] * is_visible
    wo = torch.where(is_visible[..., None], wo, wi[:, None])
    return directions_to_rusinkiewicz(wi[:, None].expand_as(wo), wo), weights


def quadrature_places(theta: Tensor) -> Tensor:
    """Return the pairs of :func:`quadrature` as networks read them, [T, 7, 16 N].

    Args:
        theta: a parameter [T, ...], for the number of tasks, the dtype and the device.
    """
    return half_difference_and_cosine(quadrature()[0].flatten(0, 1)).to(theta).T.expand(len(theta), -1, -1)


def albedo(reflectance: Callable[[Tensor], Tensor]) -> Tensor:
    """Return the share of light from each of INCIDENT_RAD that an isotropic BRDF reflects, [16, 3], linear RGB.

    Args:
        reflectance: maps angles [..., 3] in rad to reflectance [..., 3] in 1/sr.
    """
    angles, weights = quadrature()
    shares: Tensor = (reflectance(angles.float()).double() * weights[..., None]).sum(1)
    return shares


def conserve_energy(features: Tensor, last: Tensor) -> Tensor:
    """Return a last layer close to the given one whose BRDF conserves energy; unchanged if it already does.

    A direction of the light has an excess if the BRDF reflects more than all of that light. Reflectance at a pair of
    directions is divided by the greater of the excesses of both directions, so that it stays reciprocal. Least squares
    find the layer whose reflectance is closest to the result. Both are repeated, up to MAX_SOLVES times, until no share
    of light is above 1. If one still is, log(1 + f) is multiplied by DIMMING_FACTOR until none is.

    Args:
        features: features [F, 16 N] at the pairs of :func:`quadrature`; log(1 + f) is their sum, weighted by the layer.
        last: the layer, [3, F].
    """
    angles, weights = quadrature()
    features, layer, (incident_cosine, outgoing_cosine, *_) = (
        features.double().cpu(),
        last.double().cpu(),
        angle_cosines(angles.flatten(0, 1)),
    )
    if not layer.isfinite().all():
        return last  # a fit that is not finite is refused later
    polar_rad = torch.stack([incident_cosine, outgoing_cosine]).clamp(0, 1).arccos()
    limited_reflectance = torch.expm1(layer @ features).clamp_min(0)

    def compute_shares() -> Tensor:
        reflected = torch.expm1(layer @ features).clamp_min(0)
        shares: Tensor = (reflected.unflatten(1, weights.shape) * weights).sum(2).amax(0)
        return shares

    for _ in range(MAX_SOLVES):
        if (shares := compute_shares()).amax() <= 1:
            break
        excess = torch.where(shares > 1, shares / TARGET_ALBEDO, 1.0)
        limited_reflectance = limited_reflectance / torch.as_tensor(np.interp(polar_rad, INCIDENT_RAD, excess)).amax(0)
        slope = judged_slope(limited_reflectance, incident_cosine)
        weighted_features = features * slope.square()[:, None]
        gram = weighted_features @ features.T
        penalty = (
            RELATIVE_RIDGE * gram.diagonal(dim1=1, dim2=2).mean(1)[:, None, None] * torch.eye(len(features)).to(gram)
        )
        residual = torch.log1p(limited_reflectance) - layer @ features
        layer = layer + torch.linalg.solve(gram + penalty, weighted_features @ residual[..., None])[..., 0]
    while compute_shares().amax() > 1:
        layer = DIMMING_FACTOR * layer
    return layer.to(last)


def judged_slope(reflectance: Tensor, incident_cosine: Tensor) -> Tensor:
    """Return the derivative of log(1 + f cos theta_i), by which fits are judged, in log(1 + f), which layers yield.

    Args:
        reflectance: f in 1/sr, [3, N].
        incident_cosine: cos theta_i, [N].

    Returns:
        The derivative, [3, N].
    """
    return incident_cosine * (1 + reflectance) / (1 + reflectance * incident_cosine)


def set_conservation(recipe: Recipe, value: object) -> Recipe:
    """Return a recipe all of whose applications have `conserve` set to a value.

    Raises:
        ValueError: a network of the recipe cannot conserve energy.
    """
    apps: list[Any] = [recipe.app, *(training.app for training in recipe.meta.values() if training.app)]
    if not all(app.network.can_conserve_energy for app in apps):
        raise ValueError("expected a recipe of isotropic BRDFs, such as full or quick")

    def set_app(app: Any) -> Any:
        return app and replace(app, conserve=value)

    meta = {name: replace(training, app=set_app(training.app)) for name, training in recipe.meta.items()}
    return replace(recipe, app=set_app(recipe.app), meta=meta)
