"""Glossy balls found by all photographs of a camera that stands still, under a lamp that moves.

The contour is what edges agree with that stay while shadows and highlights move. A circle is a ball if most photographs
have one highlight in it; two circles are two balls if their highlights tell the same directions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch

from data_tools.readers.colours import Floats
from metapp.appearance.colour import linear_to_srgb
from metapp.extensions.capture.ball.ball_geometry import Ball, PinholeLens
from metapp.extensions.capture.ball.ball_picture import block_means
from metapp.extensions.capture.ball.circle import (
    find_circles,
    find_edges,
    find_gradients,
    log_display,
    move_ball,
    score_contour,
)
from metapp.extensions.capture.lights.highlights import Highlight, measure_highlights
from metapp.extensions.capture.lights.lamps import join_balls
from metapp.extensions.capture.lights.rim import fit_rim

SURROUNDINGS = 1.4  # of the radius: half the side of the square that is cut out around a ball
MEASURED_RADIUS_PX = 100  # of balls that are measured, at least, where they are shrunk

_SEARCHED_PX = (160, 480)  # longer sides of the pictures in which large balls are searched, then small ones
_RADIUS_SHARES = ((0.12, 0.75), (0.012, 0.1))  # radii that are searched, over the shorter and over the longer side
_MIN_CONTOUR_SCORE = 0.3  # of circles that are looked at
_TRIED_CIRCLES = 8  # for each size of the searched pictures
_TRIED_RADIUS_PX = 30  # of circles that are tried, at least, where they are shrunk
_MIN_LIT_SHARE = 0.5  # of the photographs: a circle with one highlight in fewer is no ball
_SAME_LIGHT_DEGREES = 20.0  # by which the directions of two balls differ at most, beyond the parallax of a near lamp
_MAX_RADIUS_RATIO = 3.0  # of two balls
_LIT_SHARE = 0.75  # the rank of the photograph, at each pixel, that shows the rim without shadows or highlights
_MAX_CORRECTION = 0.08  # of the radius, by which the contour corrects a circle


class Window(NamedTuple):
    """A part of a photograph around a ball, shrunk by a whole factor.

    Attributes:
        top, left: the first row and column of the part.
        rows, columns: the number of its rows and columns, before it is shrunk.
        factor: the side, in px, of the squares whose means are taken.
    """

    top: int
    left: int
    rows: int
    columns: int
    factor: int

    @property
    def part(self) -> tuple[slice, slice]:
        """The rows and columns of the photograph."""
        return slice(self.top, self.top + self.rows), slice(self.left, self.left + self.columns)

    def place_ball(self, ball: Ball) -> Ball:
        """Return a ball of the photograph, in px of the shrunk part."""
        return _shift(ball, -self.left, -self.top).resize(1 / self.factor)

    def place_ball_back(self, ball: Ball) -> Ball:
        """Return a ball in px of the shrunk part, in px of the photograph."""
        return _shift(ball.resize(self.factor), self.left, self.top)


class LitBall(NamedTuple):
    """A ball in photographs, and what it tells of each.

    Attributes:
        ball: the ball, in px of the photographs.
        highlights: the highlights, by photograph, with places in px of the photographs.
    """

    ball: Ball
    highlights: Sequence[Highlight]

    @property
    def directions(self) -> Floats:
        """The directions to the lamp, [N, 3]; NaN where they are not known."""
        return np.stack([highlight.direction for highlight in self.highlights])

    @property
    def lit_share(self) -> float:
        """The share of the photographs whose direction is known."""
        return float(np.isfinite(self.directions[:, 0]).mean())


def find_lit_balls(pictures: Floats, lens: PinholeLens) -> list[LitBall]:
    """Find up to two glossy balls, the surest first; contours and highlights are measured roughly.

    Args:
        pictures: photographs in linear light, [N, h, w].
        lens: the camera's lens, in px of the pictures.
    """
    found = []
    for searched_px, radius_shares in zip(_SEARCHED_PX, _RADIUS_SHARES, strict=True):
        share = min(1.0, searched_px / max(pictures.shape[1:]))
        edges = find_constant_edges(pictures, share)
        resized_lens = lens.resize(share)
        circles = [score_contour(edges, Ball(*circle, resized_lens)) for circle in find_circles(edges, radius_shares)]
        for circle in sorted(circles, key=lambda ball: ball.score, reverse=True)[:_TRIED_CIRCLES]:
            ball = move_ball(edges, circle).resize(1 / share)
            if ball.score > _MIN_CONTOUR_SCORE:
                found.append(_try_ball(pictures, ball))
    found = [lit_ball for lit_ball in found if lit_ball.lit_share >= _MIN_LIT_SHARE]
    found.sort(key=lambda lit_ball: lit_ball.lit_share * lit_ball.ball.score, reverse=True)
    shape = pictures.shape[1:]
    return [*found[:1], *[other for other in found[1:] if _tell_same_light(found[0], other, shape)][:1]]


def window_around(ball: Ball, shape: Sequence[int], radius_px: float = MEASURED_RADIUS_PX) -> Window:
    """Return the window around a ball in photographs of a shape (rows, columns), in which the ball is measured.

    Args:
        ball: the ball.
        shape: rows and columns of the photographs.
        radius_px: the radius, at least, that the ball has in the window, unless it is smaller in the photographs.
    """
    factor, reach = max(1, int(ball.radius / radius_px)), SURROUNDINGS * ball.radius
    top, left = (max(0, int(place - reach)) for place in (ball.y, ball.x))
    rows, columns = (
        (min(side, int(place + reach) + 1) - start) // factor * factor
        for side, place, start in zip(shape, (ball.y, ball.x), (top, left), strict=True)
    )
    return Window(top, left, rows, columns, factor)


def measure_ball(pictures: Floats, window: Window, ball: Ball) -> LitBall:
    """Measure the highlights on a ball.

    Args:
        pictures: photographs in linear light, cut by the window, [N, h, w].
        window: the window.
        ball: the ball, in px of the photographs.
    """
    corner = np.array([window.left, window.top])
    highlights = [
        highlight._replace(peak_px=highlight.peak_px * window.factor + corner)
        for highlight in measure_highlights(pictures, window.place_ball(ball))
    ]
    return LitBall(ball, highlights)


def correct_contour(pictures: Floats, window: Window, ball: Ball) -> Ball:
    """Return a ball whose contour follows photographs more closely, or the ball itself if that would be another one.

    Args:
        pictures: photographs in linear light, cut by the window, [N, h, w].
        window: the window.
        ball: the ball, in px of the photographs.
    """
    edges, known = find_constant_edges(pictures, 1.0), window.place_ball(ball)
    corrected = fit_rim(np.sort(pictures, 0)[int(_LIT_SHARE * (len(pictures) - 1))], move_ball(edges, known, 1))
    if max(np.abs(np.subtract(corrected[:3], known[:3]))) > _MAX_CORRECTION * known.radius:
        return ball
    return window.place_ball_back(corrected)


def find_constant_edges(pictures: Floats, share: float) -> Floats:
    """Return the edges of photographs that stay while the lamp moves, as those of reflectance do (Weiss 2001).

    Args:
        pictures: photographs in linear light, [N, h, w].
        share: the size of the result over the photographs'.

    Returns:
        The edges as :func:`find_edges` returns them, [3, ...].
    """
    logs = (log_display(linear_to_srgb(torch.from_numpy(picture)).numpy()) for picture in pictures)
    return find_edges(np.median([find_gradients(values, share) for values in logs], 0))


def _shift(ball: Ball, right: float, down: float) -> Ball:
    """Return a ball as it lies in a photograph whose upper left corner is moved by px the other way."""
    lens = ball.lens._replace(x=ball.lens.x + right, y=ball.lens.y + down)
    return ball._replace(x=ball.x + right, y=ball.y + down, lens=lens)


def _try_ball(pictures: Floats, ball: Ball) -> LitBall:
    """Measure highlights roughly in a circle that may be a ball."""
    window = window_around(ball, pictures.shape[1:], _TRIED_RADIUS_PX)
    rows, columns = window.part
    return measure_ball(block_means(pictures[:, rows, columns], window.factor), window, ball)


def _tell_same_light(first: LitBall, other: LitBall, shape: Sequence[int]) -> bool:
    """Tell whether two circles are two balls: beside each other, of similar size, in the light of the same lamps."""
    distance = np.hypot(first.ball.x - other.ball.x, first.ball.y - other.ball.y)
    radii = sorted((first.ball.radius, other.ball.radius))
    directions = np.stack([first.directions, other.directions])
    if (
        distance < 0.9 * sum(radii)
        or radii[1] > _MAX_RADIUS_RATIO * radii[0]
        or np.isfinite(directions).all((0, 2)).mean() < _MIN_LIT_SHARE
    ):
        return False
    lamps = join_balls(directions, [first.ball, other.ball], (shape[0], shape[1]))
    return lamps.noise_degrees < _SAME_LIGHT_DEGREES
