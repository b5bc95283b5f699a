"""Photographs of a ball, and what each shows in every direction."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from data_tools.readers.image_files import Pixels
from data_tools.readers.photos import field_of_view, linear_light
from metapp.appearance.colour import linear_to_srgb
from metapp.extensions.capture.ball.circle import best_ball, resized
from metapp.extensions.capture.ball.view import Ball, Floats, Lens, sampled, seen_at

FOUND = 0.34  # least score of a ball
LARGEST_PX = 1024  # the ball's diameter, of what is kept of a photograph

_AROUND = 1.2  # of the radius, how much of the photograph is kept
_FORMATS, _WHOLE_PX = (4 / 3, 3 / 2, 16 / 9), 1000  # of photographs that were not cropped, and their longer side


class Shot(NamedTuple):
    """A photograph of a ball.

    Attributes:
        light: linear RGB [3, h, w] in [0, 1], of the part round the ball.
        ball: in that part.
        place: left and top of that part in the photograph, and how many of its px a side make one of these.
        turn: rotation vector, rad: from directions around the ball to those as its camera sees them.
    """

    light: NDArray[np.float32]
    ball: Ball
    place: tuple[int, int, int] = (0, 0, 1)
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def whole(self) -> Ball:
        """The ball in the whole photograph."""
        left, top, many = self.place
        return self.ball.scaled(many).shifted(-left, -top)

    def at(self, towards: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Linear RGB [3, ...] that it shows in directions [3, ...], and whether it shows these at all."""
        turned = np.einsum("ij,j...->i...", Rotation.from_rotvec(self.turn).as_matrix(), towards)
        place, speed = seen_at(turned, self.ball.angle)
        px = self.ball.to_px(place)
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


def searched(pixels: Pixels, lens: Lens | None) -> Ball | None:
    """The best ball in a photograph, however bad; None where there is no edge."""
    gray = gray_of(pixels)
    share = min(1.0, LARGEST_PX / max(gray.shape))
    ball = best_ball(resized(gray, share), lens and Lens(*(share * value for value in lens)))
    return ball and ball.scaled(1 / share)


def shot_of(pixels: Pixels, ball: Ball) -> Shot:
    """The part of a photograph round a ball, no finer than LARGEST_PX across it."""
    height, width = pixels.values.shape[:2]
    reach = _AROUND * ball.radius
    left, right = max(0, int(ball.x - reach)), min(width, int(ball.x + reach) + 1)
    top, bottom = max(0, int(ball.y - reach)), min(height, int(ball.y + reach) + 1)
    part = pixels._replace(values=pixels.values[top:bottom, left:right])
    light = linear_light(part, slice(None))[..., :3].transpose(2, 0, 1)
    ball = ball.shifted(left, top)
    many = max(1, int(2 * ball.radius // LARGEST_PX))
    if many > 1:
        rows, columns = (side // many * many for side in light.shape[1:])
        light = light[:, :rows, :columns].reshape(3, rows // many, many, columns // many, many).mean((2, 4))
        ball = ball.scaled(1 / many)
    return Shot(np.ascontiguousarray(light, dtype=np.float32), ball, (left, top, many))


def disc(size: int) -> Floats:
    """Places [2, size, size] of the pixels of a square picture that a ball fills."""
    along = (np.arange(size) + 0.5) * (2 / size) - 1
    return np.stack(np.meshgrid(along, -along))
