"""Pictures of pieces of a photograph, and the network that corrects how these pieces fit together.

A quilt is kept as the place in the photograph of each of its cells, so that it can be fetched at the photograph's own
resolution. What the network adds is smooth, and enlarged with it.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, conv2d, grid_sample, interpolate, leaky_relu, pad

from metapp.learning.random_tensors import draw_normal
from metapp.learning.task import Params

CORRECTION_GAIN = 0.1  # a parameter of 1 changes a display value by so much, or a contrast by twice this share
ENCODER_UNITS, ENCODER_LAYERS = 32, 4
ENCODER_LEAKY_SLOPE = 0.2  # slope below 0 of the leaky ReLUs of the encoder
ENCODER_INPUTS = 18  # channels: means and deviations of cells, of the whole quilt, and how far the exemplar's are away
DIFFERENCE_GAIN = 10.0  # factor of the differences between exemplar and quilt, which are small
QUILT_CONTRAST = 1.5  # root mean square of quilts as generators read them, about a mean of 0
MIN_QUILT_RMS = (
    0.02  # root mean square, about the mean, of display values, up to which a quilt's contrast is not raised
)
DEVIATION_WEIGHT = 0.1  # weight in a loss of the difference of pictures from their quilts
MIN_QUILT_VARIANCE = 1e-3  # of display values, added to a quilt's variance, so that flat ones count for less
SHORTEST_REPETITION_CELLS = 4  # shift from which on a place that comes back counts as repeated
MAX_COUNTED_COPIES = 16  # copies of a place that are told apart; more hardly occur
SEAM_SIDES_CELLS = (2, 4, 8)  # sides of the squares on both sides of a cut whose colours are compared
FAINTEST_CHANGE = 1 / 255  # change of a display value that counts as none
STRIP_ROWS = 512  # rows of a picture that are fetched at a time


class LightGrid(NamedTuple):
    """A network whose parameters `z` [T, 2, rows, columns] change the contrast and the brightness of a quilt by place.

    Values between the centres of cells are interpolated, and continue at opposite edges, so that pictures tile. All
    channels are changed alike: changes of colour lower errors of features, too, but are seen as coloured clouds.

    Attributes:
        rows, columns: the size of the grid, in cells.
        noise: the number of channels of the noise, whose first two numbers say by how much a picture is moved.
    """

    rows: int = 32
    columns: int = 32
    noise: int = 2

    @property
    def periodic(self) -> bool:
        """True: the grid continues at the opposite edge."""
        return True

    def init(self, rng: Generator, count: int) -> Params:
        """Return parameters of `count` networks that change nothing; none of them is random."""
        return {"z": torch.zeros(count, 2, self.rows, self.columns, device=rng.device)}

    def __call__(self, theta: Params, quilts: Tensor) -> Tensor:
        """Change the light of quilts as the parameters say.

        Args:
            theta: the parameters of T networks.
            quilts: a quilt for each network, display values [T, 3, H, W].

        Returns:
            Display values [T, 3, H, W] in [0, 1].
        """
        change = CORRECTION_GAIN * enlarge_grid(theta["z"], quilts.shape[-2:])
        mean = quilts.mean((-1, -2), keepdim=True)
        return ((quilts - mean) * torch.exp(2 * change[:, :1]) + mean + change[:, 1:]).clamp(0, 1)

    def init_encoder(self, rng: Generator) -> Params:
        """Draw an encoder that predicts the parameters of a quilt; it begins by predicting no change."""
        encoder = {}
        for layer in range(ENCODER_LAYERS):
            inputs = ENCODER_UNITS if layer else ENCODER_INPUTS
            outputs = ENCODER_UNITS if layer < ENCODER_LAYERS - 1 else 2
            weights = draw_normal(rng, outputs, inputs, 3, 3) * math.sqrt(2 / (9 * inputs))
            encoder[f"conv{layer}.kernel"] = weights if layer < ENCODER_LAYERS - 1 else 0 * weights
            encoder[f"conv{layer}.shift"] = torch.zeros(outputs, device=rng.device)
        return encoder

    def encode(self, encoder: Params, quilts: Tensor, exemplar_moments: Tensor) -> Params:
        """Predict the parameters of quilts.

        The encoder reads the mean and the standard deviation of each cell and of the whole quilt, and the differences
        of the exemplar's from the latter.

        Args:
            encoder: the parameters that :meth:`init_encoder` draws, maybe trained.
            quilts: display values [T, 3, H, W]; sides are multiples of the grid's.
            exemplar_moments: the channels' means and standard deviations of each exemplar, [T, 6].
        """
        cell = quilts.shape[-2] // self.rows, quilts.shape[-1] // self.columns
        means = avg_pool2d(quilts, cell)
        deviations = (avg_pool2d(quilts.square(), cell) - means.square()).clamp_min(1e-6).sqrt()
        quilt_moments = colour_moments(quilts)
        difference = DIFFERENCE_GAIN * (exemplar_moments - quilt_moments)
        whole = torch.cat([quilt_moments, difference], 1)[..., None, None].expand(-1, -1, *means.shape[-2:])
        x = torch.cat([means - whole[:, :3], deviations - whole[:, 3:6], whole], 1)
        for layer in range(ENCODER_LAYERS):
            x = pad(x, (1, 1, 1, 1), mode="circular")
            x = conv2d(x, encoder[f"conv{layer}.kernel"], encoder[f"conv{layer}.shift"])
            x = leaky_relu(x, ENCODER_LEAKY_SLOPE) if layer < ENCODER_LAYERS - 1 else x
        return {"z": x}


def colour_moments(pictures: Tensor) -> Tensor:
    """Return the channels' means, then their standard deviations, of pictures [B, 3, H, W]: [B, 6]."""
    return torch.cat([pictures.mean((-1, -2)), pictures.std((-1, -2))], 1)


