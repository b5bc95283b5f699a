"""Image quilting: a picture of blocks of an exemplar that agree where they overlap (Efros & Freeman 2001)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

FloatImage = NDArray[np.floating]
PixelMask = NDArray[np.bool_]
OVERLAP_TOLERANCE = 0.1  # as published: blocks whose overlaps differ by so much more than the best one's are as good
PHASE_TOLERANCE_PX = 1.0  # distance from a place of the same phase within which a block is in phase


def choose_block_size(exemplar: FloatImage) -> tuple[int, int]:
    """Side of a block, a quarter of the exemplar [H, W, C], and of the overlap, in px."""
    block = max(2, min(exemplar.shape[:2]) // 4)
    return block, max(1, round(block / 6))


def quilt(
    exemplar: FloatImage,
    size: tuple[int, int],
    rng: np.random.Generator,
    *,
    block: int,
    overlap: int,
    tiles: bool = False,
    frequencies: FloatImage | None = None,
) -> FloatImage:
    """A picture [h, w, C] of blocks of an exemplar [H, W, C], each cut from its neighbours where both agree most.

    Args:
        exemplar: at least as high and wide as a block.
        size: h and w in px.
        rng: chooses among blocks that agree about as well.
        block: side of a square block in px.
        overlap: of neighbours, at least, in px.
        tiles: blocks agree across the edges of the picture, too.
        frequencies: of the exemplar's lattice, [1 or 2, 2] (y, x) in cycles per px; all blocks are in phase with the
            first one. None for blocks of any phase.
    """
    height, width = size
    places = [_places(length, block - overlap, tiles=tiles) for length in size]
    over = [block - max(np.diff([*of, of[-1] + block - overlap])) for of in places]
    beyond = 0 if tiles else block  # cut off at the end
    result = np.zeros((height + beyond, width + beyond), np.intp)  # numbers of px of the exemplar, row by row
    colours = exemplar.reshape(-1, exemplar.shape[2])
    pixels, numbers = colours.astype(float), np.arange(len(colours)).reshape(exemplar.shape[:2])
    find = _finder(exemplar, block, frequencies)
    for i, top in enumerate(places[0]):
        for j, left in enumerate(places[1]):
            rows = (top + np.arange(block)) % len(result)
            columns = (left + np.arange(block)) % result.shape[1]
            there = result[np.ix_(rows, columns)]
            part = pixels[there]
            sides = (i > 0, j > 0, tiles and i == len(places[0]) - 1, tiles and j == len(places[1]) - 1)
            y, x = find(part, _shared(block, over, sides), (top, left), rng)
            patch = numbers[y : y + block, x : x + block]
            result[np.ix_(rows, columns)] = np.where(_taken(part, pixels[patch], over, sides), patch, there)
    return colours[result[:height, :width]]


OccupiedSides = tuple[bool, bool, bool, bool]
"""True if there is something above a block, before it, below it, behind it."""


def _places(length: int, step: int, *, tiles: bool) -> list[int]:
    """The first px of blocks; even if the picture tiles, as far as whole px allow."""
    if not tiles:
        return list(range(0, length, step))
    count = -(-length // step)
    return [round(i * length / count) for i in range(count)]


BlockFinder = Callable[[FloatImage, PixelMask, tuple[int, int], np.random.Generator], tuple[int, int]]


def _finder(exemplar: FloatImage, block: int, frequencies: FloatImage | None) -> BlockFinder:
    """Make the search for a block of the exemplar that agrees with the picture: its errors are correlations."""
    height, width, _ = exemplar.shape
    size = (height, width)
    channels = np.fft.rfft2(exemplar, axes=(0, 1))
    squares = np.fft.rfft2(np.square(exemplar).sum(2))
    rows, columns = height - block + 1, width - block + 1
    places = np.moveaxis(np.indices((rows, columns)), 0, 2)
    first = np.zeros(2)  # of the first block, from its place in the picture to that in the exemplar

    def find(part: FloatImage, shared: PixelMask, place: tuple[int, int], rng: np.random.Generator) -> tuple[int, int]:
        if not shared.any():
            found = int(rng.integers(rows)), int(rng.integers(columns))
            first[:] = np.subtract(found, place)
            return found
        there = np.fft.rfft2(part * shared[..., None], size, axes=(0, 1))
        product = squares * np.conj(np.fft.rfft2(shared, size)) - 2 * (channels * np.conj(there)).sum(2)
        error = np.fft.irfft2(product, size)[:rows, :columns] + np.square(part[shared]).sum()
        error = np.maximum(error, 1e-6)
        if frequencies is not None:
            in_phase = _in_phase(places - place - first, frequencies)
            error = np.where(in_phase, error, np.inf) if in_phase.any() else error
        good = np.argwhere(error <= (1 + OVERLAP_TOLERANCE) * error.min())
        i, j = good[rng.integers(len(good))]
        return int(i), int(j)

    return find


def _in_phase(shifts: FloatImage, frequencies: FloatImage) -> PixelMask:
    """Shifts [..., 2] that are within PHASE_PX of a lattice's."""
    cycles = shifts @ frequencies.T
    beside = (cycles - cycles.round()) / np.linalg.norm(frequencies, axis=1)
    result: PixelMask = np.square(beside).sum(-1) <= PHASE_TOLERANCE_PX**2
    return result


def _shared(block: int, over: list[int], sides: OccupiedSides) -> PixelMask:
    """Which px [block, block] of a block are there already."""
    shared = np.zeros((block, block), bool)
    above, before, below, behind = sides
    shared[: over[0]] |= above
    shared[:, : over[1]] |= before
    shared[block - over[0] :] |= below
    shared[:, block - over[1] :] |= behind
    return shared


def _taken(part: FloatImage, patch: FloatImage, over: list[int], sides: OccupiedSides) -> PixelMask:
    """Which px [block, block] are taken from the patch: those beyond the cuts."""
    differs = np.square(part - patch).sum(2)
    mask = np.ones(differs.shape, bool)
    for there, turns, width in zip(sides, (3, 0, 1, 2), (over[0], over[1], over[0], over[1]), strict=True):
        if there:  # turned so that what is there is before the block
            turned = np.rot90(mask, -turns)
            turned[:, :width] &= cut_mask(np.rot90(differs, -turns)[:, :width])
    return mask


def cut_mask(cost: FloatImage) -> PixelMask:
    """Which entries lie on or beyond the path from top to bottom of least total cost, one entry a row, [H, W]."""
    height, width = cost.shape
    total = cost.copy()
    for row in range(1, height):
        above = total[row - 1]
        least = above.copy()
        np.minimum(least[1:], above[:-1], out=least[1:])
        np.minimum(least[:-1], above[1:], out=least[:-1])
        total[row] += least
    path = np.empty(height, int)
    path[-1] = total[-1].argmin()
    for row in range(height - 2, -1, -1):
        low = max(path[row + 1] - 1, 0)
        path[row] = low + total[row, low : path[row + 1] + 2].argmin()
    result: PixelMask = np.arange(width) >= path[:, None]
    return result
