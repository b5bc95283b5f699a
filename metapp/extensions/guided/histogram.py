"""Directional histograms of incident light: their estimates from few paths, and tables to sample them by.

Paths are sampled by the root of the second moment of their radiance, the density of least variance (Rath et al. 2020).
Moments are estimated coarse to fine, in voxels and in directions, so that bins that few paths took get the estimate of
those around them.

A table samples by the alias method (Walker 1977): a word for each bin says how many of all SLOTS it has, and which
other bin is sampled in its place how often.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

GRID_SIDE_VOXELS, HISTOGRAM_SIDE_BINS = 16, 16  # voxels along an axis, bins along a side of the hemisphere
NORMAL_AXES = 6  # of normals
CACHE_ENTRIES = GRID_SIDE_VOXELS**3 * NORMAL_AXES  # of the spatial cache: a voxel and the axis nearest to the normal
HISTOGRAM_BINS = HISTOGRAM_SIDE_BINS * HISTOGRAM_SIDE_BINS  # no more than a byte tells apart
PROBABILITY_SLOTS = HISTOGRAM_BINS * HISTOGRAM_BINS  # that a histogram's probability is divided into
UNIFORM_DENSITY_DIVISOR = 8  # a bin's density is at least one in so many of the uniform one
PRIOR_PATHS = 16.0  # paths that the coarser estimate counts as
SECOND_MOMENT_POWER = (
    0.4  # of second moments; the density of least variance is the root, but a few paths make bins too bright
)
BYTE_BITS = 8  # bits; a word is, from below: the other bin, the draws of BINS that are not the other's, slots

_TINY = 1e-300
_LOG_FLOOR = 1e-6  # of the brightest bin

MomentPrior = Callable[[Tensor, Tensor, Tensor], Tensor]
"""Second moments that are expected in voxels of twice the side, of the arguments of `second_moments`."""


def voxels_of_entries(entries: Tensor) -> Tensor:
    """The indices z, y and x of the voxels of entries, and their axes, [P, 4]."""
    voxel = entries // NORMAL_AXES
    return torch.stack(
        [
            voxel // GRID_SIDE_VOXELS**2,
            voxel // GRID_SIDE_VOXELS % GRID_SIDE_VOXELS,
            voxel % GRID_SIDE_VOXELS,
            entries % NORMAL_AXES,
        ],
        1,
    )


def coarse_voxels(voxels: Tensor) -> Tensor:
    """The voxels of twice the side around voxels, and the same axes, [P, 4]."""
    return torch.cat([voxels[:, :3] // 2, voxels[:, 3:]], 1)


def coarsen_sums(squares: Tensor, counts: Tensor, voxels: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Both sums over voxels of twice the side, these voxels, and the index of the one that each voxel belongs to."""
    coarse, parent = coarse_voxels(voxels).unique(dim=0, return_inverse=True)
    total, count = (
        sums.new_zeros(len(coarse), HISTOGRAM_SIDE_BINS, HISTOGRAM_SIDE_BINS).index_add_(0, parent, sums)
        for sums in (squares, counts)
    )
    return total, count, coarse, parent


def second_moments(squares: Tensor, counts: Tensor, voxels: Tensor) -> Tensor:
    """The second moment of the light from each bin, coarse to fine, in voxels and in directions.

    A voxel's are those of the eight around it, times a ratio, which is estimated for the whole hemisphere first, then
    for quarters of it and so on: where few paths came, it is that of the coarser bins.

    Args:
        squares: sums of squared radiance of paths, each over the density of its direction, float64 [P, SIDE, SIDE].
        counts: sums of one over the same densities: about how many paths uniform directions would have sent there.
        voxels: of the P entries, as of `voxels_of_entries`, [P, 4].

    Returns:
        of the same shape, of any scale.
    """
    if not bool(voxels[:, :3].any()):
        return shrink_moments(squares, counts, torch.ones_like(squares), 1e-9)  # the whole box has no prior
    total, count, coarse, parent = coarsen_sums(squares, counts, voxels)
    return shrink_moments(squares, counts, second_moments(total, count, coarse)[parent])


