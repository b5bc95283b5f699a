"""Textures out of patches of an exemplar: image quilting (Efros & Freeman 2001), and patches at random."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

Picture = NDArray[np.float32]
Mask = NDArray[np.bool_]

TOLERANCE = 0.1  # as published: patches whose overlaps differ by so much more than the best one's are as good


def block_of(exemplar: Picture) -> tuple[int, int]:
    """Side of a block and of what neighbours share, in px."""
    block = max(2, min(exemplar.shape[:2]) // 4)
    return block, max(1, round(block / 6))


def random_patches(exemplar: Picture, rng: np.random.Generator) -> Picture:
    """A picture of the exemplar's size [H, W, C] of square patches from anywhere in it, side by side."""
    block, _ = block_of(exemplar)
    patches = sliding_window_view(exemplar, (block, block), (0, 1)).transpose(0, 1, 3, 4, 2)
    result = np.empty_like(exemplar)
    for top in range(0, len(exemplar), block):
        for left in range(0, exemplar.shape[1], block):
            part = result[top : top + block, left : left + block]
            part[:] = patches[rng.integers(len(patches)), rng.integers(patches.shape[1])][: len(part), : part.shape[1]]
    return result


def quilted(exemplar: Picture, rng: np.random.Generator) -> Picture:
    """A picture of the exemplar's size [H, W, C]: patches that agree where they overlap, cut where they agree most."""
    height, width, channels = exemplar.shape
    block, overlap = block_of(exemplar)
    step = block - overlap
    patches = sliding_window_view(exemplar, (block, block), (0, 1)).transpose(0, 1, 3, 4, 2)
    rows, columns = (-(-(size - overlap) // step) for size in (height, width))
    result = np.zeros((rows * step + overlap, columns * step + overlap, channels), exemplar.dtype)
    for i in range(rows):
        for j in range(columns):
            part = result[i * step : i * step + block, j * step : j * step + block]
            shared = _shared(block, overlap, above=i > 0, before=j > 0)
            patch = _chosen(patches, part, shared, rng)
            part[:] = np.where(_mask(part, patch, overlap, above=i > 0, before=j > 0)[..., None], patch, part)
    return result[:height, :width]


def _shared(block: int, overlap: int, *, above: bool, before: bool) -> Mask:
    """Which pixels [block, block] of a block are there already."""
    shared = np.zeros((block, block), bool)
    shared[:overlap] |= above
    shared[:, :overlap] |= before
    return shared


def _chosen(patches: Picture, part: Picture, shared: Mask, rng: np.random.Generator) -> Picture:
    """A patch at random of those that agree with what is there about as well as the best."""
    if not shared.any():
        return np.asarray(patches[rng.integers(len(patches)), rng.integers(patches.shape[1])])
    error = np.square(patches[:, :, shared] - part[shared]).sum((2, 3))
    good = np.argwhere(error <= (1 + TOLERANCE) * error.min())
    i, j = good[rng.integers(len(good))]
    return np.asarray(patches[i, j])


def _mask(part: Picture, patch: Picture, overlap: int, *, above: bool, before: bool) -> Mask:
    """Which pixels [block, block] the patch takes: those beyond the cuts."""
    differs = np.square(part - patch).sum(2)
    mask = np.ones(differs.shape, bool)
    if before:
        mask[:, :overlap] &= beyond_cut(differs[:, :overlap])
    if above:
        mask[:overlap] &= beyond_cut(differs[:overlap].T).T
    return mask


def beyond_cut(cost: Picture) -> Mask:
    """Which entries lie on or beyond the path from top to bottom of least total cost, one entry a row, [H, W]."""
    height, width = cost.shape
    total = cost.copy()
    for row in range(1, height):
        padded = np.pad(total[row - 1], 1, constant_values=np.inf)
        total[row] += np.minimum(np.minimum(padded[:-2], padded[1:-1]), padded[2:])
    path = np.empty(height, int)
    path[-1] = total[-1].argmin()
    for row in range(height - 2, -1, -1):
        low = max(path[row + 1] - 1, 0)
        path[row] = low + total[row, low : path[row + 1] + 2].argmin()
    return np.arange(width) >= path[:, None]
