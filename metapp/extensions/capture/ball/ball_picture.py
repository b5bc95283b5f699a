"""Photographs of a ball: the camera's lens, the ball alone in linear light, and whether it is a mirror."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import torch
from scipy.ndimage import gaussian_filter, map_coordinates
from torch import Tensor

from data_tools.readers.colours import Floats
from data_tools.readers.environment_maps import SPHERE_PHOTO_PX
from data_tools.readers.image_files import Pixels
from data_tools.readers.square_photos import field_of_view_rad
from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.latlong import sphere_normals
from metapp.extensions.capture.ball.ball_geometry import (
    PARALLEL_LENS,
    Ball,
    PinholeLens,
    directions_to_disc,
    disc_places,
    disc_to_directions,
)

_FORMATS, _WHOLE_PX = (4 / 3, 3 / 2, 16 / 9), 1000  # of photographs that were not cropped, and their longer side
_FINEST = 8  # samples along a px
_MIRROR_PX = 128  # side of the picture by which a mirror is told
_LEAST_PX = 40  # radius of a ball of which it can be
_WITHIN = 0.92  # of the radius: the contour itself is sharp, whatever the ball
_WEIGHTS, _BIAS = (1.379, 2.596, 4.226), -7.225  # of `mirror_features`, by simulated balls under synthetic maps


def lens_of_photo(pixels: Pixels, fov_rad: float) -> PinholeLens:
    """The camera by its field of view along the shorter side, or 0: by EXIF, if the photograph is not cropped."""
    height, width = pixels.values.shape[:2]
    shape = max(height, width) / min(height, width)
    is_whole = max(height, width) >= _WHOLE_PX and any(abs(shape / known - 1) < 0.01 for known in _FORMATS)
    if not fov_rad and pixels.focal_mm and is_whole:
        fov_rad = field_of_view_rad(pixels.focal_mm, height, width)
    return (
        PinholeLens(min(height, width) / 2 / math.tan(fov_rad / 2), width / 2, height / 2) if fov_rad else PARALLEL_LENS
    )


def sample_pixels(planes: Floats, px: Floats) -> Floats:
    """Values [C, ...] of planes [C, H, W] at px [2, ...], interpolated; beyond the borders those at them."""
    return np.stack([map_coordinates(plane, px[::-1] - 0.5, order=1, mode="nearest") for plane in planes])


def block_means(planes: Floats, many: int) -> Floats:
    """Means over squares of many x many values of planes [C, H, W]."""
    count, height, width = planes.shape
    result: Floats = planes.reshape(count, height // many, many, width // many, many).mean((2, 4), dtype=np.float64)
    return result


def extract_ball(pixels: Pixels, ball: Ball, size: int, angle: float, high: float = 1.0) -> Floats:
    """A ball alone, which fills a square, as a camera at some distance sees it if it is a mirror.

    Args:
        pixels: the photograph.
        ball: in it.
        size: of the square, px.
        angle: half the angle that the ball fills for that camera, rad; `ball.angle`: as it is in the photograph.
        high: the value that larger ones become.

    Returns:
        [4, size, size]: linear RGB, and the share of each pixel that the photograph shows.
    """
    many = min(_FINEST, max(1, math.ceil(2 * ball.radius / size - 0.25)))  # alike for balls of nearly one size
    places = disc_places(size * many)
    place, speed = directions_to_disc(disc_to_directions(places, angle), ball.angle)
    px = ball.to_px(place)
    ends = np.array(pixels.values.shape[1::-1])
    there = (np.hypot(*places) < 1) & (speed > 0) & (px > 0).all(0) & (px < ends[:, None, None]).all(0)
    left, top = low = np.clip(px.min((1, 2)).astype(int) - 1, 0, ends - 2)
    right, bottom = np.maximum(px.max((1, 2)).astype(int), low) + 2
    part = pixels._replace(values=pixels.values[top:bottom, left:right]).linear(high=high)[..., :3]
    light = sample_pixels(part.transpose(2, 0, 1), px - low[:, None, None])
    return block_means(np.concatenate([light, there[None]]), many)


def extract_ball_photo(pixels: Pixels, ball: Ball, angle: float) -> Tensor:
    """A ball alone as fits see it, display values uint8 [1, 3, SIZE, SIZE], black outside; angle as of `extract_ball`."""
    light = torch.from_numpy(extract_ball(pixels, ball, SPHERE_PHOTO_PX, angle)[:3])
    return (linear_to_srgb(light) * sphere_normals(SPHERE_PHOTO_PX)[1] * 255).round().to(torch.uint8)[None]


def check_finite_pixels(pixels: Pixels, name: Path | str) -> None:
    """Refuse values that are NaN or infinite; `name` begins the error."""
    if pixels.values.dtype.kind == "f" and (count := np.count_nonzero(~np.isfinite(pixels.values[..., :3]))):
        raise ValueError(f"{name}: {count:,} values are NaN or infinite, expected finite ones; export it again.")


def is_mirror_ball(pixels: Pixels, ball: Ball) -> bool:
    """True if a ball is surely a mirror; False if it cannot be told.

    A mirror shows edges as sharp as the photograph, all over, and things that are dark; a ball with a body of its own
    or a rough one shows neither. A logistic regression on three numbers says which.
    """
    if ball.radius < _LEAST_PX:
        return False
    return float(np.dot(_WEIGHTS, mirror_features(extract_ball(pixels, ball, _MIRROR_PX, ball.angle)[:3]))) + _BIAS > 0


def mirror_features(light: Floats) -> Floats:
    """Three numbers about a ball, linear RGB [3, S, S]; each grows with how much of a mirror it is.

    The logarithms of: how much of it has steep gradients; how much steeper these are when less smoothed; how dark it
    gets beside the radiosity of a diffuse ball of the same mean.
    """
    size = light.shape[1]
    inside = np.hypot(*disc_places(size)) < _WITHIN
    linear = light.mean(0)
    display = linear_to_srgb(torch.from_numpy(linear.clip(0, 1))).numpy()
    fine, coarse = (np.hypot(*np.gradient(gaussian_filter(display, sigma)))[inside] for sigma in (1.0, 3.0))
    low, high = np.quantile(display[inside], (0.02, 0.98))
    steep = (fine > 0.06 * (high - low + 0.02)).mean()
    ratio = (fine**2).mean() / max((coarse**2).mean(), 1e-9)
    weight = gaussian_filter(inside * 1.0, size / 6)
    around = gaussian_filter(linear * inside, size / 6) / np.maximum(weight, 1e-3)
    dark = np.quantile((gaussian_filter(linear, 1.0) / np.maximum(around, 1e-4))[inside], 0.05)
    return np.array([math.log(steep + 0.003), math.log(ratio + 1e-3), -math.log(dark + 0.02)])
