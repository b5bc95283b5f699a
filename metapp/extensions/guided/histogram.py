"""Directional histograms of incident light: their estimates from few paths, and tables to sample them by.

Paths are sampled by the root of the second moment of their radiance, the density of least variance (Rath et al. 2020).
Moments are estimated coarse to fine, in voxels and in directions, so that bins with few paths get the estimate of the
bins around them.

A table samples by the alias method (Walker 1977): a word for each bin says how many of all PROBABILITY_SLOTS it has,
which other bin is sampled in its place, and how often. Nothing here knows of Mitsuba.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

GRID_SIDE_VOXELS, HISTOGRAM_SIDE_BINS = 16, 16  # voxels along an axis, bins along a side of the hemisphere
NORMAL_AXES = 6  # directions of normals: along x, y and z, either way
CACHE_ENTRIES = GRID_SIDE_VOXELS**3 * NORMAL_AXES  # an entry is a voxel and the axis nearest to the normal
HISTOGRAM_BINS = HISTOGRAM_SIDE_BINS * HISTOGRAM_SIDE_BINS  # at most 256, as a byte numbers them
PROBABILITY_SLOTS = HISTOGRAM_BINS * HISTOGRAM_BINS  # equal parts of a histogram's probability
UNIFORM_DENSITY_DIVISOR = 8  # the density of a bin is at least the uniform density divided by it
PRIOR_PATHS = 16.0  # the coarser estimate counts as so many paths
# The density is this power of second moments. The density of least variance is their root, 0.5, but by few paths some
# bins seem too bright.
SECOND_MOMENT_POWER = 0.4
# A word has, from its lowest byte on: the other bin; how many of HISTOGRAM_BINS draws are the bin's own; its slots.
BYTE_BITS = 8

_TINY = 1e-300  # keeps divisors above 0
_LOG_FLOOR = 1e-6  # of the brightest bin, added before logarithms

MomentPrior = Callable[[Tensor, Tensor, Tensor], Tensor]
"""A function of the arguments of :func:`second_moments` that expects second moments in voxels of twice the side."""


def voxels_of_entries(entries: Tensor) -> Tensor:
    """Return the indices z, y and x of the voxels of entries [P], and their axes, [P, 4]."""
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
    """Return the voxels of twice the side around voxels [P, 4], with their axes, [P, 4]."""
    return torch.cat([voxels[:, :3] // 2, voxels[:, 3:]], 1)


def coarsen_sums(squares: Tensor, counts: Tensor, voxels: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Add sums over voxels to sums over voxels of twice the side.

    Args:
        squares: sums of squares, [P, SIDE, SIDE], where SIDE is HISTOGRAM_SIDE_BINS.
        counts: sums of counts, [P, SIDE, SIDE].
        voxels: the voxels with their axes, [P, 4].

    Returns:
        Both sums over the Q coarse voxels, [Q, SIDE, SIDE]; the coarse voxels, [Q, 4]; the index of the coarse voxel
        that each voxel belongs to, [P].
    """
    coarse, coarse_index = coarse_voxels(voxels).unique(dim=0, return_inverse=True)
    coarse_squares, coarse_counts = (
        sums.new_zeros(len(coarse), HISTOGRAM_SIDE_BINS, HISTOGRAM_SIDE_BINS).index_add_(0, coarse_index, sums)
        for sums in (squares, counts)
    )
    return coarse_squares, coarse_counts, coarse, coarse_index


def second_moments(squares: Tensor, counts: Tensor, voxels: Tensor) -> Tensor:
    """Estimate the second moment of the light from each bin, coarse to fine, in voxels and in directions.

    The moments of a voxel are the moments of the eight voxels around it, times a ratio, which is estimated for the
    whole hemisphere first, then for quarters of it and so on: where few paths came, it is the ratio of coarser bins.

    Args:
        squares: sums of squared radiance of paths, each divided by the density of its direction, float64
            [P, SIDE, SIDE], where SIDE is HISTOGRAM_SIDE_BINS.
        counts: sums of ones, divided by the same densities: about how many paths uniform directions would have sent
            there, float64 [P, SIDE, SIDE].
        voxels: the voxels of the P entries that :func:`voxels_of_entries` returns, [P, 4].

    Returns:
        The moments, in any scale, float64 [P, SIDE, SIDE].
    """
    if not bool(voxels[:, :3].any()):
        return shrink_moments(
            squares, counts, torch.ones_like(squares), 1e-9
        )  # the whole box has nothing around it to expect moments from
    coarse_squares, coarse_counts, coarse, coarse_index = coarsen_sums(squares, counts, voxels)
    return shrink_moments(squares, counts, second_moments(coarse_squares, coarse_counts, coarse)[coarse_index])