def enlarge_grid(values: Tensor, size: tuple[int, int] | torch.Size) -> Tensor:
    """Enlarge values [T, C, r, c] at the centres of cells to [T, C, *size], periodically and smoothly (bicubic)."""
    margin = 3  # cells that are repeated at each edge; interpolation reads two of them
    rows, columns = values.shape[-2:]
    padded = pad(values, (margin, margin, margin, margin), mode="circular")
    y, x = (
        2
        * (margin + (torch.arange(length, dtype=values.dtype, device=values.device) + 0.5) * cells / length)
        / (cells + 2 * margin)
        - 1
        for length, cells in zip(size, (rows, columns), strict=True)
    )
    grid = torch.stack(torch.broadcast_tensors(x[None], y[:, None]), -1).expand(len(values), -1, -1, -1)
    return grid_sample(padded, grid, mode="bicubic", align_corners=False)


def move_periodically(pictures: Tensor, shares: Tensor) -> Tensor:
    """Move pictures that tile, and return several moved ones of each; nothing waits for the device.

    Args:
        pictures: [T, C, H, W].
        shares: how far down and right each of B pictures is moved, in sides, [T, B, 2].

    Returns:
        [T, B, C, H, W].

    >>> picture = torch.arange(6.0).reshape(1, 1, 2, 3)
    >>> bool((move_periodically(picture, torch.tensor([[[0.5, 0.4]]]))[0, 0] == picture[0].roll((1, 1), (1, 2))).all())
    True
    """
    count, (height, width) = shares.shape[1], pictures.shape[-2:]
    moved = pictures[:, None].expand(-1, count, -1, -1, -1)
    for axis, side in ((3, height), (4, width)):
        shift = (shares[..., axis - 3] * side).long()[..., None]
        source = (torch.arange(side, device=pictures.device) - shift) % side
        shape = [len(pictures), count, 1, 1, 1]
        shape[axis] = side
        moved = moved.gather(axis, source.reshape(shape).expand_as(moved))
    return moved


def normalise_quilts(quilts: Tensor) -> Tensor:
    """Return quilts [T, B, 3, H, W] with mean 0 and equal contrast, as generators read them."""
    centred = quilts - quilts.mean((-1, -2), keepdim=True)
    root_mean_square = centred.square().mean((-1, -2, -3), keepdim=True).sqrt()
    return QUILT_CONTRAST * centred / root_mean_square.clamp_min(MIN_QUILT_RMS)


def quilt_deviation(pictures: Tensor, quilts: Tensor) -> Tensor:
    """Return the part of a loss, [T], that keeps pictures near their quilts.

    It is DEVIATION_WEIGHT times the squared difference of pictures and quilts over the quilts' variance.

    Args:
        pictures: display values without shading, [T, B, 3, H, W].
        quilts: the quilt of each picture, moved like it, [T, B, 3, H, W].
    """
    variance = quilts.var((-1, -2)).mean(-1) + MIN_QUILT_VARIANCE
    return ((pictures - quilts).square().mean((-1, -2, -3)) * (DEVIATION_WEIGHT / variance)).mean(1)


