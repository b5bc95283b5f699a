"""Order in pictures: the lattice on which a texture repeats, and how much of it a picture keeps.

Vectors are (y, x), in texels.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d, pad

SHORTEST_VECTOR_TEXELS, LONGEST_VECTOR_SIDES = 6.0, 0.36  # of a lattice vector: texels, and sides of the picture
MIN_PEAK_CORRELATION = 0.08  # of a peak
MAX_PEAKS = 40  # that bases are sought among
VECTOR_LENGTH_COST = 0.0006 * 256  # what a vector's length, in sides of the picture, takes off its correlation
MIN_BASIS_SINE = 0.4  # of the angle between two basis vectors
MIN_LATTICE_SCORE = 0.15  # of an ordered picture
MAX_PEAK_SHIFT_PX = 2  # by which a peak may move and still count as kept


class Lattice(NamedTuple):
    """The lattice by which a texture repeats.

    Attributes:
        vectors: [2, 2], the basis, shortest vectors first; the second one 0 if there is one direction alone.
        heights: correlations at these, [2].
        score: of the basis, about 0.3 to 0.9 for walls and weaves and below 0.1 for grass; -1 if there is none.
    """

    vectors: Tensor
    heights: Tensor
    score: float


def subtract_local_mean(image: Tensor, side: int) -> Tensor:
    """Images [..., C, H, W] less the mean of their surroundings, a square of `side` px, an odd number; mean 0."""
    centred = image - image.mean((-1, -2), keepdim=True)
    return centred - _around(centred, side)


def even_out_brightness(photos: Tensor) -> Tensor:
    """Photos [..., C, H, W] whose light falls off, as if all places were as bright as the mean."""
    around = _around(photos, min(photos.shape[-2:]) // 4 | 1).clamp_min(0.02)
    return photos * around.mean((-1, -2), keepdim=True) / around


def remove_quadratic_trend(image: Tensor) -> Tensor:
    """A picture [C, H, W] without its slow change, the quadratic in x and y that fits each channel best."""
    y, x = (torch.linspace(-1, 1, side, dtype=image.dtype, device=image.device) for side in image.shape[-2:])
    y, x = y[:, None].expand(image.shape[-2:]), x.expand(image.shape[-2:])
    terms = torch.stack([torch.ones_like(x), x, y, x * x, x * y, y * y]).flatten(1)
    basis = torch.linalg.qr(terms.T)[0][:, 1:]  # orthonormal; the mean stays
    slow = image.flatten(1) @ basis @ basis.T
    flat: Tensor = image - slow.unflatten(1, image.shape[-2:])
    return flat


def _around(image: Tensor, side: int) -> Tensor:
    """The mean of the surroundings of each px of images [..., H, W], a square of `side` px, an odd number."""
    border = min(side // 2, min(image.shape[-2:]) - 1)
    padded = pad(image.reshape(-1, 1, *image.shape[-2:]), (border,) * 4, mode="reflect")
    for edge in ((0, 0, 1, 0), (1, 0, 0, 0)):  # by sums, which take as long whatever the side is
        axis = -1 if edge[0] else -2
        sums, count = pad(padded.cumsum(axis), edge), image.shape[axis]
        padded = (sums.narrow(axis, 2 * border + 1, count) - sums.narrow(axis, 0, count)) / (2 * border + 1)
    return padded.reshape(image.shape)


def autocorrelation(image: Tensor) -> Tensor:
    """Correlation [2H, 2W] of a picture [C, H, W] with itself, by shift; shift 0, where it is 1, is at [H, W].

    Of structure finer than a quarter of the picture; all channels together; each shift by how much overlaps.
    """
    height, width = image.shape[-2:]
    size = (2 * height, 2 * width)
    fine = subtract_local_mean(image, min(height, width) // 4 | 1)
    power = torch.fft.rfft2(fine, s=size).abs().square().sum(0)
    ones = torch.fft.rfft2(torch.ones(height, width, dtype=image.dtype, device=image.device), s=size)
    overlap = torch.fft.irfft2(ones.abs().square(), s=size)
    shifted = torch.fft.irfft2(power, s=size) / overlap.clamp_min(height * width / 9)
    return torch.roll(shifted / shifted[0, 0].clamp_min(1e-12), (height, width), (0, 1))


def find_lattice(image: Tensor) -> Lattice:
    """The lattice of a picture [C, H, W], of at least 16 px a side."""
    image = image.double().cpu()
    correlation = autocorrelation(image)
    basis = _basis(_peaks(correlation, image.shape[-2:]), min(image.shape[-2:]))
    vectors, heights = torch.zeros(2, 2, dtype=image.dtype), torch.zeros(2, dtype=image.dtype)
    for i, (height, y, x) in enumerate(basis[1]):
        vectors[i], heights[i] = _refined(correlation, y, x), height
    return Lattice(vectors, heights, basis[0])


def _refined(correlation: Tensor, y: int, x: int) -> Tensor:
    """A lattice vector [2] to a part of a texel, by the peaks at its multiples up to 0.7 of the picture's side."""
    height, width = (side // 2 for side in correlation.shape)
    first = torch.tensor([y, x], dtype=correlation.dtype)
    vector, times = first, 1
    while all(abs(float(part)) * (times + 1) < 0.7 * side for part, side in zip(vector, (height, width), strict=True)):
        times += 1
        row, column = (round(float(part)) for part in vector * times + torch.tensor([height, width]))
        near = correlation[
            row - MAX_PEAK_SHIFT_PX : row + MAX_PEAK_SHIFT_PX + 1,
            column - MAX_PEAK_SHIFT_PX : column + MAX_PEAK_SHIFT_PX + 1,
        ]
        if float(near.max()) < MIN_PEAK_CORRELATION:
            break
        down, across = divmod(int(near.argmax()), near.shape[1])
        row, column = row - MAX_PEAK_SHIFT_PX + down, column - MAX_PEAK_SHIFT_PX + across
        part = torch.stack(
            [_top(correlation[row - 1 : row + 2, column]), _top(correlation[row, column - 1 : column + 2])]
        )
        refined = (torch.tensor([row - height, column - width], dtype=vector.dtype) + part) / times
        if float((refined - first).abs().max()) > MAX_PEAK_SHIFT_PX:  # no peaks, a slope: it would lead to shift 0
            break
        vector = refined
    return vector


def _top(values: Tensor) -> Tensor:
    """The place of the maximum of the parabola through three values, from the middle one, in [-0.5, 0.5]."""
    before, middle, behind = values
    top: Tensor = 0.5 * (before - behind) / (before - 2 * middle + behind).clamp_max(-1e-12)
    return top.clamp(-0.5, 0.5)


def _peaks(correlation: Tensor, size: torch.Size) -> list[tuple[float, int, int]]:
    """Correlations and shifts (y, x) of the highest local maxima in one half of the plane, highest first."""
    height, width = size
    local = correlation[None, None]
    for window in ((9, 1), (1, 9)):
        local = max_pool2d(local, window, stride=1, padding=(window[0] // 2, window[1] // 2))
    peaks = []
    for row, column in ((correlation == local[0, 0]) & (correlation > MIN_PEAK_CORRELATION)).nonzero().tolist():
        y, x = row - height, column - width
        reaches = abs(y) <= LONGEST_VECTOR_SIDES * height and abs(x) <= LONGEST_VECTOR_SIDES * width
        if (y, x) > (0, 0) and reaches and math.hypot(y, x) >= SHORTEST_VECTOR_TEXELS:
            peaks.append((float(correlation[row, column]), y, x))
    return sorted(peaks, reverse=True)[:MAX_PEAKS]


def _basis(peaks: list[tuple[float, int, int]], side: int) -> tuple[float, list[tuple[float, int, int]]]:
    """Score and peaks of the best basis: two strong, short, independent ones, or one."""
    best: tuple[float, list[tuple[float, int, int]]] = (-1.0, [])
    for i, (height, y, x) in enumerate(peaks):
        alone = height / 2 - VECTOR_LENGTH_COST * math.hypot(y, x) / side
        best = max(best, (alone, [peaks[i]]))
        for other in peaks[i + 1 :]:
            lengths = math.hypot(y, x), math.hypot(*other[1:])
            if abs(y * other[2] - x * other[1]) >= MIN_BASIS_SINE * math.prod(lengths):
                score = (height + other[0]) / 2 - VECTOR_LENGTH_COST * sum(lengths) / side
                best = max(best, (score, [peaks[i], other]))
    return best


def kept_order_share(exemplar: Lattice, made: Tensor) -> float:
    """The share of an exemplar's order that a picture [C, H, W] of the same scale keeps.

    The peaks of its autocorrelation at the exemplar's lattice, which may have moved by SHIFT_PX, over the
    exemplar's: 1 for as much order, 0 for none; NaN if the exemplar has none.
    """
    correlation, (height, width) = autocorrelation(made.double().cpu()), made.shape[-2:]
    kept = []
    for vector, peak in zip(exemplar.vectors, exemplar.heights, strict=True):
        if float(peak) > 0:
            y, x = (round(float(part)) + size for part, size in zip(vector, (height, width), strict=True))
            near = correlation[
                y - MAX_PEAK_SHIFT_PX : y + MAX_PEAK_SHIFT_PX + 1, x - MAX_PEAK_SHIFT_PX : x + MAX_PEAK_SHIFT_PX + 1
            ]
            kept.append(max(0.0, float(near.max() / peak)))
    return sum(kept) / len(kept) if kept and exemplar.score > MIN_LATTICE_SCORE else math.nan
