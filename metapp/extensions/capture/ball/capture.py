"""From photographs of a mirror ball to the light around it: found, aligned, merged, unwrapped."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from data_tools.readers.image_files import Pixels, read_pixels
from metapp.appearance.colour import linear_to_srgb
from metapp.apps.illumination.mirror import CLIPPED
from metapp.extensions.capture.ball.alignment import aligned
from metapp.extensions.capture.ball.exposures import (
    Curve,
    Merged,
    exif_exposure,
    measured_steps,
    merged,
    parsed,
    recovered_curve,
)
from metapp.extensions.capture.ball.photo import photo_of
from metapp.extensions.capture.ball.shots import FOUND, Shot, disc, gray_of, lens_of, searched, shot_of
from metapp.extensions.capture.ball.unwrap import unwrapped
from metapp.extensions.capture.ball.view import Ball, Floats, mirrored
from metapp.learning.task import Task

ROWS = 64

_AS_GOOD = 0.8  # of the best score: other balls are looked for where that one is
_LARGEST = 800  # px of the merged picture of the ball
_SHARED = 0.01  # of the ball, that may be white in the photograph that fits see
_BETTER = 0.9  # residuals of a recovered curve over those of sRGB's, for the former to be taken


@dataclass(frozen=True)
class Settings:
    """Settings of reading photographs of a ball.

    Attributes:
        exposures: of each photograph, in any unit; () as EXIF says, else as pixels tell.
        fov_rad: of the camera along the photographs' shorter side; 0: as EXIF says, else far away.
        ball: x, y, radius in px of the first photograph; None: it is found.
        rows: of the map.
    """

    exposures: tuple[float, ...] = ()
    fov_rad: float = 0.0
    ball: tuple[float, float, float] | None = None
    rows: int = ROWS


class Capture(NamedTuple):
    """Light around a ball.

    Attributes:
        shots: the photographs as they agree.
        first: which one's camera looks along +z.
        chosen: which one fits see; white in it is radiance 1.
        exposures: [N], the chosen one's 1.
        told_by: what these are by.
        curve: "sRGB" or "recovered".
        light: radiance of the ball's picture.
        seen: radiance [3, rows, 2 * rows].
        certain: [2, rows, 2 * rows], as of `unwrapped`.
        photo: uint8 [3, 64, 64], the ball as a camera far away sees it in the chosen photograph.
    """

    shots: list[Shot]
    first: int
    chosen: int
    exposures: Floats
    told_by: str
    curve: str
    light: Merged
    seen: Tensor
    certain: Tensor
    photo: Tensor


def capture(paths: Sequence[Path], settings: Settings, done: Callable[[str], object] = str) -> Capture:
    """Read photographs of one mirror ball.

    Args:
        paths: the photographs, of different exposures.
        settings: how.
        done: called with the name of each photograph that was searched.

    Raises:
        ValueError: as `read_pixels`; no ball; another number of exposures than of photographs.
    """
    given = settings.exposures
    if given and len(given) != len(paths):
        counts = f"exposures: {len(given)} for {len(paths)} photo{'s' * (len(paths) != 1)}"
        raise ValueError(f"{counts}, expected one for each, in their order.")
    pictures: list[Pixels] = []
    candidates: list[Ball | None] = []
    for path in paths:
        pixels = read_pixels(path)
        pictures.append(pixels)
        candidates.append(_ball(pixels, settings))
        done(path.name)
    first, balls = _agreed(paths, candidates)
    brightness = [float(gray_of(pixels).mean()) for pixels in pictures]
    exposures, told_by = _known(paths, given, brightness)
    order = np.argsort(brightness if exposures is None else exposures).tolist()
    shots = [shot_of(pixels, ball) for pixels, ball in zip(pictures, balls, strict=True)]
    shots = aligned(shots, order, first)
    return _merged(shots, first, order, (exposures, told_by), settings)


def _ball(pixels: Pixels, settings: Settings) -> Ball | None:
    height, width = pixels.values.shape[:2]
    lens = lens_of(pixels, settings.fov_rad)
    if settings.ball:
        x, y, radius = settings.ball
        if not (0 < radius < 2 * max(height, width) and 0 <= x <= width and 0 <= y <= height):
            raise ValueError(
                f"a ball at {x:g},{y:g} of radius {radius:g} px, expected one in the picture of {width}x{height} px; "
                "give --ball as X,Y,RADIUS in px from its upper left corner."
            )
        return Ball(x, y, radius, lens=lens)
    return searched(pixels, lens)


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
    lenses = [ball.lens if ball else best.lens for ball in balls]
    known = [ball if ball and ball.score >= _AS_GOOD * best.score else best for ball in balls]
    return first, [ball._replace(slant=best.slant, lens=lens) for ball, lens in zip(known, lenses, strict=True)]


def _known(paths: Sequence[Path], given: Sequence[float], brightness: Sequence[float]) -> tuple[Floats | None, str]:
    """Exposures and what they are by; None where pixels must tell.

    Numbers that fall as photographs get brighter are taken for those below the line: 60 for 1/60.
    """
    if len(paths) == 1:
        return np.ones(1), "one photo"
    told_by = "--exposures" if given else "EXIF"
    values = np.array(given or [exif_exposure(path) for path in paths])
    if not (values > 0).all() or (not given and np.ptp(values) == 0):
        return None, "the pixels"
    logs = np.log(values) - np.log(values).mean()
    if float(logs @ (np.array(brightness) - np.mean(brightness))) < 0:
        return 1 / values, f"{told_by}, as 1 over each"
    return values, told_by


def _merged(
    shots: list[Shot], first: int, order: list[int], known: tuple[Floats | None, str], settings: Settings
) -> Capture:
    best = shots[first].ball
    size = min(_LARGEST, 2 * math.ceil(best.radius))
    places = disc(size)
    towards = mirrored(places, best.angle)
    on_ball = np.hypot(*places) < 1
    pairs = [shot.at(towards) for shot in shots]
    lights, seen = [light for light, _ in pairs], [there & on_ball for _, there in pairs]
    exposures, told_by = known
    can_recover = exposures is not None and len(shots) >= 3
    if exposures is None:
        exposures = measured_steps(lights, seen, order)
    chosen = _chosen(lights, seen, order)
    exposures = exposures / exposures[chosen]
    light, curve = merged(lights, seen, exposures), "sRGB"
    if can_recover:
        own = recovered(lights, seen, exposures)
        if own and sum(own.residuals) < _BETTER * sum(light.residuals):
            light, curve = own, "recovered"
    unclipped = light.seen & on_ball
    seen_map, certain = unwrapped(light.radiance, light.clipped, unclipped, settings.rows, best.angle, best.radius)
    photo = photo_of(shots[chosen])
    return Capture(shots, first, chosen, exposures, told_by, curve, light, seen_map, certain, photo)


def recovered(lights: Sequence[Floats], seen: Sequence[np.ndarray], exposures: Floats) -> Merged | None:
    """Merged by a curve that is recovered; None where too few pixels tell it."""
    displays = [linear_to_srgb(torch.from_numpy(light)).numpy() for light in lights]
    curve: Curve | None = recovered_curve(displays, seen, exposures)
    return merged(lights, seen, exposures, curve) if curve else None


def _chosen(lights: Sequence[Floats], seen: Sequence[np.ndarray], order: Sequence[int]) -> int:
    """The brightest photograph that is hardly white anywhere, else the darkest."""
    white = [float((light.max(0) >= CLIPPED)[there].mean()) for light, there in zip(lights, seen, strict=True)]
    return next((number for number in reversed(order) if white[number] <= _SHARED), order[0])


def merge(paths: Sequence[Path], exposures: str, size: int = ROWS, fov_rad: float = 0.0) -> Task:
    """Turn photographs of one mirror ball, of different exposures, into a task named by the first one's stem.

    Args:
        paths: the files.
        exposures: times in their order, such as "1/20,1/60"; "auto": as EXIF says, else as pixels tell.
        size: rows of the map.
        fov_rad: of the camera along the shorter side; 0: as EXIF says of uncropped photographs, else far away.

    Raises:
        ValueError: as `capture`; no exposure times.
    """
    times = () if exposures == "auto" else tuple(parsed(exposures))
    return task_of(paths[0].stem, capture(paths, Settings(times, fov_rad, rows=size)))


def task_of(name: str, captured: Capture) -> Task:
    """The task of a capture."""
    return Task(name, {"photos": captured.photo[None], "seen": captured.seen, "certain": captured.certain})
