"""Photographs of a glossy ball under a lamp that moves, turned into the lamp's direction for each photograph.

Photographs are read twice, once for the search and once for the parts around balls, so that memory holds neither all of
them nor one of them in linear light at its own resolution.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from data_tools.readers.colours import Floats
from data_tools.readers.image_files import Pixels, read_pixels
from metapp.extensions.capture.ball.ball_geometry import PARALLEL_LENS, Ball, PinholeLens
from metapp.extensions.capture.ball.ball_picture import block_means, check_finite_pixels, lens_of_photo
from metapp.extensions.capture.lights.ball_search import (
    LitBall,
    correct_contour,
    find_lit_balls,
    measure_ball,
    window_around,
)
from metapp.extensions.capture.lights.lamps import Lamps, join_balls
from metapp.extensions.capture.lights.shading import MAX_DEVIATION_DEGREES, find_contradictions

MIN_PHOTOS = 3  # whose darkest shows the ball without the lamp

_SEARCHED_PX = 480  # longer side of photographs that are searched, at least, where they are shrunk
_ROWS_AT_ONCE = 512  # rows, about, that are in linear light at a time
_SHADING_CELLS = 32  # along the longer side of photographs whose shading is compared
_MASKED_RADII = 2.0  # of a ball: the ball and its shadows do not count as shading of the scene


class MeasuredLights(NamedTuple):
    """The light's directions of photographs, with what they were found by.

    Attributes:
        paths: the photographs, in the order of their files.
        balls: the balls and their highlights.
        lamps: the directions, by photograph; NaN where they are not known or contradicted.
        faults: why photographs have no direction, by their number.
        brightest: the greatest value of each pixel in all photographs, linear RGB [h, w, 3], shrunk by a whole factor.
        shape: rows and columns of the photographs.
    """

    paths: Sequence[Path]
    balls: Sequence[LitBall]
    lamps: Lamps
    faults: dict[int, str]
    brightest: Floats
    shape: tuple[int, int]


def measure_lights(
    paths: Sequence[Path],
    circles: Sequence[Sequence[float]] = (),
    fov_rad: float = 0.0,
    layer: str = "",
    done: Callable[[str], object] = str,
) -> MeasuredLights:
    """Measure the light's direction in photographs of one or two glossy balls by a camera that stands still.

    Args:
        paths: the photographs, of one size.
        circles: x, y and radius of balls in px of the photographs; () if they are to be found.
        fov_rad: the field of view of the camera along the shorter side; 0 if it is not known: EXIF of uncropped
            photographs gives it, else the camera is taken to be far away.
        layer: the layer of the file that :func:`read_pixels` reads.
        done: called with the name of each photograph that was read, twice for each.

    Raises:
        ValueError: a photograph cannot be read, there are too few, or of different sizes; no ball is found.
    """
    if len(paths) < MIN_PHOTOS:
        found = f"{paths[0]}: {len(paths)} photo{'s' * (len(paths) > 1)} of the ball"
        raise ValueError(f"{found}, expected {MIN_PHOTOS} or more, under a lamp that moves; add the others.")
    pictures, brightest, shape, lens = _read_shrunk(paths, fov_rad, layer, done)
    factor = shape[1] // pictures.shape[2]
    if circles:
        balls = [_place_circle(circle, shape, lens) for circle in circles]
    else:
        balls = [lit_ball.ball.resize(factor) for lit_ball in find_lit_balls(pictures, lens.resize(1 / factor))]
    if not balls:
        raise ValueError(
            f"{paths[0]} and {len(paths) - 1} more: no glossy ball found, expected one that shows the lamp in most "
            "photos, by a camera that stands still; say where it is with --ball X,Y,RADIUS."
        )
    lit_balls = _measure_balls(paths, balls, shape, layer, done)
    lamps = join_balls(
        np.stack([lit_ball.directions for lit_ball in lit_balls]), [ball.ball for ball in lit_balls], shape
    )
    faults = _describe_faults(lit_balls, lamps)
    known = [number for number in range(len(paths)) if number not in faults]
    scene = _scene_values(pictures, [lit_ball.ball.resize(1 / factor) for lit_ball in lit_balls])
    for row, degrees in find_contradictions(scene[known], lamps.directions[known]).items():
        expected = f"expected {MAX_DEVIATION_DEGREES:.0f} or less"
        faults[known[row]] = f"shading is of a light {degrees:.0f} degrees from the highlight's, {expected}"
    lamps.directions[list(faults)] = np.nan
    return MeasuredLights(paths, lit_balls, lamps, faults, brightest, shape)


def _read_shrunk(
    paths: Sequence[Path], fov_rad: float, layer: str, done: Callable[[str], object]
) -> tuple[Floats, Floats, tuple[int, int], PinholeLens]:
    """Read photographs, shrunk by a whole factor to the size in which balls are searched.

    Returns:
        The photographs in grey linear light, [N, h, w]; the greatest values of all, linear RGB [h, w, 3]; rows and
        columns before they are shrunk; the lens of the first one.
    """
    pictures: list[Floats] = []
    brightest, shape, lens = np.zeros(()), (0, 0), PARALLEL_LENS
    for path in paths:
        pixels = read_pixels(path, layer)
        check_finite_pixels(pixels, path)
        rows, columns = pixels.values.shape[:2]
        if not pictures:
            shape, lens = (rows, columns), lens_of_photo(pixels, fov_rad, path)
        if (rows, columns) != shape:
            expected = f"{shape[1]} x {shape[0]} px as {paths[0].name} has, by a camera that stands still"
            raise ValueError(f"{path}: {columns} x {rows} px, expected {expected}; leave it out.")
        colours = _shrink(pixels, max(1, max(shape) // _SEARCHED_PX))
        pictures.append(colours.mean(-1, dtype=np.float32))
        brightest = np.maximum(brightest, colours)
        done(path.name)
    return np.stack(pictures), brightest, shape, lens


def _shrink(pixels: Pixels, factor: int) -> Floats:
    """Return a photograph in linear RGB, [h, w, 3], shrunk by a whole factor; what is left at its end is cut off."""
    rows, columns = (side // factor * factor for side in pixels.values.shape[:2])
    step, parts = max(1, _ROWS_AT_ONCE // factor) * factor, []
    for start in range(0, rows, step):
        linear = pixels.linear(slice(start, min(rows, start + step)))[:, :columns, :3]
        parts.append(block_means(linear.transpose(2, 0, 1), factor).transpose(1, 2, 0).astype(np.float32))
    return np.concatenate(parts)


def _place_circle(circle: Sequence[float], shape: tuple[int, int], lens: PinholeLens) -> Ball:
    """Return a ball that the user states.

    Raises:
        ValueError: it is not in the picture.
    """
    x, y, radius = circle
    rows, columns = shape
    if not (radius < max(shape) and 0 <= x <= columns and 0 <= y <= rows):
        raise ValueError(
            f"a ball at {x:g},{y:g} of radius {radius:g} px, expected one in the picture of {columns}x{rows} px; give "
            "--ball as X,Y,RADIUS in px from its upper left corner."
        )
    return Ball(x, y, radius, lens)


def _measure_balls(
    paths: Sequence[Path], balls: Sequence[Ball], shape: tuple[int, int], layer: str, done: Callable[[str], object]
) -> list[LitBall]:
    """Correct the contours of balls, and measure their highlights, at the photographs' own resolution."""
    windows = [window_around(ball, shape) for ball in balls]
    cut: list[list[Floats]] = [[] for _ in balls]
    for path in paths:
        pixels = read_pixels(path, layer)
        for window, parts in zip(windows, cut, strict=True):
            part = pixels._replace(values=pixels.values[window.part])
            parts.append(_shrink(part, window.factor).mean(-1))
        done(path.name)
    stacks = [np.stack(parts) for parts in cut]
    corrected = [correct_contour(*given) for given in zip(stacks, windows, balls, strict=True)]
    return [measure_ball(*given) for given in zip(stacks, windows, corrected, strict=True)]


