"""Image quilting: a picture of blocks of an exemplar that agree where they overlap (Efros & Freeman 2001).

The method is by itself and knows neither networks nor tasks; textures begin with it, and baselines consist of it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

FloatImage = NDArray[np.floating]
PixelMask = NDArray[np.bool_]
OVERLAP_TOLERANCE = 0.1  # as published: blocks whose error exceeds the least error by up to this share count as good
AVOIDED_WEIGHT = 2.0  # error of a block of px to be avoided alone, over the mean error of all blocks
PHASE_TOLERANCE_PX = 1.0  # distance from a place of equal phase within which a block counts as in phase


def choose_block_size(exemplar: FloatImage) -> tuple[int, int]:
    """Choose the side of a block, a quarter of the exemplar's shorter side, and the overlap of blocks.

    Args:
        exemplar: [H, W, C].

    Returns:
        Side and overlap in px.
    """
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
    """Make a picture [h, w, C] of blocks of an exemplar [H, W, C], each cut from its neighbours where both agree most.

    See :func:`quilt_pixel_numbers` for the arguments.
    """
    numbers = quilt_pixel_numbers(
        exemplar, size, rng, block=block, overlap=overlap, tiles=tiles, frequencies=frequencies
    )
    result: FloatImage = exemplar.reshape(-1, exemplar.shape[2])[numbers]
    return result


def quilt_pixel_numbers(
    exemplar: FloatImage,
    size: tuple[int, int],
    rng: np.random.Generator,
    *,
    block: int,
    overlap: int,
    tiles: bool = False,
    frequencies: FloatImage | None = None,
    repetition_weight: float = 0.0,
    avoided: PixelMask | None = None,
) -> NDArray[np.intp]:
    """Return the number of the exemplar's px, counted row by row, for each px [h, w] of a quilt.

    Args:
        exemplar: at least as high and wide as a block.
        size: h and w in px.
        rng: chooses among blocks that agree about as well.
        block: side of a square block in px.
        overlap: least overlap of neighbouring blocks in px.
        tiles: whether blocks agree across the edges of the picture, too.
        frequencies: frequencies of the exemplar's lattice, [1 or 2, 2] (y, x) in cycles per px; all blocks are in phase
            with the first one. None for blocks of any phase.
        repetition_weight: by how much larger the error of a block counts, as a share of it, if the picture shows all
            of the block already within half the exemplar's sides; of a part of it in proportion. 0, as published, for
            blocks that may come back anywhere.
        avoided: the exemplar's px, bool [H, W], that blocks show only if nothing else fits; None for none.
    """
    height, width = size
    starts = [_block_starts(length, block - overlap, tiles=tiles) for length in size]
    overlaps = [block - max(np.diff([*axis_starts, axis_starts[-1] + block - overlap])) for axis_starts in starts]
    margin = 0 if tiles else block  # px beyond the picture, cut off at the end
    # for each px of the picture its px of the exemplar, counted row by row
    exemplar_px = np.zeros((height + margin, width + margin), np.intp)
    is_filled = np.zeros(exemplar_px.shape, bool)
    colours = exemplar.reshape(-1, exemplar.shape[2])
    pixels, numbers = colours.astype(float), np.arange(len(colours)).reshape(exemplar.shape[:2])
    find = _make_block_finder(exemplar, block, frequencies, None if avoided is None else _block_means(avoided, block))
    for i, top in enumerate(starts[0]):
        for j, left in enumerate(starts[1]):
            rows = (top + np.arange(block)) % len(exemplar_px)
            columns = (left + np.arange(block)) % exemplar_px.shape[1]
            present = exemplar_px[np.ix_(rows, columns)]
            known_pixels = pixels[present]
            occupied = (i > 0, j > 0, tiles and i == len(starts[0]) - 1, tiles and j == len(starts[1]) - 1)
            known = _overlap_mask(block, overlaps, occupied)
            factors: FloatImage = np.ones((1, 1))
            if repetition_weight:
                is_filled[np.ix_(rows, columns)] = False  # a block may show again what lies below it
                near_rows, near_columns = (
                    _is_near(start + block // 2, side // 2, length, tiles=tiles)
                    for start, side, length in zip((top, left), exemplar.shape[:2], exemplar_px.shape, strict=True)
                )
                is_shown = np.zeros(numbers.shape, bool)
                is_shown.flat[exemplar_px[is_filled & near_rows[:, None] & near_columns]] = True
                factors = 1 + repetition_weight * _block_means(is_shown, block)
                is_filled[np.ix_(rows, columns)] = True
            y, x = find(known_pixels, known, (top, left), factors, rng)
            patch = numbers[y : y + block, x : x + block]
            exemplar_px[np.ix_(rows, columns)] = np.where(
                _patch_mask(known_pixels, pixels[patch], overlaps, occupied), patch, present
            )
    return exemplar_px[:height, :width]


def _is_near(middle: int, reach: int, length: int, *, tiles: bool) -> PixelMask:
    """Return which px along an axis of `length` px are at most `reach` px from `middle`, also across edges of tiles."""
    distances = np.abs(np.arange(length) - middle % length)
    if tiles:
        distances = np.minimum(distances, length - distances)
    result: PixelMask = distances <= reach
    return result


def _block_means(values: PixelMask, block: int) -> FloatImage:
    """Return the mean of each square block [H - block + 1, W - block + 1] of values [H, W]."""
    sums = np.pad(values.cumsum(0, np.int32).cumsum(1, np.int32), ((1, 0), (1, 0)))
    sums = sums[block:] - sums[:-block]
    means: FloatImage = (sums[:, block:] - sums[:, :-block]) / block**2
    return means


OccupiedSides = tuple[bool, bool, bool, bool]
"""Whether the picture is filled already above a block, left of it, below it, and right of it."""


def _block_starts(length: int, step: int, *, tiles: bool) -> list[int]:
    """Return the first px of blocks along an axis; if the picture tiles, as evenly spread as whole px allow."""
    if not tiles:
        return list(range(0, length, step))
    count = -(-length // step)
    return [round(i * length / count) for i in range(count)]


BlockFinder = Callable[[FloatImage, PixelMask, tuple[int, int], FloatImage, np.random.Generator], tuple[int, int]]
"""Finds a block of the exemplar, (y, x), by known pixels, where they are known, the block's place in the picture,
factors of the errors of all blocks, and a generator."""


def _make_block_finder(
    exemplar: FloatImage, block: int, frequencies: FloatImage | None, avoided_shares: FloatImage | None
) -> BlockFinder:
    """Return a search for blocks of the exemplar that agree with the picture where it is known.

    The errors of all blocks are correlations, computed by Fourier transforms.

    Args:
        exemplar: [H, W, C].
        block: side of a block in px.
        frequencies: see :func:`quilt_pixel_numbers`.
        avoided_shares: the share of px to be avoided of each block, [H - block + 1, W - block + 1]; None for none.
    """
    height, width, _ = exemplar.shape
    size = (height, width)
    channel_spectra = np.fft.rfft2(exemplar, axes=(0, 1))
    square_spectrum = np.fft.rfft2(np.square(exemplar).sum(2))
    rows, columns = height - block + 1, width - block + 1
    positions = np.moveaxis(np.indices((rows, columns)), 0, 2)
    first_shift = np.zeros(2)  # shift of the first block, from its place in the picture to its place in the exemplar

    def find(
        known_pixels: FloatImage,
        known: PixelMask,
        start: tuple[int, int],
        factors: FloatImage,
        rng: np.random.Generator,
    ) -> tuple[int, int]:
        if not known.any():
            if avoided_shares is not None:
                best_starts = np.argwhere(avoided_shares <= avoided_shares.min())
                y, x = best_starts[rng.integers(len(best_starts))]
            else:
                y, x = rng.integers(rows), rng.integers(columns)
            found = int(y), int(x)
            first_shift[:] = np.subtract(found, start)
            return found
        known_channels = np.fft.rfft2(known_pixels * known[..., None], size, axes=(0, 1))
        product = square_spectrum * np.conj(np.fft.rfft2(known, size)) - 2 * (
            channel_spectra * np.conj(known_channels)
        ).sum(2)
        error = np.fft.irfft2(product, size)[:rows, :columns] + np.square(known_pixels[known]).sum()
        error = np.maximum(error, 1e-6) * factors
        if avoided_shares is not None:  # what goes on in the exemplar has no error, so that a factor would not do
            error = error + AVOIDED_WEIGHT * avoided_shares * error.mean()
        if frequencies is not None:
            in_phase = _is_in_phase(positions - start - first_shift, frequencies)
            error = np.where(in_phase, error, np.inf) if in_phase.any() else error
        candidates = np.argwhere(error <= (1 + OVERLAP_TOLERANCE) * error.min())
        i, j = candidates[rng.integers(len(candidates))]
        return int(i), int(j)

    return find


def _is_in_phase(shifts: FloatImage, frequencies: FloatImage) -> PixelMask:
    """Return which shifts [..., 2] are within PHASE_TOLERANCE_PX of a shift by which the lattice maps to itself."""
    cycles = shifts @ frequencies.T
    distances = (cycles - cycles.round()) / np.linalg.norm(frequencies, axis=1)
    result: PixelMask = np.square(distances).sum(-1) <= PHASE_TOLERANCE_PX**2
    return result


def _overlap_mask(block: int, overlaps: list[int], occupied: OccupiedSides) -> PixelMask:
    """Return which px [block, block] of a block are in the picture already.

    Args:
        block: side of a block in px.
        overlaps: overlap of blocks along y and x in px.
        occupied: which sides of the block are filled.
    """
    known = np.zeros((block, block), bool)
    above, left, below, right = occupied
    known[: overlaps[0]] |= above
    known[:, : overlaps[1]] |= left
    known[block - overlaps[0] :] |= below
    known[:, block - overlaps[1] :] |= right
    return known


def _patch_mask(known_pixels: FloatImage, patch: FloatImage, overlaps: list[int], occupied: OccupiedSides) -> PixelMask:
    """Return which px [block, block] are taken from the patch: all px beyond the cuts of least difference.

    Args:
        known_pixels: the picture's pixels at the block, [block, block, C].
        patch: the block of the exemplar, [block, block, C].
        overlaps: overlap of blocks along y and x in px.
        occupied: which sides of the block are filled.
    """
    squared_differences = np.square(known_pixels - patch).sum(2)
    mask = np.ones(squared_differences.shape, bool)
    for is_filled, turns, width in zip(
        occupied, (3, 0, 1, 2), (overlaps[0], overlaps[1], overlaps[0], overlaps[1]), strict=True
    ):
        if is_filled:  # turned so that the filled side is on the left
            turned = np.rot90(mask, -turns)
            turned[:, :width] &= cut_mask(np.rot90(squared_differences, -turns)[:, :width])
    return mask


def cut_mask(cost: FloatImage) -> PixelMask:
    """Return which entries lie on or right of the path of least total cost from top to bottom, bool [H, W].

    Args:
        cost: [H, W]; the path has one entry in each row, at most one column from the entry above.
    """
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
