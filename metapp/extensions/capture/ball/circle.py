"""Finding a ball in a photograph: the circle, or with a lens the ellipse, that most edges run along.

Rings of all radii are correlated with the edges; the best ones are moved to where most of the contour lies on edges.
Borders may cut the ball, and edges inside and around it only add noise.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import gaussian_filter, maximum_filter, uniform_filter
from scipy.optimize import minimize
from scipy.signal import fftconvolve

from data_tools.readers.colours import Floats
from metapp.extensions.capture.ball.ball_geometry import PARALLEL_LENS, Ball, PinholeLens
from metapp.extensions.capture.ball.ball_picture import sample_pixels

MIN_BALL_SCORE = 0.34  # of a ball

_SEARCHED_PX = 160  # longer side of the picture that is searched
_REFINED_PX = 150  # radius that the contour is refined at, or less
_RADII = (0.12, 0.75)  # least of the shorter side, greatest of the longer one
_STEP = 0.03  # between radii, relative
_MARGIN = 0.15  # of the longer side, that centres may be outside the picture
_VISIBLE = 0.5  # least share of the contour inside the picture
_CANDIDATES, _MOVED = 60, 5  # circles that are compared, and that are moved
_CHANCE = 0.15  # support of any circle
_EDGE = 0.35  # least strength of an edge that counts
_ANGLES = np.arange(120) * (2 * np.pi / 120)
_RINGS = np.array((1.0, 0.88, 0.92, 0.96, 1.04, 1.07, 1.1))  # the contour, and what is around it, of the radius
_UNITS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)])[:, None] * _RINGS[:, None]
_WEIGHTS = np.array([1.0, *[1 / 3] * 3, *[-1 / 3] * 3])
_BIN = 2  # px of the searched picture
_DARK = 0.05  # display value that logarithms are added to
_NOISE = 0.02  # a gradient, of logarithms a px, that counts as half an edge, or more where others are strong
_AROUND = 0.25  # of the picture's longer side: side of the square that they are in


def find_ball(gray: Floats, lens: PinholeLens = PARALLEL_LENS) -> Ball | None:
    """The ball that fits best, however badly: its score says; None in a picture without edges.

    Args:
        gray: display values [H, W] in [0, 1].
        lens: of the camera.
    """
    share = min(1.0, _SEARCHED_PX / max(gray.shape))
    slopes = _slopes(gray, share)
    own = Ball(0, 0, 1, lens).scaled(share).lens
    scored = [_scored(slopes, Ball(*circle, own)) for circle in _candidates(slopes)]
    moved = [_moved(slopes, ball) for ball in sorted(scored, key=_evidence, reverse=True)[:_MOVED]]
    if not moved:
        return None
    best = max(moved, key=_evidence)
    finer = min(1.0, _REFINED_PX * share / best.radius)
    refined = _moved(_slopes(gray, finer), best.scaled(finer / share), 1, 1 / _REFINED_PX)
    return refined.scaled(1 / finer)._replace(score=_evidence(best))


def score_ball(gray: Floats, ball: Ball) -> float:
    """The score that `find_ball` gives a ball, here one that is known; display values [H, W] in [0, 1]."""
    share = min(1.0, _SEARCHED_PX / max(gray.shape))
    return _evidence(_scored(_slopes(gray, share), ball.scaled(share)))


def _evidence(ball: Ball) -> float:
    """Support beyond chance, which is greater for short contours than for long ones; of a large ball up to 1."""
    return (ball.score - _CHANCE) * math.sqrt(2 * ball.radius / _SEARCHED_PX)


def _slopes(gray: Floats, share: float) -> Floats:
    """Edges of a picture [H, W] at a share of its size up to 1, [3, h, w].

    Gradients along x and y of smoothed logarithms, and the length that counts as half an edge.
    """
    logs = np.log(gray + _DARK)
    if share < 1:
        y, x = ((np.arange(max(8, round(side * share))) + 0.5) / share for side in gray.shape)
        logs = gaussian_filter(logs, 0.4 / share, mode="nearest")
        (logs,) = sample_pixels(logs[None], np.stack(np.meshgrid(x, y)))
    y, x = np.gradient(gaussian_filter(logs, 1.0, mode="nearest"))
    around = uniform_filter(np.hypot(x, y), round(_AROUND * max(logs.shape)), mode="nearest")
    return np.stack([x, y, np.maximum(around, _NOISE)])


def _scored(slopes: Floats, ball: Ball, rings: int = len(_RINGS)) -> Ball:
    """A ball whose score is how edges agree with it, up to about 1: -1 where half of the contour is not in the picture.

    The share of the contour that lies on edges along it; more where edges just inside run along it, too, as a mirror
    presses its surroundings into its rim, and less where edges just outside do, as if it was inside a larger one.
    """
    px = ball.to_px(_UNITS[:, :rings])
    _, height, width = slopes.shape
    inside = np.all((px > 1) & (px < np.array([width - 1, height - 1])[:, None, None]), axis=0)
    if inside[0].mean() < _VISIBLE:
        return ball._replace(score=-1.0)
    tangent = np.roll(px, -1, 2) - np.roll(px, 1, 2)
    tangent /= np.linalg.norm(tangent, axis=0)
    x, y, half = sample_pixels(slopes, px)
    through = np.abs(x * tangent[1] - y * tangent[0])
    length = np.hypot(x, y)
    straight = (2 * (through / np.maximum(length, 1e-12)) ** 2 - 1) * through / (through + half) * inside
    found = straight.sum(1) / np.maximum(inside.sum(1), 0.2 * inside.shape[1])
    return ball._replace(score=float(found @ _WEIGHTS[:rings]))


def _moved(slopes: Floats, ball: Ball, rings: int = len(_RINGS), step: float = 0.02) -> Ball:
    """The ball with most support by so many rings, near where it is: within about a few steps of its radius."""

    def changed(change: Floats) -> Ball:
        x, y, radius = (ball.radius * change + ball[:3]).tolist()
        return ball._replace(x=x, y=y, radius=radius)

    simplex = np.concatenate([np.zeros((1, 3)), np.diag([step] * 3)]) - step / 4
    options = {"initial_simplex": simplex, "xatol": 1e-4, "fatol": 1e-4, "maxfev": 120}
    moves = minimize(
        lambda change: -_scored(slopes, changed(change), rings).score,
        np.zeros(3),
        method="Nelder-Mead",
        options=options,
    )
    return _scored(slopes, changed(moves.x))


def _candidates(slopes: Floats) -> list[tuple[float, float, float]]:
    """Centres and radii of circles that edges agree with most, at most _CANDIDATES.

    Edges are complex numbers of twice their gradients' angle, and so are rings: an edge along a ring counts 1, one
    across it -1.
    """
    x, y, half = slopes[:, : slopes.shape[1] // _BIN * _BIN, : slopes.shape[2] // _BIN * _BIN]
    length = np.hypot(x, y)
    strength = length / (length + half)
    edges = np.where(strength > _EDGE, strength, 0) * ((x + 1j * y) / np.maximum(length, 1e-12)) ** 2
    height, width = (side // _BIN for side in edges.shape)
    edges = edges.reshape(height, _BIN, width, _BIN).mean((1, 3))
    least, most = _RADII[0] * min(height, width), _RADII[1] * max(height, width)
    radii = np.geomspace(least, most, 1 + int(np.log(most / least) / np.log1p(_STEP)))
    margin, reach = round(_MARGIN * max(height, width)), math.ceil(most) + 2
    along = np.arange(-reach, reach + 1)
    away = np.hypot(along, along[:, None])
    angles = ((along - 1j * along[:, None]) / np.maximum(away, 1)) ** 2
    edges, picture = np.pad(edges, margin), np.pad(np.ones((height, width)), margin)
    votes = []
    for radius in radii:
        ring = np.exp(-(((away - radius) / (1 / _BIN + _STEP * radius / 2)) ** 2) / 2)
        found, inside = fftconvolve(edges, ring * angles, "same").real, fftconvolve(picture, ring, "same")
        votes.append(np.where(inside > _VISIBLE * ring.sum(), found / np.sqrt(np.maximum(inside, 1)), 0))
    peaks = np.nonzero((votes == maximum_filter(votes, (3, 3, 3))) & (np.stack(votes) > 1e-6))
    best = np.argsort(-np.stack(votes)[peaks])[:_CANDIDATES]
    rows, columns = (_BIN * (peaks[axis][best] - margin + 0.5) for axis in (1, 2))
    return list(zip(columns.tolist(), rows.tolist(), (_BIN * radii[peaks[0][best]]).tolist(), strict=True))
