"""The lattice on which a texture repeats, and the share of its order that a picture keeps.

Light that changes slowly over a photograph would hide the lattice, so functions that remove such light are here, too.
The module knows pictures, but not how they were made. Vectors are (y, x), in texels.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import max_pool2d, pad

SHORTEST_VECTOR_TEXELS = 6.0  # least length of a lattice vector, texels
LONGEST_VECTOR_SIDES = 0.36  # greatest extent of a lattice vector along each axis, sides of the picture
MIN_PEAK_CORRELATION = 0.08  # least correlation at a peak
MAX_PEAKS = 40  # number of peaks, highest first, of which bases are made
VECTOR_LENGTH_COST = 0.0006 * 256  # penalty on a vector's correlation, per side of the picture of its length
MIN_BASIS_SINE = 0.4  # least sine of the angle between two basis vectors
MIN_LATTICE_SCORE = 0.15  # least score of an ordered picture
MIN_REPETITION_SCORE = 0.3  # least score of a picture that repeats itself
CONTRAST_FACTORS = (0.4, 2.5)  # range of factors by which contrast is evened out
MIN_CONTRAST = 0.004  # standard deviation of display values up to which a place counts as flat
MAX_PEAK_SHIFT_PX = 2  # distance along each axis by which a peak may move and still count as kept


class Lattice(NamedTuple):
    """The lattice by which a texture repeats.

    Attributes:
        vectors: [2, 2], the basis, shortest vectors first; the second one 0 if there is one direction alone.
        correlations: correlations at these vectors, [2].
        score: score of the basis, about 0.3 to 0.9 for walls and weaves and below 0.1 for grass; -1 if there is none.
    """

    vectors: Tensor
    correlations: Tensor
    score: float

    @property
    def repeats(self) -> bool:
        """Whether the texture repeats itself: it is stretched to tile, and equal pieces may come back."""
        return self.score >= MIN_REPETITION_SCORE


def subtract_local_mean(image: Tensor, side: int) -> Tensor:
    """Subtract from images [..., C, H, W] the mean of the surroundings of each px; the result has mean 0.

    Args:
        image: images of any range.
        side: side of the square of surroundings, an odd number of px.
    """
    centred = image - image.mean((-1, -2), keepdim=True)
    return centred - _local_mean(centred, side)


def even_out_brightness(photos: Tensor) -> Tensor:
    """Change photos [..., C, H, W] whose light falls off as if all places were as bright as the mean."""
    local_mean = _local_mean(photos, min(photos.shape[-2:]) // 4 | 1).clamp_min(0.02)
    return photos * local_mean.mean((-1, -2), keepdim=True) / local_mean


def even_out_contrast(photos: Tensor) -> Tensor:
    """Change photos [..., C, H, W] as if the contrast of all places were the mean contrast.

    A flash falls steeply on the borders of a photo and leaves a veil of gloss in its middle, so that the relief of one
    material has strong contrast here and little there. All channels of a place are changed alike, by a factor within
    CONTRAST_FACTORS.
    """
    side = min(photos.shape[-2:])
    local_mean = _local_mean(photos, side // 4 | 1)
    deviation = photos - local_mean
    variance = _local_mean(deviation.square().mean(-3, keepdim=True), side // 2 | 1).clamp_min(MIN_CONTRAST**2)
    factor = (variance.mean((-1, -2), keepdim=True) / variance).sqrt().clamp(*CONTRAST_FACTORS)
    return local_mean + factor * deviation


def remove_quadratic_trend(image: Tensor) -> Tensor:
    """Subtract from a picture [C, H, W] its slow change, the quadratic in x and y that fits each channel best."""
    y, x = (torch.linspace(-1, 1, side, dtype=image.dtype, device=image.device) for side in image.shape[-2:])
    y, x = y[:, None].expand(image.shape[-2:]), x.expand(image.shape[-2:])
    terms = torch.stack([torch.ones_like(x), x, y, x * x, x * y, y * y]).flatten(1)
    basis = torch.linalg.qr(terms.T)[0][:, 1:]  # orthonormal; the mean stays
    trend = image.flatten(1) @ basis @ basis.T
    detrended: Tensor = image - trend.unflatten(1, image.shape[-2:])
    return detrended


def _local_mean(image: Tensor, side: int) -> Tensor:
    """Return the mean of the surroundings of each px of images [..., H, W].

    Args:
        image: images of any range; they are mirrored at their borders.
        side: side of the square of surroundings, an odd number of px.
    """
    border = min(side // 2, min(image.shape[-2:]) - 1)
    padded = pad(image.reshape(-1, 1, *image.shape[-2:]), (border,) * 4, mode="reflect")
    for edge in ((0, 0, 1, 0), (1, 0, 0, 0)):  # by differences of cumulated sums, whose time does not depend on `side`
        axis = -1 if edge[0] else -2
        sums, count = pad(padded.cumsum(axis), edge), image.shape[axis]
        padded = (sums.narrow(axis, 2 * border + 1, count) - sums.narrow(axis, 0, count)) / (2 * border + 1)
    return padded.reshape(image.shape)


def autocorrelation(image: Tensor) -> Tensor:
    """Return the correlation [2H, 2W] of a picture [C, H, W] with itself, by shift; it is 1 at [H, W], shift 0.

    Structure coarser than a quarter of the picture is left out; all channels count together, and sums at each shift are
    divided by the overlap.
    """
    height, width = image.shape[-2:]
    size = (2 * height, 2 * width)
    detail = subtract_local_mean(image, min(height, width) // 4 | 1)
    power = torch.fft.rfft2(detail, s=size).abs().square().sum(0)
    ones = torch.fft.rfft2(torch.ones(height, width, dtype=image.dtype, device=image.device), s=size)
    overlap = torch.fft.irfft2(ones.abs().square(), s=size)
    correlation = torch.fft.irfft2(power, s=size) / overlap.clamp_min(height * width / 9)
    return torch.roll(correlation / correlation[0, 0].clamp_min(1e-12), (height, width), (0, 1))


def find_lattice(image: Tensor) -> Lattice:
    """Find the lattice of a picture [C, H, W], of at least 16 px a side."""
    image = image.double().cpu()
    correlation = autocorrelation(image)
    score, peaks = _choose_basis(_find_peaks(correlation, image.shape[-2:]), min(image.shape[-2:]))
    vectors, peak_correlations = torch.zeros(2, 2, dtype=image.dtype), torch.zeros(2, dtype=image.dtype)
    for i, (peak_correlation, y, x) in enumerate(peaks):
        vectors[i], peak_correlations[i] = _refine_vector(correlation, y, x), peak_correlation
    return Lattice(vectors, peak_correlations, score)


def _refine_vector(correlation: Tensor, y: int, x: int) -> Tensor:
    """Refine a lattice vector [2] to a part of a texel, by the peaks at its multiples up to 0.7 of the picture's side.

    Args:
        correlation: [2H, 2W], see :func:`autocorrelation`.
        y: the vector in whole texels.
        x: the vector in whole texels.
    """
    height, width = (side // 2 for side in correlation.shape)
    first = torch.tensor([y, x], dtype=correlation.dtype)
    vector, multiple = first, 1
    while all(
        abs(float(component)) * (multiple + 1) < 0.7 * side
        for component, side in zip(vector, (height, width), strict=True)
    ):
        multiple += 1
        row, column = (round(float(component)) for component in vector * multiple + torch.tensor([height, width]))
        window = correlation[
            row - MAX_PEAK_SHIFT_PX : row + MAX_PEAK_SHIFT_PX + 1,
            column - MAX_PEAK_SHIFT_PX : column + MAX_PEAK_SHIFT_PX + 1,
        ]
        if float(window.max()) < MIN_PEAK_CORRELATION:
            break
        down, across = divmod(int(window.argmax()), window.shape[1])
        row, column = row - MAX_PEAK_SHIFT_PX + down, column - MAX_PEAK_SHIFT_PX + across
        component = torch.stack(
            [
                _parabola_peak(correlation[row - 1 : row + 2, column]),
                _parabola_peak(correlation[row, column - 1 : column + 2]),
            ]
        )
        refined = (torch.tensor([row - height, column - width], dtype=vector.dtype) + component) / multiple
        if (
            float((refined - first).abs().max()) > MAX_PEAK_SHIFT_PX
        ):  # maxima on a slope are no peaks: they would lead to shift 0
            break
        vector = refined
    return vector


def _parabola_peak(values: Tensor) -> Tensor:
    """Return the place of the maximum of the parabola through three values, from the middle one, in [-0.5, 0.5]."""
    previous, middle, following = values
    top: Tensor = 0.5 * (previous - following) / (previous - 2 * middle + following).clamp_max(-1e-12)
    return top.clamp(-0.5, 0.5)


def _find_peaks(correlation: Tensor, size: torch.Size) -> list[tuple[float, int, int]]:
    """Return correlations and shifts (y, x) of the highest local maxima in one half of the plane, highest first."""
    height, width = size
    local_maximum = correlation[None, None]
    for window in ((9, 1), (1, 9)):
        local_maximum = max_pool2d(local_maximum, window, stride=1, padding=(window[0] // 2, window[1] // 2))
    peaks = []
    for row, column in ((correlation == local_maximum[0, 0]) & (correlation > MIN_PEAK_CORRELATION)).nonzero().tolist():
        y, x = row - height, column - width
        is_short = abs(y) <= LONGEST_VECTOR_SIDES * height and abs(x) <= LONGEST_VECTOR_SIDES * width
        if (y, x) > (0, 0) and is_short and math.hypot(y, x) >= SHORTEST_VECTOR_TEXELS:
            peaks.append((float(correlation[row, column]), y, x))
    return sorted(peaks, reverse=True)[:MAX_PEAKS]


def _choose_basis(peaks: list[tuple[float, int, int]], side: int) -> tuple[float, list[tuple[float, int, int]]]:
    """Choose the best basis: two strong, short, independent vectors, or one.

    Args:
        peaks: correlations and shifts (y, x).
        side: shorter side of the picture, px.

    Returns:
        Its score and its peaks.
    """
    best: tuple[float, list[tuple[float, int, int]]] = (-1.0, [])
    for i, (correlation, y, x) in enumerate(peaks):
        score_alone = correlation / 2 - VECTOR_LENGTH_COST * math.hypot(y, x) / side
        best = max(best, (score_alone, [peaks[i]]))
        for other in peaks[i + 1 :]:
            lengths = math.hypot(y, x), math.hypot(*other[1:])
            if abs(y * other[2] - x * other[1]) >= MIN_BASIS_SINE * math.prod(lengths):
                score = (correlation + other[0]) / 2 - VECTOR_LENGTH_COST * sum(lengths) / side
                best = max(best, (score, [peaks[i], other]))
    return best


def kept_order_share(exemplar: Lattice, picture: Tensor) -> float:
    """Return the share of an exemplar's order that a picture [C, H, W] of the same scale keeps.

    It is the picture's autocorrelation at the vectors of the exemplar's lattice, where peaks may have moved by
    MAX_PEAK_SHIFT_PX, over the exemplar's: 1 for as much order, 0 for none; NaN if the exemplar has none, or no vector
    fits into the picture, which may be of another size.
    """
    correlation, (height, width) = autocorrelation(picture.double().cpu()), picture.shape[-2:]
    shares = []
    for vector, exemplar_correlation in zip(exemplar.vectors, exemplar.correlations, strict=True):
        fits = all(
            abs(float(component)) + MAX_PEAK_SHIFT_PX + 1 < size
            for component, size in zip(vector, (height, width), strict=True)
        )
        if fits and float(exemplar_correlation) > 0:
            y, x = (round(float(component)) + size for component, size in zip(vector, (height, width), strict=True))
            window = correlation[
                y - MAX_PEAK_SHIFT_PX : y + MAX_PEAK_SHIFT_PX + 1, x - MAX_PEAK_SHIFT_PX : x + MAX_PEAK_SHIFT_PX + 1
            ]
            shares.append(max(0.0, float(window.max() / exemplar_correlation)))
    return sum(shares) / len(shares) if shares and exemplar.score > MIN_LATTICE_SCORE else math.nan
