"""From photographs of a mirror ball to the light around it: found, aligned, merged, unwrapped."""

from __future__ import annotations

import math
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
from metapp.apps.illumination.mirror import CLIPPED_VALUE
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
from metapp.extensions.capture.ball.bracket import align_balls, fit_curve_power, merge_exposures, read_exposures
from metapp.extensions.capture.ball.circle import MIN_BALL_SCORE, find_ball, score_ball
from metapp.extensions.capture.hand_photos import display_values
from metapp.learning.task import Task

_AS_GOOD = 0.8  # of the best score: other balls are looked for where that one is
_LARGEST_PX = 800  # side of the merged picture of the ball
_MAX_WHITE = 0.01  # share of the ball, in the photograph that fits see
_SHARP_RAD, _BLURRED_RAD = math.pi / 64, math.pi / 16  # a pixel: up to the one it is seen, from the other it is not
_FINEST = 16  # samples along a texel
_SAME = 0.03  # of the radius, by which a ball may miss the one that touches the central square's borders
_BETTER = 1.2  # of its score, that another ball must have


class CapturedLight(NamedTuple):
    """Light around a ball.

    Attributes:
        balls: in the photographs, as these agree.
        chosen: which photograph fits see; white in it is radiance 1.
        exposures: [N], the chosen one's 1.
        power: of the camera's curve, as of `fit_curve_power`.
        residuals: of each photograph, as of `merge_exposures`.
        data: of a task: `photos`, the ball of the chosen photograph seen from far away, and the light that it mirrors,
            `seen` and `certain`, as of `unwrap_ball`.
    """

    balls: Sequence[Ball]
    chosen: int
    exposures: Floats
    power: float
    residuals: Sequence[float]
    data: dict[str, Tensor]


def merge_photos(
    paths: Sequence[Path], shutter: str, rows: int = MAP_HEIGHT_PX, fov_rad: float = 0.0, layer: str = ""
) -> Task:
    """Turn photographs of one mirror ball into a task named by the first one's stem; arguments as of `capture_light`."""
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
    """Read photographs of one mirror ball.

    Args:
        paths: the photographs, of different exposures.
        shutter: as of `read_exposures`.
        rows: of the map.
        fov_rad: of the camera along the shorter side; 0: as EXIF says of uncropped photographs, else far away.
        circle: x, y, radius of the ball in px of the first photograph; (): it is found.
        done: called with the name of each photograph that was searched.
        layer: as of `read_pixels`.

    Raises:
        ValueError: as `read_pixels` and `read_exposures`; no ball; OpenCV is not installed and there are several
            photographs.
    """
    exposures = read_exposures(paths, shutter)
    photos, found, brightness = [], [], []
    for path in paths:
        pixels = read_pixels(path, layer)
        check_finite_pixels(pixels, path)
        gray, lens = display_values(pixels).mean(-1), lens_of_photo(pixels, fov_rad)
        photos.append(pixels)
        found.append(Ball(circle[0], circle[1], circle[2], lens) if circle else find_ball(gray, lens))
        brightness.append(float(gray.mean()))
        done(path.name)
    if np.log(exposures) @ (np.array(brightness) - np.mean(brightness)) < 0:
        raise ValueError("exposures: photos get darker as times get longer, expected times such as 1/60, not 60.")
    scores = [ball.score if ball else -1.0 for ball in found]
    first = int(np.argmax(scores))
    best, (height, width) = found[first], photos[0].values.shape[:2]
    if not best or best.score < MIN_BALL_SCORE:
        which = f"{paths[0]}" if len(paths) == 1 else f"{len(paths)} photos"
        raise ValueError(
            f"{which}: no ball found (best circle: {max(scores):.2f}), expected one whose contour shows "
            f"({MIN_BALL_SCORE:.2f} or more); say where it is with --ball X,Y,RADIUS."
        )
    if not (best.radius < 2 * max(height, width) and 0 <= best.x <= width and 0 <= best.y <= height):
        raise ValueError(
            f"a ball at {best.x:g},{best.y:g} of radius {best.radius:g} px, expected one in the picture of "
            f"{width}x{height} px; give --ball as X,Y,RADIUS in px from its upper left corner."
        )
    balls = [ball if ball and ball.score >= _AS_GOOD * best.score else best for ball in found]
    balls = align_balls(photos, balls, np.argsort(exposures).tolist(), first)
    return recover_light(photos, balls, first, exposures, rows)