def fetch_pieces(photo: Tensor, places: Tensor, size: tuple[int, int], cells: tuple[int, int]) -> Tensor:
    """Fetch a quilt of a photograph at any resolution.

    The four cells around a pixel each say where the photograph has it, and are weighed bilinearly: inside of a piece
    they agree, so that it is a copy; across a cut one piece fades into the next over the width of a cell.

    Args:
        photo: the photograph, [3, S, S'].
        places: the place (y, x) in the photograph of the centre of each cell, in its sides, [2, rows, columns]; cells
            continue at opposite edges.
        size: the height and width of the quilt in px.
        cells: the rows and columns of cells that have the size of the whole photograph.

    Returns:
        The quilt, [3, *size].

    >>> photo = torch.rand(3, 8, 8)
    >>> own = torch.stack(torch.meshgrid(*2 * [(torch.arange(4) + 0.5) / 4], indexing="ij"))
    >>> torch.allclose(fetch_pieces(photo, own, (8, 8), (4, 4))[:, 1:7, 1:7], photo[:, 1:7, 1:7], atol=1e-5)
    True
    """
    rows, columns = places.shape[1:]
    y, x = (
        (torch.arange(length) + 0.5) * count / length - 0.5 for length, count in zip(size, (rows, columns), strict=True)
    )
    strips = []
    for y_strip in y.split(STRIP_ROWS):
        total = photo.new_zeros(len(photo), len(y_strip), len(x))
        for down in (0, 1):
            for right in (0, 1):
                row, column = y_strip.floor().long() + down, x.floor().long() + right
                weight = (1 - (y_strip - row).abs())[:, None] * (1 - (x - column).abs())
                near = places[:, row % rows][:, :, column % columns]
                place_y = near[0] + ((y_strip - row) / cells[0])[:, None]
                place_x = near[1] + (x - column) / cells[1]
                grid = 2 * torch.stack([place_x, place_y], -1) - 1
                piece = grid_sample(
                    photo[None], grid[None].to(photo), mode="bicubic", padding_mode="border", align_corners=False
                )
                total += weight.to(photo) * piece[0]
        strips.append(total)
    return torch.cat(strips, 1)


def find_cuts(places: Tensor, cells: tuple[int, int]) -> Tensor:
    """Return where the next cell down, and the next cell right, comes from another piece, bool [2, rows, columns].

    Args:
        places: the place (y, x) in the photograph of each cell, in its sides, [2, rows, columns]; cells continue at
            opposite edges.
        cells: the rows and columns of cells that have the size of the whole photograph.
    """
    cuts = []
    for axis, count in enumerate(cells):
        step = places.new_zeros(2, 1, 1)
        step[axis] = 1 / count
        deviation = (places.roll(-1, axis + 1) - places - step) * count
        cuts.append(deviation.abs().amax(0) >= 0.5)
    return torch.stack(cuts)


def copied_share(places: Tensor, cells: tuple[int, int]) -> float:
    """Return the share of a quilt that is a plain copy: where a cell and its neighbours come from one piece.

    See :func:`find_cuts` for the arguments.
    """
    down, right = find_cuts(places, cells)
    is_copy = ~(down | down.roll(1, 0) | right | right.roll(1, 1))
    return float(is_copy.float().mean())


