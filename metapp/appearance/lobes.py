"""Importance sampling of a BRDF by a mixture of cosine and GGX lobes, fitted for each angle of the viewer.

Any mixture leaves the mean right and changes the noise alone. So the weights are those of least variance.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from metapp.appearance.geometry import directions_to_four_angles, directions_to_rusinkiewicz, rotate_about_normal

Array = NDArray[np.float64]
DirectionPair = tuple[Tensor, Tensor]

CANDIDATE_ALPHAS = tuple(float(alpha) for alpha in np.geomspace(0.005, 0.7, 12))  # GGX roughness of the candidates
ISOTROPIC_ALPHAS = tuple((alpha, alpha) for alpha in CANDIDATE_ALPHAS)
# roughness along and across the axes: of highlights that reach farther along the first one, or as far
ANISOTROPIC_ALPHAS = tuple((first, second) for first in CANDIDATE_ALPHAS[2::2] for second in CANDIDATE_ALPHAS[2::2])
LOBE_COUNT = 2  # of these; the cosine is a further one
VIEWER_NODES = 24  # angles of the viewer, from the normal to LAST_RAD
LAST_VIEWER_RAD = math.radians(89)
MIN_COSINE_SHARE = 0.1  # share of the cosine: bounds the weight of a sample where no lobe of the fit reaches
_DRAWS, _FEW_DRAWS = 128, 48  # directions for each candidate and node, isotropic and anisotropic
_ROUNDS = 20


class LobeMixture(NamedTuple):
    """A mixture for each angle of the viewer.

    Attributes:
        alphas: GGX roughness along two axes, of each lobe beside the cosine.
        shares: [NODES, 1 + L], of the cosine and each lobe, at angles evenly from 0 to LAST_RAD; each row sums to 1.
        turn: azimuth of the axes in rad.
    """

    alphas: tuple[tuple[float, float], ...]
    shares: Array
    turn: float = 0.0


def fit_lobes(reflectance: Callable[[Tensor], Tensor], turn: float | None = None) -> LobeMixture:
    """Fit a mixture to a BRDF, greedily: the lobes that lower the variance most, one after the other.

    Args:
        reflectance: linear RGB [..., 3] in 1/sr of angles (theta_h, theta_d, phi_d) [..., 3] in rad; of an anisotropic
            one also phi_h, [..., 4].
        turn: azimuth of the axes of an anisotropic one in rad; shares are then the same for all azimuths of a viewer.
    """
    candidates = ISOTROPIC_ALPHAS if turn is None else ANISOTROPIC_ALPHAS
    angles, cosine, densities = _directions(turn)
    with torch.no_grad():
        value = reflectance(angles).double().mean(-1).numpy()
    # a network's values beside the horizon may be infinite, which must not decide alone
    target, drawn = np.nan_to_num(value, posinf=0) * cosine, densities.mean(0) + 1e-30
    chosen = [0]
    for _ in range(LOBE_COUNT):
        others = [i for i in range(1, len(densities)) if i not in chosen]
        chosen.append(min(others, key=lambda i: _fitted(target, drawn, densities[[*chosen, i]])[1]))
    shares, _ = _fitted(target, drawn, densities[chosen])
    shares *= 1 - MIN_COSINE_SHARE
    shares[:, 0] += MIN_COSINE_SHARE
    return LobeMixture(tuple(candidates[i - 1] for i in chosen[1:]), shares, turn or 0.0)


def _fitted(target: Array, drawn: Array, lobes: Array) -> tuple[Array, float]:
    """Shares [NODES, K] of least variance, and the mean log of the second moment over the squared mean.

    The second moment, the sum of target^2 / mixture, is convex in the shares. Multiplying these by the square root of
    its slopes never increases it and keeps them positive (as in A-optimal design: Silvey, Titterington, Torsney 1978).

    Args:
        target: f cos theta of the light, mean of RGB, at S directions of each node, [NODES, S].
        drawn: density of these directions, [NODES, S].
        lobes: densities of K lobes there, [K, NODES, S].
    """
    cost = target**2 / drawn
    shares = np.full((len(lobes), len(cost), 1), 1 / len(lobes))
    for _ in range(_ROUNDS):
        mixture = (shares * lobes).sum(0) + 1e-30
        shares *= np.sqrt((cost / mixture**2 * lobes).sum(-1, keepdims=True)) + 1e-30
        shares /= shares.sum(0)
    second = (cost / ((shares * lobes).sum(0) + 1e-30)).mean(-1)
    mean = (target / drawn).mean(-1)
    excess = np.log(np.maximum(second, 1e-30) / np.maximum(mean, 1e-15) ** 2)
    return shares[..., 0].T, float(np.where(mean > 0, excess, 0).mean())


@functools.cache
def _isotropic_directions() -> tuple[Tensor, Array, Array]:
    pair, cosine, lobes = _drawn(ISOTROPIC_ALPHAS, _DRAWS, 0.0)
    return directions_to_rusinkiewicz(*pair), cosine, lobes


def _directions(turn: float | None) -> tuple[Tensor, Array, Array]:
    """Directions, the same for every isotropic BRDF, and for every anisotropic one but for the axes.

    Returns:
        Half and difference angles [NODES, S, 3 or 4], cosines of the light [NODES, S], 0 below the surface, and
        densities of the cosine and all candidates [1 + A, NODES, S].
    """
    if turn is None:
        return _isotropic_directions()
    (light, viewer), cosine, lobes = _drawn(ANISOTROPIC_ALPHAS, _FEW_DRAWS, math.tau)
    light, viewer = (rotate_about_normal(each, each.new_full(each.shape[:-1], turn)) for each in (light, viewer))
    return directions_to_four_angles(light, viewer), cosine, lobes


def _drawn(
    candidates: Sequence[tuple[float, float]], draws: int, azimuths: float
) -> tuple[DirectionPair, Array, Array]:
    """Directions to light and viewer, float32, in the axes of lobes, and the rest of `_directions`."""
    rng = np.random.default_rng(0)
    theta = np.linspace(0, LAST_VIEWER_RAD, VIEWER_NODES)[:, None]
    u = rng.random((2, 1 + len(candidates), VIEWER_NODES, draws))
    phi = azimuths * rng.random((VIEWER_NODES, draws))
    viewer = np.stack(np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)), -1)
    radius, azimuth = np.sqrt(u[0, 0]), 2 * math.pi * u[1, 0]
    lights = [np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), np.sqrt(1 - u[0, 0])], -1)]
    for i, alpha in enumerate(candidates, 1):
        half = _visible_normal(viewer, alpha, u[0, i], u[1, i])
        lights.append(2 * (viewer * half).sum(-1, keepdims=True) * half - viewer)
    light, viewer = np.concatenate(lights, 1), np.concatenate([viewer] * len(lights), 1)
    up = light[..., 2] > 1e-4
    light = np.where(up[..., None], light, [0.0, 0.0, 1.0])
    cosine = light[..., 2]
    lobes = np.stack([cosine / math.pi, *(_density(viewer, light, alpha) for alpha in candidates)]) * up
    return (torch.from_numpy(light).float(), torch.from_numpy(viewer).float()), cosine * up, lobes


def _visible_normal(viewer: Array, alpha: tuple[float, float], u: Array, v: Array) -> Array:
    """Normals of facets that the viewer sees, of GGX roughness alpha (Dupuy and Benyoub 2023: a spherical cap)."""
    stretched = viewer * [*alpha, 1]
    stretched /= np.linalg.norm(stretched, axis=-1, keepdims=True)
    z = (1 - u) * (1 + stretched[..., 2]) - stretched[..., 2]
    sine, azimuth = np.sqrt(np.clip(1 - z * z, 0, 1)), 2 * math.pi * v
    half = (np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), z], -1) + stretched) * [*alpha, 1]
    result: Array = half / np.linalg.norm(half, axis=-1, keepdims=True)
    return result


def _density(viewer: Array, light: Array, alpha: tuple[float, float]) -> Array:
    """Density of a light drawn by mirroring the viewer at a visible facet: D G1 / (4 cos theta of the viewer)."""
    half = viewer + light
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    first, second = alpha
    spread = (half[..., 0] / first) ** 2 + (half[..., 1] / second) ** 2 + half[..., 2] ** 2
    distribution = 1 / (math.pi * first * second * spread**2)
    cosine = viewer[..., 2]
    # G1 / cosine, finite at grazing angles
    slope = (first * viewer[..., 0]) ** 2 + (second * viewer[..., 1]) ** 2
    masking = 2 / (cosine + np.sqrt(slope + cosine**2))
    result: Array = distribution * masking / 4
    return result
