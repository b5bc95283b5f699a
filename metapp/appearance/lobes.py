"""Importance sampling of a BRDF by a mixture of cosine and GGX lobes, fitted for each angle of the viewer.

The mean of a picture is right whatever the mixture, which changes the noise alone; so the mixture is fitted to minimise
the variance. Renderers and the viewer draw directions by it. A BRDF is known here as a function of angles, not by the
network or the file that represents it.
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
# roughness along the first and the second axis: all pairs of every other candidate from the third on
ANISOTROPIC_ALPHAS = tuple((first, second) for first in CANDIDATE_ALPHAS[2::2] for second in CANDIDATE_ALPHAS[2::2])
LOBE_COUNT = 2  # GGX lobes of a mixture, beside the cosine lobe
VIEWER_NODES = 24  # number of viewer angles, from the normal to LAST_VIEWER_RAD, that mixtures are fitted for
LAST_VIEWER_RAD = math.radians(89)  # greatest angle between viewer and normal, rad
MIN_COSINE_SHARE = 0.1  # least share of the cosine lobe: bounds a sample's weight where no GGX lobe reaches
_ISOTROPIC_DRAWS, _ANISOTROPIC_DRAWS = 128, 48  # directions drawn of each candidate at each node
_SHARE_UPDATES = 20  # multiplicative updates of the shares


class LobeMixture(NamedTuple):
    """A mixture of a cosine lobe and GGX lobes for each angle of the viewer.

    Attributes:
        alphas: GGX roughness along two axes, of each lobe beside the cosine.
        shares: [VIEWER_NODES, 1 + L], of the cosine and each lobe, at angles evenly from 0 to LAST_VIEWER_RAD; each row
            sums to 1.
        azimuth_rad: azimuth of the axes in rad.
    """

    alphas: tuple[tuple[float, float], ...]
    shares: Array
    azimuth_rad: float = 0.0


def fit_lobes(reflectance: Callable[[Tensor], Tensor], axes_azimuth_rad: float | None = None) -> LobeMixture:
    """Fit a mixture to a BRDF, greedily: the lobes that lower the variance most, one after the other.

    Args:
        reflectance: linear RGB [..., 3] in 1/sr of angles (theta_h, theta_d, phi_d) [..., 3] in rad; of an anisotropic
            BRDF also phi_h, [..., 4].
        axes_azimuth_rad: azimuth of the axes of an anisotropic BRDF; shares are then the same for all azimuths of a
            viewer.
            None for an isotropic BRDF.
    """
    candidates = ISOTROPIC_ALPHAS if axes_azimuth_rad is None else ANISOTROPIC_ALPHAS
    angles, cosine, densities = _training_directions(axes_azimuth_rad)
    with torch.no_grad():
        mean_reflectance = reflectance(angles).double().mean(-1).numpy()
    # a network's values close to the horizon may be infinite; these must not decide alone
    target, sampling_density = np.nan_to_num(mean_reflectance, posinf=0) * cosine, densities.mean(0) + 1e-30
    chosen = [0]
    for _ in range(LOBE_COUNT):
        others = [i for i in range(1, len(densities)) if i not in chosen]
        chosen.append(min(others, key=lambda i: _fit_shares(target, sampling_density, densities[[*chosen, i]])[1]))
    shares, _ = _fit_shares(target, sampling_density, densities[chosen])
    shares *= 1 - MIN_COSINE_SHARE
    shares[:, 0] += MIN_COSINE_SHARE
    return LobeMixture(tuple(candidates[i - 1] for i in chosen[1:]), shares, axes_azimuth_rad or 0.0)


def _fit_shares(target: Array, sampling_density: Array, lobes: Array) -> tuple[Array, float]:
    """Fit the shares of least variance at each node.

    The second moment, the sum of target^2 / mixture, is convex in the shares. Multiplying these by the square root of
    its slopes never increases it and keeps them positive (as in A-optimal design: Silvey, Titterington, Torsney 1978).

    Args:
        target: f cos theta of the light, mean of RGB, at S directions of each node, [NODES, S].
        sampling_density: density of these directions, [NODES, S].
        lobes: densities of K lobes there, [K, NODES, S].

    Returns:
        Shares [NODES, K], and the mean over nodes of the log of the second moment over the squared mean.
    """
    cost = target**2 / sampling_density
    shares = np.full((len(lobes), len(cost), 1), 1 / len(lobes))
    for _ in range(_SHARE_UPDATES):
        mixture = (shares * lobes).sum(0) + 1e-30
        shares *= np.sqrt((cost / mixture**2 * lobes).sum(-1, keepdims=True)) + 1e-30
        shares /= shares.sum(0)
    second_moment = (cost / ((shares * lobes).sum(0) + 1e-30)).mean(-1)
    mean = (target / sampling_density).mean(-1)
    excess = np.log(np.maximum(second_moment, 1e-30) / np.maximum(mean, 1e-15) ** 2)
    return shares[..., 0].T, float(np.where(mean > 0, excess, 0).mean())


@functools.cache
def _isotropic_directions() -> tuple[Tensor, Array, Array]:
    """Return the result of :func:`_training_directions` for isotropic BRDFs, drawn once."""
    pair, cosine, lobes = _draw_directions(ISOTROPIC_ALPHAS, _ISOTROPIC_DRAWS, 0.0)
    return directions_to_rusinkiewicz(*pair), cosine, lobes


def _training_directions(axes_azimuth_rad: float | None) -> tuple[Tensor, Array, Array]:
    """Return directions, the same for every isotropic BRDF, and for every anisotropic one but for the axes.

    Returns:
        Half and difference angles [NODES, S, 3 or 4], cosines of the light [NODES, S], 0 below the surface, and
        densities of the cosine and all candidates [1 + A, NODES, S].
    """
    if axes_azimuth_rad is None:
        return _isotropic_directions()
    (light, viewer), cosine, lobes = _draw_directions(ANISOTROPIC_ALPHAS, _ANISOTROPIC_DRAWS, math.tau)
    light, viewer = (
        rotate_about_normal(direction, direction.new_full(direction.shape[:-1], axes_azimuth_rad))
        for direction in (light, viewer)
    )
    return directions_to_four_angles(light, viewer), cosine, lobes


def _draw_directions(
    candidates: Sequence[tuple[float, float]], draws: int, azimuths: float
) -> tuple[DirectionPair, Array, Array]:
    """Draw directions by the cosine lobe and by each candidate, at each node.

    Args:
        candidates: GGX roughness along two axes, of A lobes.
        draws: directions of each lobe at each node; S = (1 + A) draws.
        azimuths: range of the viewer's azimuth in rad; 0 if it does not matter.

    Returns:
        Directions to light and viewer, [NODES, S, 3], float32, in the axes of lobes; cosines of the light [NODES, S], 0
        below the surface; and densities of the cosine and all candidates [1 + A, NODES, S].
    """
    rng = np.random.default_rng(0)
    theta = np.linspace(0, LAST_VIEWER_RAD, VIEWER_NODES)[:, None]
    u = rng.random((2, 1 + len(candidates), VIEWER_NODES, draws))
    phi = azimuths * rng.random((VIEWER_NODES, draws))
    viewer = np.stack(np.broadcast_arrays(np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)), -1)
    radius, azimuth = np.sqrt(u[0, 0]), 2 * math.pi * u[1, 0]
    lights = [np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), np.sqrt(1 - u[0, 0])], -1)]
    for i, alpha in enumerate(candidates, 1):
        half = _sample_visible_normal(viewer, alpha, u[0, i], u[1, i])
        lights.append(2 * (viewer * half).sum(-1, keepdims=True) * half - viewer)
    light, viewer = np.concatenate(lights, 1), np.concatenate([viewer] * len(lights), 1)
    is_above = light[..., 2] > 1e-4
    light = np.where(is_above[..., None], light, [0.0, 0.0, 1.0])
    cosine = light[..., 2]
    lobes = np.stack([cosine / math.pi, *(_light_density(viewer, light, alpha) for alpha in candidates)]) * is_above
    return (torch.from_numpy(light).float(), torch.from_numpy(viewer).float()), cosine * is_above, lobes


def _sample_visible_normal(viewer: Array, alpha: tuple[float, float], u: Array, v: Array) -> Array:
    """Return normals of facets that the viewer sees, of GGX roughness alpha (Dupuy and Benyoub 2023: a spherical cap).

    Args:
        viewer: directions [..., 3].
        alpha: roughness along two axes.
        u: uniform numbers in [0, 1), [...].
        v: uniform numbers in [0, 1), [...].

    Returns:
        Unit vectors [..., 3].
    """
    stretched = viewer * [*alpha, 1]
    stretched /= np.linalg.norm(stretched, axis=-1, keepdims=True)
    z = (1 - u) * (1 + stretched[..., 2]) - stretched[..., 2]
    sine, azimuth = np.sqrt(np.clip(1 - z * z, 0, 1)), 2 * math.pi * v
    half = (np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), z], -1) + stretched) * [*alpha, 1]
    result: Array = half / np.linalg.norm(half, axis=-1, keepdims=True)
    return result


def _light_density(viewer: Array, light: Array, alpha: tuple[float, float]) -> Array:
    """Return the density per sr of light drawn by mirroring the viewer at a visible facet: D G1 / (4 cos theta_o).

    Args:
        viewer: directions [..., 3].
        light: directions [..., 3].
        alpha: roughness along two axes.
    """
    half = viewer + light
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    first, second = alpha
    spread = (half[..., 0] / first) ** 2 + (half[..., 1] / second) ** 2 + half[..., 2] ** 2
    distribution = 1 / (math.pi * first * second * spread**2)
    cosine = viewer[..., 2]
    # masking is G1 / cosine, finite at grazing angles
    slope = (first * viewer[..., 0]) ** 2 + (second * viewer[..., 1]) ** 2
    masking = 2 / (cosine + np.sqrt(slope + cosine**2))
    result: Array = distribution * masking / 4
    return result
