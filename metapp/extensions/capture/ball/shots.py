"""Photographs of a ball: what each shows in every direction."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_tools.readers.image_files import Pixels
from data_tools.readers.photos import field_of_view, linear_light
from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.latlong import sphere_normals
from metapp.extensions.capture.ball.view import Ball, Floats, Lens, mirrored, sampled, seen_at

SIZE = 64  # px of the photograph of the ball alone, which fits see

_LARGEST_PX = 1024  # the ball's diameter, of what is kept of a photograph
_AROUND = 1.2  # of the radius, how much of the photograph is kept
_FORMATS, _WHOLE_PX = (4 / 3, 3 / 2, 16 / 9), 1000  # of photographs that were not cropped, and their longer side


class Shot(NamedTuple):
    """A photograph of a ball.

    Attributes:
        ball: in the photograph.
        light: linear RGB [3, h, w] in [0, 1], of the part round the ball.
        left, top: of that part in the photograph, px.
        many: how many px of the photograph a side make one of that part.
    """

    ball: Ball
    light: NDArray[np.float32]
    left: int = 0
    top: int = 0
    many: int = 1

    def at(self, towards: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Linear RGB [3, ...] that it shows in directions [3, ...], and whether it shows these at all."""
        place, speed = seen_at(towards, self.ball.angle)
        x, y = self.ball.to_px(place)
        px = np.stack([x - self.left, y - self.top]) / self.many
        height, width = self.light.shape[1:]
        inside = (speed > 0) & (px > 0).all(0) & (px[0] < width) & (px[1] < height)
        return sampled(self.light, px), inside


def lens_of(pixels: Pixels, fov_rad: float) -> Lens | None:
    """The camera by its field of view along the shorter side, or 0: by EXIF, if the photograph is not cropped."""
    height, width = pixels.values.shape[:2]
    shape = max(height, width) / min(height, width)
    is_whole = max(height, width) >= _WHOLE_PX and any(abs(shape / known - 1) < 0.01 for known in _FORMATS)
    if not fov_rad and pixels.focal_mm and is_whole:
        fov_rad = field_of_view(pixels.focal_mm, height, width)
    return Lens(min(height, width) / 2 / math.tan(fov_rad / 2), width / 2, height / 2) if fov_rad else None


def gray_of(pixels: Pixels) -> Floats:
    """Display values [H, W] in [0, 1], the mean of red, green and blue."""
    values = pixels.values[..., :3]
    if values.dtype.kind == "u":
        result: Floats = values.mean(-1) / float(np.iinfo(values.dtype).max)
        return result
    linear = torch.from_numpy(linear_light(pixels, slice(None))[..., :3])
    display: Floats = linear_to_srgb(linear).numpy().mean(-1).astype(np.float64)
    return display


def shot_of(pixels: Pixels, ball: Ball) -> Shot:
    """The part of a photograph round a ball, no finer than _LARGEST_PX across it."""
    height, width = pixels.values.shape[:2]
    reach = _AROUND * ball.radius
    left, right = max(0, int(ball.x - reach)), min(width, int(ball.x + reach) + 1)
    top, bottom = max(0, int(ball.y - reach)), min(height, int(ball.y + reach) + 1)
    part = pixels._replace(values=pixels.values[top:bottom, left:right])
    light = linear_light(part, slice(None))[..., :3].transpose(2, 0, 1)
    many = max(1, int(2 * ball.radius // _LARGEST_PX))
    rows, columns = (side // many * many for side in light.shape[1:])
    light = light[:, :rows, :columns].reshape(3, rows // many, many, columns // many, many).mean((2, 4))
    return Shot(ball, np.ascontiguousarray(light, dtype=np.float32), left, top, many)


def disc(size: int) -> Floats:
    """Places [2, size, size] of the pixels of a square picture that a ball fills."""
    along = (np.arange(size) + 0.5) * (2 / size) - 1
    return np.stack(np.meshgrid(along, -along))


def light_of(shot: Shot, size: int, angle: float) -> Floats:
    """A ball alone, linear RGB [3, size, size].

    Args:
        shot: the photograph.
        size: px.
        angle: of the ball for the camera that sees it so, as of `mirrored`: the photograph's own, or another one where
            the ball is a mirror.
    """
    many = max(1, math.ceil(2 * shot.ball.radius / size))
    light, _ = shot.at(mirrored(disc(size * many), angle))
    result: Floats = light.reshape(3, size, many, size, many).mean((2, 4))
    return result


def photo_of(shot: Shot, angle: float) -> Tensor:
    """A ball alone, display values uint8 [3, SIZE, SIZE], black outside; angle as of `light_of`."""
    mean = torch.from_numpy(light_of(shot, SIZE, angle))
    return (linear_to_srgb(mean) * sphere_normals(SIZE)[1] * 255).round().to(torch.uint8)
