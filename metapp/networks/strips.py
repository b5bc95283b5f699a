"""Networks on pictures too large for the memory that they take: some rows at a time, no gradient."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch
from torch import Tensor
from torch.nn.functional import conv2d, instance_norm, interpolate, leaky_relu, pad

from metapp.learning.task import Params
from metapp.networks.layers import SLOPE, LocalField, style_of

ROWS = 256  # of a `Pyramid` at a time; even
TEXELS = 2**17  # of what each texel has for itself: 16 MB of 32 channels, which the next rows get again, still mapped

Rows = Callable[[int, int], Tensor]
"""(first, end) -> those rows of maps [B, C, end - first, W] that tile, so that row -1 is the last one."""


def rows_of(x: Tensor) -> Rows:
    """The rows of maps [B, C, H, W]."""
    return lambda first, end: x[..., torch.arange(first, end, device=x.device) % x.shape[-2], :]


def enlarged_rows(x: Tensor) -> Rows:
    """The rows of maps [B, C, H, W] twice as high and wide, as `tiling.enlarged`; from an odd one to an odd end."""

    def read(first: int, end: int) -> Tensor:
        coarse = rows_of(x)((first - 1) // 2, end // 2 + 1)
        return interpolate(pad(coarse, (1, 1, 0, 0), mode="circular"), scale_factor=2, mode="bilinear")[..., 1:-1, 2:-2]

    return read


def styled_by_rows(theta: Params, name: str, read: Rows, height: int) -> Tensor:
    """`layers.styled` of maps that are `height` high: the same, without a copy of what it reads."""
    kernel, made = theta[f"{name}.kernel"], None
    for top in range(0, height, ROWS):
        end = min(top + ROWS, height)
        strip = pad(read(top - 1, end + 1), (1, 1, 0, 0), mode="circular")
        part = conv2d(strip, kernel.flatten(0, 1), groups=kernel.shape[0])
        made = part.new_empty(*part.shape[:2], height, part.shape[3]) if made is None else made
        made[..., top:end, :] = part
    assert made is not None
    for channel, gain, shift in zip(made.split(1, 1), *style_of(theta, name), strict=True):
        channel.copy_(leaky_relu(instance_norm(channel) * gain + shift, SLOPE))
    return made


def strips_of(height: int, width: int) -> Iterator[tuple[int, int]]:
    """(first, end) of rows that are TEXELS together or fewer, from the top."""
    rows = max(1, TEXELS // width)
    return ((top, min(top + rows, height)) for top in range(0, height, rows))


def field_by_rows(field: LocalField, theta: Params, places: Tensor) -> Iterator[Tensor]:
    """The rows of what a field makes of places [T, inputs, height, width], [T, outputs, h, width] at a time."""
    for first, end in strips_of(field.height, field.width):
        yield field.decoded(theta, field.code_at(theta, first, end), places[..., first:end, :])
