"""Pictures of pieces of a photograph, and the network that corrects how these pieces fit together.

A quilt is kept as the place in the photograph of each of its cells, so that it can be fetched at the photograph's own
resolution. What the network adds is smooth, and enlarged with it. Nothing here knows features or losses.
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
ENCODER_INPUTS = 18  # channels: means and deviations of cells, of the whole quilt, and how far the exemplar's are away
DIFFERENCE_GAIN = 10.0  # factor of the differences between exemplar and quilt, which are small
QUILT_CONTRAST = 1.5  # root mean square of quilts as generators read them, about a mean of 0
MIN_QUILT_RMS = (
    0.02  # root mean square, about the mean, of display values, up to which a quilt's contrast is not raised
)
DEVIATION_WEIGHT = 0.1  # weight in a loss of the difference of pictures from their quilts
MIN_QUILT_VARIANCE = 1e-3  # of display values, added to a quilt's variance, so that flat ones count for less
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
    def side_step(self) -> int:
        """1: sides of pictures may have any number of px."""
        return 1

    @property
    def reads_quilt(self) -> bool:
        """True: what it changes is a quilt."""
        return True

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
            x = leaky_relu(x, 0.2) if layer < ENCODER_LAYERS - 1 else x
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


def copied_share(places: Tensor, cells: tuple[int, int]) -> float:
    """Return the share of a quilt that is a plain copy: where a cell and its neighbours come from one piece.

    Args:
        places: the place (y, x) in the photograph of each cell, in its sides, [2, rows, columns].
        cells: the rows and columns of cells that have the size of the whole photograph.
    """
    is_copy = torch.ones(places.shape[1:], dtype=torch.bool)
    for axis, count in ((1, cells[0]), (2, cells[1])):
        step = places.new_zeros(2, 1, 1)
        step[axis - 1] = 1 / count
        deviation = (places.roll(-1, axis) - places - step) * count
        agrees = deviation.abs().amax(0) < 0.5
        is_copy &= agrees & agrees.roll(1, axis - 1)
    return float(is_copy.float().mean())


def subtract_trend(photo: Tensor, exemplar: Tensor, even_exemplar: Tensor) -> Tensor:
    """Subtract from a photograph [3, S, S'] the slow change that a smaller copy of it, `exemplar`, has lost."""
    trend = interpolate((exemplar - even_exemplar)[None], size=photo.shape[-2:], mode="bilinear", align_corners=False)
    return (photo - trend[0]).clamp(0, 1)
