"""From photographs of a mirror ball to the light around it: found, aligned, merged, unwrapped."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from data_tools.readers.image_files import Pixels, read_pixels
from metapp.appearance.colour import srgb_to_linear
from metapp.apps.illumination.mirror import CLIPPED_VALUE
from metapp.extensions.capture.ball.alignment import aligned
from metapp.extensions.capture.ball.circle import FOUND, best_ball
from metapp.extensions.capture.ball.exposures import exif_exposure, merged, parsed, power_of
from metapp.extensions.capture.ball.shots import Shot, disc, gray_of, lens_of, photo_of, shot_of
from metapp.extensions.capture.ball.unwrap import unwrapped
from metapp.extensions.capture.ball.view import Ball, Floats, Lens, mirrored
from metapp.learning.task import Task

ROWS = 64

_AS_GOOD = 0.8  # of the best score: other balls are looked for where that one is
_LARGEST = 800  # px of the merged picture of the ball
_SHARED = 0.01  # of the ball, that may be white in the photograph that fits see


class Capture(NamedTuple):
    """Light around a ball.

    Attributes:
        shots: the photographs as they agree.
        chosen: which one fits see; white in it is radiance 1.
        exposures: [N], the chosen one's 1.
        power: of the camera's curve, as of `power_of`.
        residuals: of each photograph, as of `Merged`.
        seen: radiance [3, rows, 2 * rows].
        certain: [2, rows, 2 * rows], as of `unwrapped`.
    """

    shots: list[Shot]
    chosen: int
    exposures: Floats
    power: float
    residuals: list[float]
    seen: Tensor
    certain: Tensor

    def task(self, name: str) -> Task:
        """The task of it: the ball as a camera far away sees it in the chosen photograph, and what it mirrors."""
        photo = photo_of(self.shots[self.chosen], 0.0)
        return Task(name, {"photos": photo[None], "seen": self.seen, "certain": self.certain})


def merge(paths: Sequence[Path], shutter: str, rows: int = ROWS, fov_rad: float = 0.0) -> Task:
    """Turn photographs of one mirror ball, of different exposures, into a task named by the first one's stem.

    Args:
        paths: the files.
        shutter: times in their order, such as "1/20,1/60"; "auto": as EXIF says.
        rows: rows of the map.
        fov_rad: as of `capture`.

    Raises:
        ValueError: as `capture`; no exposure times.
    """
    times = () if shutter == "auto" else parsed(shutter)
    return capture(paths, times, fov_rad=fov_rad, rows=rows).task(paths[0].stem)


def capture(
    paths: Sequence[Path],
    times: Sequence[float] = (),
    *,
    fov_rad: float = 0.0,
    ball: tuple[float, float, float] | None = None,
    rows: int = ROWS,
    done: Callable[[str], object] = str,
) -> Capture:
    """Read photographs of one mirror ball.

    Args:
        paths: the photographs, of different exposures.
        times: of each, in any unit; () as EXIF says.
        fov_rad: of the camera along the shorter side; 0: as EXIF says of uncropped photographs, else far away.
        ball: x, y, radius in px of the first photograph; None: it is found.
        rows: of the map.
        done: called with the name of each photograph that was searched.

    Raises:
        ValueError: as `read_pixels`; no ball; another number of exposures than of photographs, or none; OpenCV is not
            installed and there are several photographs.
    """
    exposures = _exposures(paths, times)
    pictures: list[Pixels] = []
    found: list[Ball | None] = []
    brightness = []
    for path in paths:
        pixels = read_pixels(path)
        pictures.append(pixels)
        gray, lens = gray_of(pixels), lens_of(pixels, fov_rad)
        brightness.append(float(gray.mean()))
        found.append(_given(pixels, ball, lens) if ball else best_ball(gray, lens))
        done(path.name)
    if np.log(exposures) @ (np.array(brightness) - np.mean(brightness)) < 0:
        raise ValueError("exposures: photos get darker as times get longer, expected times such as 1/60, not 60.")
    first, balls = _agreed(paths, found)
    shots = [shot_of(pixels, ball) for pixels, ball in zip(pictures, balls, strict=True)]
    shots = aligned(shots, np.argsort(exposures).tolist(), first)
    return light_around(shots, first, exposures, rows)


def light_around(shots: list[Shot], first: int, exposures: Floats, rows: int) -> Capture:
    """The light that aligned photographs of one mirror ball show.

    Args:
        shots: the photographs.
        first: which one's camera looks along +z.
        exposures: [N], in any unit.
        rows: of the map.
    """
    order = np.argsort(exposures).tolist()
    nearest = shots[first].ball
    places = disc(min(_LARGEST, 2 * math.ceil(nearest.radius)))
    on_ball = np.hypot(*places) < 1
    pairs = [shot.at(mirrored(places, nearest.angle)) for shot in shots]
    lights = [light for light, _ in pairs]
    seen = [there & on_ball for _, there in pairs]
    chosen = _chosen(lights, seen, order)
    exposures = exposures / exposures[chosen]
    power = power_of(lights, seen, exposures)
    light = merged(lights, seen, exposures, power)
    texels = unwrapped(light.radiance, light.clipped, np.any(seen, 0), rows, nearest.angle, nearest.radius)
    return Capture(shots, chosen, exposures, power, light.residuals, *texels)


def _exposures(paths: Sequence[Path], times: Sequence[float]) -> Floats:
    """Times as they are given, else as EXIF says; 1 of one photograph."""
    many = len(paths)
    if times and len(times) != many:
        counts = f"exposures: {len(times)} for {many} photo{'s' * (many != 1)}"
        raise ValueError(f"{counts}, expected one for each, in their order.")
    if many == 1:
        return np.ones(1)
    values = np.array(times or [exif_exposure(path) for path in paths])
    if not times and (not (values > 0).all() or np.ptp(values) == 0):
        path = paths[int(np.argmin(values))]
        raise ValueError(
            f"{path}: {'the exposure of all photos' if values.all() else 'no exposure time'} in its EXIF, expected "
            f"different ones; give them: --shutter 1/20,1/60,1/160."
        )
    return values


def _given(pixels: Pixels, circle: tuple[float, float, float], lens: Lens | None) -> Ball:
    height, width = pixels.values.shape[:2]
    x, y, radius = circle
    if not (0 < radius < 2 * max(height, width) and 0 <= x <= width and 0 <= y <= height):
        raise ValueError(
            f"a ball at {x:g},{y:g} of radius {radius:g} px, expected one in the picture of {width}x{height} px; "
            "give --ball as X,Y,RADIUS in px from its upper left corner."
        )
    return Ball(x, y, radius, lens)


def _agreed(paths: Sequence[Path], balls: Sequence[Ball | None]) -> tuple[int, list[Ball]]:
    """The photograph that shows the ball best, and the ball in each, where it is not found as in that one.

    Raises:
        ValueError: no photograph shows a ball.
    """
    scores = [ball.score if ball else -1.0 for ball in balls]
    first = int(np.argmax(scores))
    best = balls[first]
    if best is None or best.score < FOUND:
        which = f"{paths[0]}" if len(paths) == 1 else f"{len(paths)} photos"
        raise ValueError(
            f"{which}: no ball found (best circle: {max(scores):.2f}), expected one whose contour shows "
            f"({FOUND:.2f} or more); say where it is with --ball X,Y,RADIUS."
        )
    return first, [ball if ball and ball.score >= _AS_GOOD * best.score else best for ball in balls]


def _chosen(lights: Sequence[Floats], seen: Sequence[np.ndarray], order: Sequence[int]) -> int:
    """The brightest photograph that is hardly white anywhere, else the darkest."""
    clip = srgb_to_linear(torch.tensor(CLIPPED_VALUE)).item()
    white = [float((light.max(0) >= clip)[there].mean()) for light, there in zip(lights, seen, strict=True)]
    return next((number for number in reversed(order) if white[number] <= _SHARED), order[0])
