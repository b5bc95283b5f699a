"""Whether rows break at the cuts between pieces of a tile, so that windows across cuts look like no place of the photo.

Rows of stitches that do not meet are as bright and as strong on both sides of a cut, so that neither colours across it
nor the lines and the order of the whole tile tell. Half a stitch beside half of another one, though, is seen nowhere in
the photo, where all stitches look alike. Materials without a lattice have no rows.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, max_pool2d, pad

from metapp.appearance.lattice import MIN_LATTICE_SCORE, find_lattice, subtract_local_mean
from metapp.networks.quilted import fetch_pieces, find_cuts

TEXEL_CELLS = 4  # side, in cells, of the texels that are compared, so that the noise of yarns and of px counts little
WINDOW_TEXELS = 8  # side of windows, even
STEP_CELLS = 8  # side of squares of cells: there is a window about each square that a cut crosses
NEAR_CELLS = 16  # distance along each axis of windows that count together, so that a break goes on along a cut
COARSEST_CELLS = 33  # side of the squares, odd, whose mean is left out, as it is the light of a photo
# Share of the difference of unrelated windows that is added to differences within the photo: where a photo repeats
# itself to the texel, changes that an eye does not see would count otherwise
FAINTEST_SHARE = 0.1
WINDOWS_AT_ONCE = 64  # windows that are searched at a time, which bounds the memory


def break_strength(relief: Tensor, places: Tensor) -> float:
    """Return how unlike its exemplar a tile of pieces is across the worst of its cuts: about 1 where rows go on.

    Each window across a cut differs by some square from the most similar window of the exemplar, and the window of the
    exemplar from which its middle comes by another from the most similar window elsewhere. The strength is the root of
    the first over the second, both summed along a part of a cut.

    Args:
        relief: slopes, or other channels that show rows, over the exemplar, [C, H, W].
        places: the place (y, x) in the exemplar of each cell of the tile, in its sides, [2, H, W].

    Returns:
        The strength; NaN for a tile without cuts, and for a relief that has no lattice or is smaller than two windows a
        side.
    """
    relief, places, cells = relief.float().cpu(), places.cpu(), (places.shape[1], places.shape[2])
    is_crossed = max_pool2d(find_cuts(places, cells).any(0)[None].float(), STEP_CELLS)[0] > 0
    is_large = min(cells) >= 2 * WINDOW_TEXELS * TEXEL_CELLS
    if not is_large or not is_crossed.any() or find_lattice(relief).score < MIN_LATTICE_SCORE:
        return math.nan
    detail = subtract_local_mean(relief, COARSEST_CELLS)
    exemplar, tile = (
        avg_pool2d(channels, TEXEL_CELLS) for channels in (detail, fetch_pieces(detail, places, cells, cells))
    )
    # the mean square of the difference of two unrelated windows
    unrelated = 2 * float(exemplar.square().sum(0).mean())
    centres = STEP_CELLS * is_crossed.nonzero() + STEP_CELLS // 2
    margin = WINDOW_TEXELS // 2
    wrapped = pad(tile[None], (margin, margin, margin, margin), mode="circular")[0]
    across = _least_differences(exemplar, _take_windows(wrapped, centres // TEXEL_CELLS), None)
    size = torch.tensor(exemplar.shape[1:])
    corners = (places[:, centres[:, 0], centres[:, 1]].T * size - margin).round().long()
    corners = corners.clamp_min(0).minimum(size - WINDOW_TEXELS)
    within = _least_differences(exemplar, _take_windows(exemplar, corners), corners)
    distances = (centres[:, None] - centres).abs()
    is_near = (torch.minimum(distances, torch.tensor(cells) - distances) <= NEAR_CELLS).all(-1).float()
    ratios = (is_near @ across) / (is_near @ (within + FAINTEST_SHARE * unrelated))
    return float(ratios.max().sqrt())


def _take_windows(channels: Tensor, corners: Tensor) -> Tensor:
    """Return the windows of channels [C, H, W] whose first texels are at corners (y, x), int [N, 2]: [N, C, w, w]."""
    along = torch.arange(WINDOW_TEXELS)
    y, x = (corners[:, axis, None] + along for axis in (0, 1))
    return channels[:, y[:, :, None], x[:, None]].movedim(0, 1)


def _least_differences(exemplar: Tensor, windows: Tensor, corners: Tensor | None) -> Tensor:
    """Return the mean squared difference of each window from the most similar one of an exemplar, [N].

    Args:
        exemplar: [C, H, W].
        windows: [N, C, w, w].
        corners: the window's own places (y, x) in the exemplar, near which no other is compared, [N, 2]; None for none.
    """
    height, width = (side - WINDOW_TEXELS + 1 for side in exemplar.shape[1:])
    size, spectrum = (exemplar.shape[1], exemplar.shape[2]), torch.fft.rfft2(exemplar)
    squares = WINDOW_TEXELS**2 * avg_pool2d(exemplar.square().sum(0)[None], WINDOW_TEXELS, 1)[0]
    y, x = torch.arange(height)[:, None], torch.arange(width)
    least = []
    for first in range(0, len(windows), WINDOWS_AT_ONCE):
        group = windows[first : first + WINDOWS_AT_ONCE]
        # products with all windows of the exemplar by Fourier transforms, whose time does not depend on their side
        products = torch.fft.irfft2((spectrum * torch.fft.rfft2(group, s=size).conj()).sum(1), s=size)
        differences = squares - 2 * products[:, :height, :width] + group.square().sum((1, 2, 3))[:, None, None]
        if corners is not None:
            own_y, own_x = corners[first : first + WINDOWS_AT_ONCE, :, None, None].unbind(1)
            is_own = ((y - own_y).abs() < WINDOW_TEXELS // 2) & ((x - own_x).abs() < WINDOW_TEXELS // 2)
            differences = differences.masked_fill(is_own, math.inf)
        least.append(differences.flatten(1).amin(1).clamp_min(0) / WINDOW_TEXELS**2)
    return torch.cat(least)