def capture_single_photo(pixels: Pixels, name: str, square: Tensor, rows: int, fov_rad: float) -> dict[str, Tensor]:
    """Return the data of a task of one photograph: of the ball in it, and of its light if it is surely a mirror.

    Args:
        pixels: the photograph.
        name: of the task; begins errors.
        square: its central square as fits see it, uint8 [1, 3, SIZE, SIZE], which is taken where the ball that touches
            its borders explains the photograph as well as the one that is found.
        rows: of the map.
        fov_rad: of the camera along the shorter side; 0: as EXIF says of uncropped photographs, else far away.

    Raises:
        ValueError: the photograph has values that are not finite.
    """
    check_finite_pixels(pixels, name)
    height, width = pixels.values.shape[:2]
    gray, central = display_values(pixels).mean(-1), Ball(width / 2, height / 2, min(height, width) / 2)
    ball = find_ball(gray, lens_of_photo(pixels, fov_rad)) or central
    is_same = max(np.abs(np.subtract(ball[:3], central[:3]))) < _SAME * central.radius
    is_central = is_same or ball.score < max(MIN_BALL_SCORE, _BETTER * score_ball(gray, central))
    ball = central if is_central else ball
    if is_mirror_ball(pixels, ball):
        return recover_light([pixels], [ball], 0, np.ones(1), rows).data
    return {"photos": square if is_central else extract_ball_photo(pixels, ball, ball.angle)}


def recover_light(
    photos: Sequence[Pixels], balls: Sequence[Ball], first: int, exposures: Floats, rows: int
) -> CapturedLight:
    """The light that aligned photographs of one mirror ball show; floating-point ones with values above 1 never clip.

    Args:
        photos: the photographs.
        balls: in them.
        first: which one's camera looks along +z.
        exposures: [N], in any unit.
        rows: of the map.
    """
    nearest = balls[first]
    size = min(_LARGEST_PX, 2 * math.ceil(nearest.radius))
    values = [photo.values[..., :3] for photo in photos]
    is_hdr = all(each.dtype.kind == "f" for each in values) and max(each.max() for each in values) > 1
    high = np.inf if is_hdr else 1.0
    pictures = np.stack([extract_ball(*photo, size, nearest.angle, high) for photo in zip(photos, balls, strict=True)])
    # the brightest photograph that is hardly white anywhere, else the darkest
    is_white = pictures[:, :3].max(1) >= srgb_to_linear(torch.tensor(CLIPPED_VALUE)).item()
    white = np.average(is_white.reshape(len(photos), -1), 1, pictures[:, 3].reshape(len(photos), -1))
    order = np.argsort(exposures).tolist()
    chosen = next((number for number in reversed(order) if white[number] <= _MAX_WHITE), order[0])
    exposures = exposures / exposures[chosen]
    power = 1.0 if is_hdr else fit_curve_power(pictures, exposures)
    radiance, is_clipped, residuals = merge_exposures(pictures, exposures, power, is_hdr)
    seen, certain = unwrap_ball(radiance, is_clipped, pictures[:, 3].max(0), nearest, rows)
    data = {
        "photos": extract_ball_photo(photos[chosen], balls[chosen], FAR_CAMERA_ANGLE_RAD),
        "seen": seen,
        "certain": certain,
    }
    return CapturedLight(balls, chosen, exposures, power, residuals, data)


def unwrap_ball(
    radiance: Floats, is_clipped: NDArray[np.bool_], shown: Floats, ball: Ball, rows: int
) -> tuple[Tensor, Tensor]:
    """A map of a picture of a mirror ball.

    Texels are means over samples that lie as close as pixels do; where pixels are larger, they are interpolated.

    Args:
        radiance: [3, S, S] of the ball, which fills the picture.
        is_clipped: where it is a lower bound.
        shown: if it is known, 1, and if it is not, 0.
        ball: in the photograph.
        rows: of the map.

    Returns:
        `seen`, radiance [3, rows, 2 * rows], 0 where nothing is seen; `certain` [2, rows, 2 * rows] in [0, 1]: how far
        a texel is seen unclipped, and how far it is seen but clipped. Both fall to 0 towards the contour, where a
        pixel shows _BLURRED_RAD, and are 0 behind it.
    """
    size = radiance.shape[1]
    many = min(_FINEST, max(1, math.ceil(size / 4 * math.pi / rows)))
    planes = np.concatenate([radiance, is_clipped[None], shown[None]])
    towards = texel_directions(rows * many, 2 * rows * many, dtype=torch.float64).numpy()
    texels = []
    for row in range(rows):
        place, speed = directions_to_disc(towards[:, row * many : (row + 1) * many], ball.angle)
        values = sample_pixels(planes, np.stack([1 + place[0], 1 - place[1]]) * (size / 2))
        sharp = np.log(_BLURRED_RAD * (speed * ball.radius).clip(1e-9)) / math.log(_BLURRED_RAD / _SHARP_RAD)
        is_seen = (np.hypot(*place) < 1 - 1 / ball.radius) & (values[4] > 0.99)
        weight, is_lost = sharp.clip(0, 1) * is_seen, values[3] > 0.01
        texels.append(block_means(np.stack([*(values[:3] * weight), weight * ~is_lost, weight * is_lost]), many))
    light, certain = np.split(np.concatenate(texels, 1), [3])
    seen = light / certain.sum(0).clip(1e-6)
    return torch.from_numpy(seen).float(), torch.from_numpy(certain.clip(0, 1)).float()