def repeated_share(places: Tensor, cells: tuple[int, int]) -> float:
    """Return the largest share of a quilt that comes back at one shift: how large the largest repetition is.

    At each shift of at least SHORTEST_REPETITION_CELLS the cells are counted whose place in the photograph stands also
    at the shifted cell. An eye finds a piece that comes back as a whole; small parts of many pieces, which together may
    be as large, it does not find. Shifts that differ by a cell count as one, as pieces may be stretched.

    See :func:`find_cuts` for the arguments.
    """
    rows, columns = places.shape[1:]
    y, x = ((place * count).long().clamp(0, count - 1) for place, count in zip(places, cells, strict=True))
    numbers, order = (y * cells[1] + x).flatten().sort(stable=True)
    shift_counts = torch.zeros(rows * columns)
    for distance in range(1, MAX_COUNTED_COPIES):
        is_same = numbers[distance:] == numbers[:-distance]
        first, second = order[:-distance][is_same], order[distance:][is_same]
        for start, end in ((first, second), (second, first)):
            down, right = (end // columns - start // columns) % rows, (end - start) % columns
            shift_counts += torch.bincount(down * columns + right, minlength=rows * columns)
    near = torch.arange(1 - SHORTEST_REPETITION_CELLS, SHORTEST_REPETITION_CELLS)
    counts = shift_counts.unflatten(0, (rows, columns))
    counts[near[:, None] % rows, near % columns] = 0
    sums = 9 * avg_pool2d(pad(counts[None, None], (1, 1, 1, 1), mode="circular"), 3, 1)
    return float(sums.max()) / (rows * columns)


def seam_strength(exemplar: Tensor, quilt: Tensor, places: Tensor, cells: tuple[int, int]) -> float:
    """Return how much stronger a quilt changes across its cuts than the exemplar does at the places on both sides.

    Colours are means of squares on both sides of a cut, of each side in SEAM_SIDES_CELLS; the strength is the root mean
    square of their difference over the exemplar's, for the side where that is largest. At the photograph's edges, where
    a place has no such difference, it is the mean over the exemplar. The strength is about 1 where cuts are not
    seen, also along joints, which are edges in the exemplar, too. Finer changes are not counted, as pieces fade into
    each other over the width of a cell.

    Args:
        exemplar: the evenly lit exemplar, [3, H, W].
        quilt: the quilt of it, [3, h, w], which tiles.
        places: the place (y, x) in the photograph of each cell, in its sides, [2, rows, columns].
        cells: the rows and columns of cells that have the size of the whole photograph.
    """
    exemplar, quilt = (
        interpolate(picture[None], size=size, mode="area")[0]
        for picture, size in ((exemplar, cells), (quilt, places.shape[1:]))
    )
    cuts, scale = find_cuts(places, cells), places.new_tensor(cells)[:, None, None]
    index = (places * scale).long().clamp_min(0).minimum(scale.long() - 1)
    strengths = []
    for side in SEAM_SIDES_CELLS:
        across_cuts, natural = torch.zeros(()), torch.zeros(())
        for axis, is_cut in enumerate(cuts):
            changes = _omit_border(_squared_changes(exemplar, axis, side), axis, side)
            next_index = index.roll(-1, axis + 1)
            next_index[axis] = (next_index[axis] - 1).clamp_min(0)
            own_changes = torch.stack([changes[tuple(index)], changes[tuple(next_index)]]).nanmean(0)
            own_changes = own_changes.where(own_changes.isfinite(), changes.nanmean())  # at the photograph's edges
            across_cuts += _squared_changes(quilt, axis, side)[is_cut].sum()
            natural += (own_changes[is_cut] + FAINTEST_CHANGE**2).sum()
        strengths.append(float((across_cuts / natural).sqrt()) if bool(cuts.any()) else 1.0)
    return max(strengths)


def _squared_changes(picture: Tensor, axis: int, side: int) -> Tensor:
    """Return the squared change of colour [H, W] from each px of a picture [3, H, W] to the next along an axis.

    It is the difference of the means of two squares of `side` px, of which the first ends at the px. The picture
    continues at opposite edges.
    """
    turned = picture.movedim(axis + 1, -1)[None]
    length, centre = turned.shape[-1], side // 2
    padded = pad(turned, (side - 1, side, centre, side - 1 - centre), mode="circular")
    means = avg_pool2d(avg_pool2d(padded, (side, 1), 1), (1, side), 1)[0]
    changes = (means[..., side:] - means[..., :length]).square().sum(0)
    return changes if axis == 1 else changes.T


def _omit_border(changes: Tensor, axis: int, side: int) -> Tensor:
    """Return changes [H, W] of :func:`_squared_changes` with NaN where squares reach past the picture's edges."""
    height, width = changes.shape
    before, after = [side // 2] * 2, [side - 1 - side // 2] * 2
    before[axis], after[axis] = side - 1, side
    inside = slice(before[0], height - after[0]), slice(before[1], width - after[1])
    known = torch.full_like(changes, math.nan)
    known[inside] = changes[inside]
    return known


def subtract_trend(photo: Tensor, exemplar: Tensor, even_exemplar: Tensor) -> Tensor:
    """Subtract from a photograph [3, S, S'] the slow change that a smaller copy of it, `exemplar`, has lost."""
    trend = interpolate((exemplar - even_exemplar)[None], size=photo.shape[-2:], mode="bilinear", align_corners=False)
    return (photo - trend[0]).clamp(0, 1)
