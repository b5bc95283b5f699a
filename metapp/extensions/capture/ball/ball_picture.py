"""Photographs of a ball: the camera's lens, the ball alone in linear light, and whether it is a mirror.

Nothing here finds a ball; that is what `circle` does.
"""

from __future__ import annotations

import math
import warnings
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

# Aspect ratios of photographs that were not cropped, and their longer side in px, at least.
_UNCROPPED_ASPECTS, _MIN_UNCROPPED_PX = (4 / 3, 3 / 2, 16 / 9), 1000
_MAX_SAMPLES_PER_PX = 8  # samples along the side of a px
_MIRROR_PICTURE_PX = 128  # side of the picture by which a mirror is recognised
_MIN_MIRROR_RADIUS_PX = 40  # a smaller ball is not recognised as a mirror
_JUDGED_RADIUS_SHARE = 0.92  # of the radius: farther out lies the contour, which is sharp on any ball
# of a logistic regression on `mirror_features`, fitted to simulated balls under synthetic maps
_MIRROR_WEIGHTS, _MIRROR_BIAS = (1.379, 2.596, 4.226), -7.225


def lens_of_photo(pixels: Pixels, fov_rad: float, name: Path | str = "photo") -> PinholeLens:
    """Return the lens of a photograph's camera.

    A warning is given where the photograph has the shape of an uncropped one, but EXIF states another size.

    Args:
        pixels: the photograph.
        fov_rad: the field of view along the shorter side, in rad; 0 if it is not known: then EXIF gives it, if the
            photograph is not cropped, and otherwise the camera is taken to be far away.
        name: the name of the photograph in the warning.
    """
    height, width = pixels.values.shape[:2]
    aspect = max(height, width) / min(height, width)
    is_whole = max(height, width) >= _MIN_UNCROPPED_PX and any(
        abs(aspect / uncropped_aspect - 1) < 0.01 for uncropped_aspect in _UNCROPPED_ASPECTS
    )
    exif_lens = pixels.picture_lens()
    if not fov_rad and exif_lens.note and is_whole:
        taken = "" if exif_lens.focal_mm and not exif_lens.is_part else ", the camera is taken to be far away"
        warnings.warn(f"{name}: {exif_lens.note}{taken}; --fov sets the field of view.", stacklevel=2)
    if not fov_rad and exif_lens.focal_mm and is_whole and not exif_lens.is_part:
        fov_rad = field_of_view_rad(exif_lens.focal_mm, height, width)
    return (
        PinholeLens(min(height, width) / 2 / math.tan(fov_rad / 2), width / 2, height / 2) if fov_rad else PARALLEL_LENS
    )


def sample_pixels(planes: Floats, px: Floats) -> Floats:
    """Return values [C, ...] of planes [C, H, W] at px [2, ...], interpolated; the borders continue outwards."""
    return np.stack([map_coordinates(plane, px[::-1] - 0.5, order=1, mode="nearest") for plane in planes])


def block_means(planes: Floats, side: int) -> Floats:
    """Return the means of planes [C, H, W] over squares of `side` x `side` values."""
    channels, height, width = planes.shape
    means: Floats = planes.reshape(channels, height // side, side, width // side, side).mean((2, 4), dtype=np.float64)
    return means


def extract_ball(pixels: Pixels, ball: Ball, size: int, angle: float, high: float = 1.0) -> Floats:
    """Return a ball alone, filling a square, as a camera at some distance would see it if it is a mirror.

    Args:
        pixels: the photograph.
        ball: the ball in the photograph.
        size: the side of the square, in px.
        angle: half the angle that the ball fills for that camera, in rad; `ball.half_angle_rad` keeps the view of the
            photograph.
        high: the value that larger values are clipped to.

    Returns:
        [4, size, size]: linear RGB, and the share of each pixel that the photograph shows.
    """
    oversampling = min(
        _MAX_SAMPLES_PER_PX, max(1, math.ceil(2 * ball.radius / size - 0.25))
    )  # one value for balls of nearly one size
    places = disc_places(size * oversampling)
    photo_places, speed = directions_to_disc(disc_to_directions(places, angle), ball.half_angle_rad)
    px = ball.to_px(photo_places)
    photo_size = np.array(pixels.values.shape[1::-1])
    is_shown = (np.hypot(*places) < 1) & (speed > 0) & (px > 0).all(0) & (px < photo_size[:, None, None]).all(0)
    left, top = corner = np.clip(px.min((1, 2)).astype(int) - 1, 0, photo_size - 2)
    right, bottom = np.maximum(px.max((1, 2)).astype(int), corner) + 2
    cutout = pixels._replace(values=pixels.values[top:bottom, left:right]).linear(high=high)[..., :3]
    light = sample_pixels(cutout.transpose(2, 0, 1), px - corner[:, None, None])
    return block_means(np.concatenate([light, is_shown[None]]), oversampling)


def extract_ball_photo(pixels: Pixels, ball: Ball, angle: float) -> Tensor:
    """Return a ball alone as fits see it, black outside.

    Args:
        pixels: the photograph.
        ball: the ball in the photograph.
        angle: half the angle that the ball fills for the camera that is simulated, in rad.

    Returns:
        Display values, uint8 [1, 3, SPHERE_PHOTO_PX, SPHERE_PHOTO_PX].
    """
    light = torch.from_numpy(extract_ball(pixels, ball, SPHERE_PHOTO_PX, angle)[:3])
    return (linear_to_srgb(light) * sphere_normals(SPHERE_PHOTO_PX)[1] * 255).round().to(torch.uint8)[None]


def check_finite_pixels(pixels: Pixels, name: Path | str) -> None:
    """Raise ValueError if a photograph has values that are NaN or infinite; `name` begins the message."""
    if pixels.values.dtype.kind == "f" and (count := np.count_nonzero(~np.isfinite(pixels.values[..., :3]))):
        raise ValueError(f"{name}: {count:,} values are NaN or infinite, expected finite ones; export it again.")


def is_mirror_ball(pixels: Pixels, ball: Ball) -> bool:
    """Return True if a ball is surely a mirror, False if that cannot be told.

    A mirror shows edges as sharp as the photograph, all over, and dark things; a ball with a diffuse colour of its own,
    or a rough one, shows neither. A logistic regression on three numbers says which.
    """
    if ball.radius < _MIN_MIRROR_RADIUS_PX:
        return False
    return (
        float(
            np.dot(
                _MIRROR_WEIGHTS,
                mirror_features(extract_ball(pixels, ball, _MIRROR_PICTURE_PX, ball.half_angle_rad)[:3]),
            )
        )
        + _MIRROR_BIAS
        > 0
    )


def mirror_features(light: Floats) -> Floats:
    """Return three numbers about a ball, each of which grows with how much it looks like a mirror.

    They are the logarithms of: how much of the ball has steep gradients; how much steeper these are when they are less
    smoothed; how dark the ball gets beside the radiosity of a diffuse ball of the same mean.

    Args:
        light: linear RGB of the ball, [3, S, S].
    """
    size = light.shape[1]
    inside = np.hypot(*disc_places(size)) < _JUDGED_RADIUS_SHARE
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
