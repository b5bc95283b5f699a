"""Lamps of two balls: the parallax between the directions that they tell says how far the lamp is.

Places are in widths of the picture from its middle, x right, y up, in the plane of the balls.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from data_tools.readers.colours import Floats
from metapp.extensions.capture.ball.ball_geometry import PARALLEL_LENS, Ball

MAX_UNKNOWN_LEAN_DEGREES = 2.0  # of directions, which no line says
DOUBTED_FOV_DEGREES = 27.0  # along the shorter side, of a lens of 50 mm on 35 mm film
CONTOUR_ERROR_PX = 0.5  # by which the middle of a ball may be off
_ROUNDS = 5  # of the search for the distance, which changes the directions that it is found by


class Lamps(NamedTuple):
    """The lamp's directions, by photograph, and its distance.

    Attributes:
        directions: the directions from the middle of the picture, [N, 3], of unit length; NaN where they are not known.
        distance: the distance from the middle, in widths of the picture; infinite if the lamp is far or one ball is
            all that is known.
        parallax_degrees: the angle by which a lamp above the middle differs between two balls; 0 for one ball.
        noise_degrees: the angle by which the directions of two balls differ else, errors of contours included.
    """

    directions: Floats
    distance: float = np.inf
    parallax_degrees: float = 0.0
    noise_degrees: float = 0.0


def place_of_ball(ball: Ball, shape: tuple[int, int]) -> Floats:
    """Return the place of a ball, [3], in photographs of a shape (rows, columns)."""
    rows, columns = shape
    return np.array([ball.x - columns / 2, rows / 2 - ball.y, 0.0]) / columns


def unknown_lean_degrees(balls: Sequence[Ball], shape: tuple[int, int]) -> float:
    """Return how far directions lean if a camera that is taken to be far away has a lens of DOUBTED_FOV_DEGREES.

    Its ray to a ball leans by an angle, and so do directions; balls on both sides of the middle make up for each other.

    Args:
        balls: the balls; those of a known lens do not lean.
        shape: rows and columns of the photographs.
    """
    if balls[0].lens.focal < PARALLEL_LENS.focal / 2:
        return 0.0
    rows, columns = shape
    middle = np.mean([(ball.x - columns / 2, ball.y - rows / 2) for ball in balls], 0)
    focal = min(shape) / 2 / np.tan(np.radians(DOUBTED_FOV_DEGREES / 2))
    return float(np.degrees(np.arctan(np.linalg.norm(middle) / focal)))


def join_balls(directions: Floats, balls: Sequence[Ball], shape: tuple[int, int]) -> Lamps:
    """Join the directions that balls tell to directions from the middle of the picture.

    The direction from a place p to a lamp at the distance r in the direction u is that of u - p / r. All lamps are
    taken to have one distance, which a dome or a string gives them; it counts if it makes directions differ by more
    than their noise.

    Args:
        directions: the directions that each ball tells, [balls, N, 3]; NaN where they are not known.
        balls: the balls.
        shape: rows and columns of the photographs.
    """
    if len(balls) == 1:
        return Lamps(directions[0])
    places = np.stack([place_of_ball(ball, shape) for ball in balls])[:, None]
    known = directions[:, np.isfinite(directions).all((0, 2))]
    nearness = 0.0
    for _ in range(_ROUNDS):
        middle = _normalise((_towards_middle(known, places, nearness)).mean(0))
        baselines = places[1] - places[0]
        baselines = baselines - (baselines * middle).sum(1, keepdims=True) * middle
        differences = known[1] - known[0]
        nearness = max(0.0, float(-(differences * baselines).sum() / max((baselines**2).sum(), 1e-12)))
    residuals = differences + nearness * baselines
    rms_rad = float(np.sqrt((residuals**2).sum() / max(1, len(residuals) - 1)))
    # a normal leans by the contour's error over the radius, a mirrored direction by twice that
    contour_rad = math.hypot(*(2 * CONTOUR_ERROR_PX / ball.radius for ball in balls))
    parallax_rad = nearness * float(np.linalg.norm(places[1] - places[0]))
    noise_rad = math.hypot(rms_rad, contour_rad)
    if parallax_rad < noise_rad:
        nearness = 0.0
    middle_directions = _towards_middle(directions, places, nearness)
    is_known = np.isfinite(middle_directions[..., 0])
    joined = _normalise(np.where(is_known[..., None], middle_directions, 0).sum(0))
    joined[~is_known.any(0)] = np.nan
    distance = 1 / nearness if nearness else np.inf
    return Lamps(joined, distance, math.degrees(parallax_rad), math.degrees(noise_rad))


def _towards_middle(directions: Floats, places: Floats, nearness: float) -> Floats:
    """Return directions from the middle of the picture, from those at places and one over the distance of lamps.

    The lamp is at p + t d, as far from the middle as 1 / nearness.
    """
    shifts = nearness * places
    along = (directions * shifts).sum(-1, keepdims=True)
    reach = np.sqrt(np.maximum(along**2 - (shifts**2).sum(-1, keepdims=True) + 1, 0)) - along
    return _normalise(reach * directions + shifts)


def _normalise(vectors: Floats) -> Floats:
    """Return vectors [..., 3] of unit length."""
    lengths: Floats = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.maximum(lengths, 1e-12)