def shrink_moments(squares: Tensor, counts: Tensor, expected: Tensor, prior_paths: float = PRIOR_PATHS) -> Tensor:
    """Estimate the second moments of the light from each bin, shrunk towards expected ones where few paths came.

    Args:
        squares: sums of squared radiance of paths, as :func:`second_moments` takes them, [P, SIDE, SIDE].
        counts: sums of ones, as :func:`second_moments` takes them, [P, SIDE, SIDE].
        expected: the expected moments, [P, SIDE, SIDE].
        prior_paths: how many paths the expected moments count as for the whole hemisphere.

    Returns:
        The moments, [P, SIDE, SIDE].
    """
    levels = [(squares, counts, expected)]
    while levels[-1][0].shape[-1] > 1:
        level_squares, level_counts, level_expected = (_sum_two_by_two(values) for values in levels[-1])
        levels.append((level_squares, level_counts, level_expected / 4))
    level_squares, level_counts, level_expected = levels[-1]
    ratio = (
        (level_squares + prior_paths * level_expected) / (level_counts + prior_paths) / level_expected.clamp_min(_TINY)
    )
    for level_squares, level_counts, level_expected in levels[-2::-1]:
        coarse_estimate = ratio.repeat_interleave(2, -1).repeat_interleave(2, -2) * level_expected
        ratio = (
            (level_squares + PRIOR_PATHS * coarse_estimate)
            / (level_counts + PRIOR_PATHS)
            / level_expected.clamp_min(_TINY)
        )
    return ratio * expected


def log_relative(values: Tensor) -> Tensor:
    """Return the logarithms of values [P, SIDE, SIDE] divided by the geometric mean of each histogram, float32."""
    maximum = values.amax((1, 2), keepdim=True)
    logs = (values / maximum.clamp_min(torch.finfo(values.dtype).tiny) + _LOG_FLOOR).log()
    return (logs - logs.mean((1, 2), keepdim=True)).float()


def _sum_two_by_two(values: Tensor) -> Tensor:
    """Return the sums of values [..., H, W] over two by two bins, [..., H / 2, W / 2]."""
    rows = values[..., ::2, :] + values[..., 1::2, :]
    return rows[..., ::2] + rows[..., 1::2]


def quantise_weights(weights: Tensor) -> Tensor:
    """Divide the slots of each histogram among its bins.

    Args:
        weights: the weights of bins, float64 [P, HISTOGRAM_BINS], not negative, no row all zero.

    Returns:
        The numbers of slots, int32 [P, HISTOGRAM_BINS]: PROBABILITY_SLOTS / HISTOGRAM_BINS / UNIFORM_DENSITY_DIVISOR
        for each bin, and the others by weight; each row sums to PROBABILITY_SLOTS.
    """
    min_slots = PROBABILITY_SLOTS // (HISTOGRAM_BINS * UNIFORM_DENSITY_DIVISOR)
    free_slots = PROBABILITY_SLOTS - HISTOGRAM_BINS * min_slots
    cumulative_slots = (weights.cumsum(1) / weights.sum(1, keepdim=True) * free_slots + 0.5).floor().int()
    cumulative_slots[:, -1] = free_slots
    return cumulative_slots.diff(dim=1, prepend=torch.zeros(len(cumulative_slots), 1, dtype=torch.int32)) + min_slots


def alias_words(slots: NDArray[np.int32]) -> NDArray[np.uint32]:
    """Make the words of the alias method from the slots of bins.

    A word holds another bin, how many of HISTOGRAM_BINS draws are the bin's own, and its slots. In the order of slots,
    draws that the poorest bin does not fill are given to the richest bin, until that one has no more to give than it
    fills itself; then to the next richest (Huebschle-Schneider and Sanders 2019, in sweeps).

    Args:
        slots: the numbers of slots, [P, HISTOGRAM_BINS], PROBABILITY_SLOTS in each row.

    Returns:
        The words, [P, HISTOGRAM_BINS].
    """
    order = slots.argsort(1).astype(np.int32)
    sorted_slots = np.ascontiguousarray(np.take_along_axis(slots, order, 1)).ravel()
    own_draws, other_bin = (np.zeros(slots.size, np.int32) for _ in range(2))
    row_start = np.arange(len(slots)) * HISTOGRAM_BINS
    poor, rich = row_start.copy(), row_start + HISTOGRAM_BINS - 1
    slots_left = sorted_slots[rich]
    for _ in range(HISTOGRAM_BINS - 1):
        gives = slots_left > HISTOGRAM_BINS
        index, filled = np.where(gives, poor, rich), np.where(gives, sorted_slots[poor], slots_left)
        own_draws[index], other_bin[index] = filled, rich - ~gives
        slots_left = filled - HISTOGRAM_BINS + np.where(gives, slots_left, sorted_slots[rich - 1])
        poor += gives
        rich -= ~gives
    own_draws[poor], other_bin[poor] = HISTOGRAM_BINS, poor
    is_full = (
        own_draws == HISTOGRAM_BINS
    )  # a byte cannot hold HISTOGRAM_BINS: all draws go to the other bin, which is the bin itself
    other_bin[is_full] = is_full.nonzero()[0]
    own_draws[is_full] = 0
    other_bin = np.take_along_axis(order, (other_bin - row_start.repeat(HISTOGRAM_BINS)).reshape(slots.shape), 1)
    sorted_words = (
        other_bin | own_draws.reshape(slots.shape) << BYTE_BITS | sorted_slots.reshape(slots.shape) << 2 * BYTE_BITS
    )
    words = np.empty_like(sorted_words)
    np.put_along_axis(words, order, sorted_words, 1)
    return words.view(np.uint32)
