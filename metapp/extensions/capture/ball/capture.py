"""From photographs of a mirror ball to the light around it: balls are found, aligned, merged and unwrapped.

`circle` finds balls, `bracket` aligns and merges their photographs. Here are the order of these steps, the unwrapping,
and what is done where a step fails. Nothing is written here.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_tools.readers.colours import Floats
from data_tools.readers.environment_maps import MAP_HEIGHT_PX
from data_tools.readers.image_files import Pixels, read_pixels
from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.latlong import texel_directions
from metapp.apps.illumination.mirror import CLIPPED_DISPLAY_VALUE
from metapp.extensions.capture.ball.ball_geometry import FAR_CAMERA_ANGLE_RAD, Ball, directions_to_disc
from metapp.extensions.capture.ball.ball_picture import (
    block_means,
    check_finite_pixels,
    extract_ball,
    extract_ball_photo,
    is_mirror_ball,
    lens_of_photo,
    sample_pixels,
)
from metapp.extensions.capture.ball.bracket import (
    align_balls,
    fit_curve_power,
    merge_exposures,
    pair_by_brightness,
    read_exposures,
)
from metapp.extensions.capture.ball.circle import MIN_BALL_SCORE, find_ball, score_ball
from metapp.extensions.capture.hand_photos import display_values
from metapp.learning.task import Task

_MIN_SCORE_SHARE = 0.8  # of the best score: a ball of a lower one is looked for at the place of the best ball
_MAX_BALL_PX = 800  # side of the merged picture of the ball
_MAX_WHITE_SHARE = 0.01  # of the ball, in the photograph that fits see
# What a pixel of the photograph spans: up to _SHARP_RAD its direction counts as seen, from _BLURRED_RAD on as not seen.
_SHARP_RAD, _BLURRED_RAD = math.pi / 64, math.pi / 16
_MAX_SAMPLES_PER_TEXEL = 16  # samples along the side of a texel
_SAME_BALL_SHARE = 0.03  # of the radius: how far a ball may be off the one that touches the central square's borders
_MIN_SCORE_GAIN = 1.2  # another ball must have so many times the score of the central one


class CapturedLight(NamedTuple):
    """The light around a ball, with what photographs of the ball show of it.

    Attributes:
        balls: the balls in the photographs, as these agree.
        reference_index: the index of the photograph that fits see; white in it is radiance 1.
        exposures: the exposures, [N], over the reference photograph's.
        power: the power of the camera's curve; see :func:`fit_curve_power`.
        residuals: for each photograph the share by which its radiance differs from the merged one; see
            :func:`merge_exposures`.
        data: the data of a task: `photos`, the ball of the reference photograph seen from far away; `seen` and
            `certain`, the light that the ball mirrors; see :func:`unwrap_ball`.
    """

    balls: Sequence[Ball]
    reference_index: int
    exposures: Floats
    power: float
    residuals: Sequence[float]
    data: dict[str, Tensor]


def merge_photos(
    paths: Sequence[Path], shutter: str, rows: int = MAP_HEIGHT_PX, fov_rad: float = 0.0, layer: str = ""
) -> Task:
    """Turn photographs of one mirror ball into a task named by the first photograph; see :func:`capture_light`."""
    return Task(paths[0].stem, capture_light(paths, shutter, rows, fov_rad, layer=layer).data)


def capture_light(
    paths: Sequence[Path],
    shutter: str = "auto",
    rows: int = MAP_HEIGHT_PX,
    fov_rad: float = 0.0,
    circle: Sequence[float] = (),
    done: Callable[[str], object] = str,
    layer: str = "",
) -> CapturedLight:
    """Read the light around a mirror ball from photographs of the ball.

    Args:
        paths: the photographs, of different exposures.
        shutter: the exposure times that :func:`read_exposures` takes.
        rows: the number of rows of the map.
        fov_rad: the field of view of the camera along the shorter side; 0 if it is not known: EXIF of uncropped
            photographs gives it, else the camera is taken to be far away.
        circle: x, y and radius of the ball in px of the first photograph; () if it is to be found.
        done: called with the name of each photograph that was searched.
        layer: the layer of the file that :func:`read_pixels` reads.

    Raises:
        ValueError: a file or an exposure cannot be read, no ball is found, or OpenCV is not installed where there are
            several photographs.
    """
    exposures = read_exposures(paths, shutter)
    photos, found_balls, brightness = [], [], []
    for path in paths:
        pixels = read_pixels(path, layer)
        check_finite_pixels(pixels, path)
        grey, lens = display_values(pixels).mean(-1), lens_of_photo(pixels, fov_rad, path)
        photos.append(pixels)
        found_balls.append(Ball(circle[0], circle[1], circle[2], lens) if circle else find_ball(grey, lens))
        brightness.append(float(grey.mean()))
        done(path.name)
    if shutter != "auto":
        exposures = pair_by_brightness(exposures, brightness, paths)
    if np.log(exposures) @ (np.array(brightness) - np.mean(brightness)) < 0:
        raise ValueError("exposures: photos get darker as times get longer, expected times such as 1/60, not 60.")
    scores = [ball.score if ball else -1.0 for ball in found_balls]
    first = int(np.argmax(scores))
    best, (height, width) = found_balls[first], photos[0].values.shape[:2]
    if not best or best.score < MIN_BALL_SCORE:
        photos_text = f"{paths[0]}" if len(paths) == 1 else f"{len(paths)} photos"
        raise ValueError(
            f"{photos_text}: no ball found (best circle: {max(scores):.2f}), expected one whose contour shows "
            f"({MIN_BALL_SCORE:.2f} or more); say where it is with --ball X,Y,RADIUS."
        )
    if not (best.radius < 2 * max(height, width) and 0 <= best.x <= width and 0 <= best.y <= height):
        raise ValueError(
            f"a ball at {best.x:g},{best.y:g} of radius {best.radius:g} px, expected one in the picture of "
            f"{width}x{height} px; give --ball as X,Y,RADIUS in px from its upper left corner."
        )
    balls = [ball if ball and ball.score >= _MIN_SCORE_SHARE * best.score else best for ball in found_balls]
    balls = align_balls(photos, balls, np.argsort(exposures).tolist(), first)
    return recover_light(photos, balls, first, exposures, rows)


def capture_single_photo(pixels: Pixels, name: str, square: Tensor, rows: int, fov_rad: float) -> dict[str, Tensor]:
    """Return the data of a task of one photograph: the ball in it, and its light if the ball is surely a mirror.

    Args:
        pixels: the photograph.
        name: the name of the task, with which messages begin.
        square: the photograph's central square as fits see it, uint8 [1, 3, SIZE, SIZE], which is taken where the ball
            that touches its borders explains the photograph as well as the ball that is found.
        rows: the number of rows of the map.
        fov_rad: the field of view of the camera along the shorter side; 0 if it is not known: EXIF of uncropped
            photographs gives it, else the camera is taken to be far away.

    Raises:
        ValueError: the photograph has values that are not finite.
    """
    check_finite_pixels(pixels, name)
    height, width = pixels.values.shape[:2]
    grey, central_ball = display_values(pixels).mean(-1), Ball(width / 2, height / 2, min(height, width) / 2)
    ball = find_ball(grey, lens_of_photo(pixels, fov_rad, name)) or central_ball
    is_same = max(np.abs(np.subtract(ball[:3], central_ball[:3]))) < _SAME_BALL_SHARE * central_ball.radius
    central_score = score_ball(grey, central_ball)
    is_central = is_same or ball.score < max(MIN_BALL_SCORE, _MIN_SCORE_GAIN * central_score)
    if max(ball.score, central_score) < MIN_BALL_SCORE:
        warnings.warn(
            f"{name}: no ball found (best circle: {max(ball.score, central_score):.2f}), expected one whose contour "
            f"shows ({MIN_BALL_SCORE:.2f} or more); the disc in the middle is taken for one: crop the photo to it.",
            stacklevel=2,
        )
    ball = central_ball if is_central else ball
    if is_mirror_ball(pixels, ball):
        return recover_light([pixels], [ball], 0, np.ones(1), rows).data
    return {"photos": square if is_central else extract_ball_photo(pixels, ball, ball.half_angle_rad)}


def recover_light(
    photos: Sequence[Pixels], balls: Sequence[Ball], first: int, exposures: Floats, rows: int
) -> CapturedLight:
    """Recover the light that aligned photographs of one mirror ball show.

    Floating-point photographs with values above 1 never clip.

    Args:
        photos: the photographs.
        balls: the balls in them.
        first: the index of the photograph whose camera looks along +z.
        exposures: the exposures, [N], in any unit.
        rows: the number of rows of the map.
    """
    first_ball = balls[first]
    size = min(_MAX_BALL_PX, 2 * math.ceil(first_ball.radius))
    values = [photo.values[..., :3] for photo in photos]
    is_hdr = all(pixels.dtype.kind == "f" for pixels in values) and max(pixels.max() for pixels in values) > 1
    max_value = np.inf if is_hdr else 1.0
    pictures = np.stack(
        [extract_ball(*photo, size, first_ball.half_angle_rad, max_value) for photo in zip(photos, balls, strict=True)]
    )
    # fits see the brightest photograph that is hardly white anywhere, else the darkest
    is_white_px = pictures[:, :3].max(1) >= srgb_to_linear(torch.tensor(CLIPPED_DISPLAY_VALUE)).item()
    white_shares = np.average(is_white_px.reshape(len(photos), -1), 1, pictures[:, 3].reshape(len(photos), -1))
    order = np.argsort(exposures).tolist()
    reference_index = next((number for number in reversed(order) if white_shares[number] <= _MAX_WHITE_SHARE), order[0])
    exposures = exposures / exposures[reference_index]
    power = 1.0 if is_hdr else fit_curve_power(pictures, exposures)
    radiance, is_clipped, residuals = merge_exposures(pictures, exposures, power, is_hdr)
    seen, certain = unwrap_ball(radiance, is_clipped, pictures[:, 3].max(0), first_ball, rows)
    data = {
        "photos": extract_ball_photo(photos[reference_index], balls[reference_index], FAR_CAMERA_ANGLE_RAD),
        "seen": seen,
        "certain": certain,
    }
    return CapturedLight(balls, reference_index, exposures, power, residuals, data)


def unwrap_ball(
    radiance: Floats, is_clipped: NDArray[np.bool_], shown: Floats, ball: Ball, rows: int
) -> tuple[Tensor, Tensor]:
    """Unwrap the picture of a mirror ball to a lat-long map.

    Texels are means over samples that lie as close as pixels do; where pixels are larger than texels, they are
    interpolated.

    Args:
        radiance: the picture, [3, S, S], which the ball fills.
        is_clipped: where the radiance is a lower bound, [S, S].
        shown: 1 where the radiance is known, 0 where it is not, [S, S].
        ball: the ball in the photograph.
        rows: the number of rows of the map.

    Returns:
        `seen`, the radiance [3, rows, 2 * rows], 0 where nothing is seen; `certain` [2, rows, 2 * rows] in [0, 1]: how
        far a texel is seen unclipped, and how far it is seen but clipped. Both fall to 0 towards the contour, where a
        pixel spans _BLURRED_RAD, and are 0 behind it.
    """
    size = radiance.shape[1]
    oversampling = min(_MAX_SAMPLES_PER_TEXEL, max(1, math.ceil(size / 4 * math.pi / rows)))
    planes = np.concatenate([radiance, is_clipped[None], shown[None]])
    directions = texel_directions(rows * oversampling, 2 * rows * oversampling, dtype=torch.float64).numpy()
    texels = []
    for row in range(rows):
        places, speed = directions_to_disc(
            directions[:, row * oversampling : (row + 1) * oversampling], ball.half_angle_rad
        )
        values = sample_pixels(planes, np.stack([1 + places[0], 1 - places[1]]) * (size / 2))
        sharpness = np.log(_BLURRED_RAD * (speed * ball.radius).clip(1e-9)) / math.log(_BLURRED_RAD / _SHARP_RAD)
        is_seen = (np.hypot(*places) < 1 - 1 / ball.radius) & (values[4] > 0.99)
        weight, is_clipped_sample = sharpness.clip(0, 1) * is_seen, values[3] > 0.01
        texels.append(
            block_means(
                np.stack([*(values[:3] * weight), weight * ~is_clipped_sample, weight * is_clipped_sample]),
                oversampling,
            )
        )
    light, certain = np.split(np.concatenate(texels, 1), [3])
    seen = light / certain.sum(0).clip(1e-6)
    return torch.from_numpy(seen).float(), torch.from_numpy(certain.clip(0, 1)).float()