def shrink_moments(squares: Tensor, counts: Tensor, expected: Tensor, prior_paths: float = PRIOR_PATHS) -> Tensor:
    """Second moments of the light from each bin, shrunk towards expected ones where few paths came.

    Args:
        squares, counts: as of `second_moments`.
        expected: of the same shape.
        prior_paths: paths that it counts as for the whole hemisphere.
    """
    levels = [(squares, counts, expected)]
    while levels[-1][0].shape[-1] > 1:
        total, count, prior = (_in_quarters(values) for values in levels[-1])
        levels.append((total, count, prior / 4))
    total, count, prior = levels[-1]
    ratio = (total + prior_paths * prior) / (count + prior_paths) / prior.clamp_min(_TINY)
    for total, count, prior in levels[-2::-1]:
        around = ratio.repeat_interleave(2, -1).repeat_interleave(2, -2) * prior
        ratio = (total + PRIOR_PATHS * around) / (count + PRIOR_PATHS) / prior.clamp_min(_TINY)
    return ratio * expected


def log_relative(values: Tensor) -> Tensor:
    """Logarithms of values [P, SIDE, SIDE] over the geometric mean of each histogram, float32."""
    highest = values.amax((1, 2), keepdim=True)
    logs = (values / highest.clamp_min(torch.finfo(values.dtype).tiny) + _LOG_FLOOR).log()
    return (logs - logs.mean((1, 2), keepdim=True)).float()


def _in_quarters(values: Tensor) -> Tensor:
    """Sums of two by two bins."""
    rows = values[..., ::2, :] + values[..., 1::2, :]
    return rows[..., ::2] + rows[..., 1::2]


def quantise_weights(weights: Tensor) -> Tensor:
    """Numbers of slots of the bins.

    Args:
        weights: float64 [P, BINS], not negative, no row all zero.

    Returns:
        int32 [P, BINS]: SLOTS / BINS / DEFENSIVE each, and of the others by weight; SLOTS in each row.
    """
    least = PROBABILITY_SLOTS // (HISTOGRAM_BINS * UNIFORM_DENSITY_DIVISOR)
    free = PROBABILITY_SLOTS - HISTOGRAM_BINS * least
    ends = (weights.cumsum(1) / weights.sum(1, keepdim=True) * free + 0.5).floor().int()
    ends[:, -1] = free
    return ends.diff(dim=1, prepend=torch.zeros(len(ends), 1, dtype=torch.int32)) + least


def alias_words(slots: NDArray[np.int32]) -> NDArray[np.uint32]:
    """Words of the alias method: of each bin another one, how many of BINS draws are not the other's, and its slots.

    In the order of slots, draws that the poorest bin does not fill are the richest one's, until that has no more to
    give than it fills itself; then those of the next richest (Huebschle-Schneider and Sanders 2019, in sweeps).

    Args:
        slots: [P, BINS], SLOTS in each row.

    Returns:
        [P, BINS].
    """
    order = slots.argsort(1).astype(np.int32)
    ordered = np.ascontiguousarray(np.take_along_axis(slots, order, 1)).ravel()
    own, other = (np.zeros(slots.size, np.int32) for _ in range(2))
    first = np.arange(len(slots)) * HISTOGRAM_BINS
    poor, rich = first.copy(), first + HISTOGRAM_BINS - 1
    left = ordered[rich]
    for _ in range(HISTOGRAM_BINS - 1):
        gives = left > HISTOGRAM_BINS
        index, filled = np.where(gives, poor, rich), np.where(gives, ordered[poor], left)
        own[index], other[index] = filled, rich - ~gives
        left = filled - HISTOGRAM_BINS + np.where(gives, left, ordered[rich - 1])
        poor += gives
        rich -= ~gives
    own[poor], other[poor] = HISTOGRAM_BINS, poor
    full = own == HISTOGRAM_BINS  # a byte is too small: all of them are the other's, which is itself
    other[full] = full.nonzero()[0]
    own[full] = 0
    other = np.take_along_axis(order, (other - first.repeat(HISTOGRAM_BINS)).reshape(slots.shape), 1)
    sorted_words = other | own.reshape(slots.shape) << BYTE_BITS | ordered.reshape(slots.shape) << 2 * BYTE_BITS
    words = np.empty_like(sorted_words)
    np.put_along_axis(words, order, sorted_words, 1)
    return words.view(np.uint32)