def _describe_faults(lit_balls: Sequence[LitBall], lamps: Lamps) -> dict[int, str]:
    """Return why photographs have no direction, by their number: the fault on the first ball that states one."""
    faults = {}
    for number, direction in enumerate(lamps.directions):
        if not np.isfinite(direction).all():
            faults[number] = f"{lit_balls[0].highlights[number].fault}, expected one"
        elif direction[2] <= 0:
            faults[number] = (
                f"the light is {-math.degrees(math.asin(direction[2])):.0f} degrees below the picture's plane"
            )
    return faults


def _scene_values(pictures: Floats, balls: Sequence[Ball]) -> Floats:
    """Return what photographs show beside balls, shrunk to cells, [N, P]."""
    factor = max(1, max(pictures.shape[1:]) // _SHADING_CELLS)
    rows, columns = (side // factor * factor for side in pictures.shape[1:])
    cells = block_means(pictures[:, :rows, :columns], factor)
    y, x = ((np.arange(side) + 0.5) * factor for side in cells.shape[1:])
    is_scene = np.ones(cells.shape[1:], bool)
    for ball in balls:
        is_scene &= np.hypot(*(np.stack(np.meshgrid(x - ball.x, y - ball.y)))) > _MASKED_RADII * ball.radius + factor
    return cells[:, is_scene]
