"""Finding a ball in a photograph: the circle, or with a lens the ellipse, that most edges run along.

Edges vote for the centres of circles of all radii that they may lie on (the Hough transform by directions of
gradients, Kimme et al. 1975); the best ones are moved to where most of the contour lies on edges. Borders may cut the
ball, and edges inside and around it only add noise.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates, maximum_filter, uniform_filter
from scipy.optimize import minimize

from metapp.extensions.capture.ball.view import Ball, Floats, Lens, sampled

SEARCHED_PX = 160  # longer side of the picture that is searched
REFINED_PX = 150  # radius that the contour is refined at, or less

_RADII = (0.12, 0.75)  # least of the shorter side, greatest of the longer one
_STEP = 0.03  # between radii, relative
_MARGIN = 0.15  # of the longer side, that centres may be outside the picture
_VISIBLE = 0.5  # least share of the contour inside the picture
_CANDIDATES, _MOVED = 60, 5  # circles that are compared, and that are moved
_CHANCE = 0.15  # support of any circle
_ROUND = 0.3  # of support, that a slant must bring
_EDGE = 0.35  # least strength of an edge that votes
_ANGLES = np.arange(120) * (2 * np.pi / 120)
_UNIT = np.stack([np.cos(_ANGLES), np.sin(_ANGLES)])
_RINGS = (1.0, 0.88, 0.92, 0.96, 1.04, 1.07, 1.1)  # the contour, and what is around it, of the radius
_UNITS = _UNIT[:, None] * np.array(_RINGS)[None, :, None]
_WEIGHTS = np.array([1.0, *[1 / 3] * 3, *[-1 / 3] * 3])
_BIN = 2  # px of the searched picture
_DARK = 0.05  # display value that logarithms are added to
_NOISE = 0.02  # a gradient, of logarithms a px, that counts as half an edge, or more where others are strong
_AROUND = 0.25  # of the picture's longer side: side of the square that they are in


def best_ball(gray: Floats, lens: Lens | None = None) -> Ball | None:
    """The ball that fits best, however badly; None in a picture without edges.

    Args:
        gray: display values [H, W] in [0, 1].
        lens: of the camera; None: the ball is taken for far away.
    """
    gray = np.log(gray + _DARK)
    share = min(1.0, SEARCHED_PX / max(gray.shape))
    slopes = slopes_of(resized(gray, share), 1.0)
    own = lens and Lens(*(share * value for value in lens))
    scored = [_scored(slopes, Ball(x, y, radius, lens=own)) for x, y, radius in _candidates(slopes)]
    scored.sort(key=_evidence, reverse=True)
    moved = [_moved(slopes, ball) for ball in scored[:_MOVED]]
    if not moved:
        return None
    best = max(moved, key=_evidence)
    return _refined(gray, best.scaled(1 / share))._replace(score=_evidence(best))


def score_of(gray: Floats, ball: Ball) -> float:
    """The score that `best_ball` gives a ball, here one that is known; display values [H, W] in [0, 1]."""
    share = min(1.0, SEARCHED_PX / max(gray.shape))
    slopes = slopes_of(resized(np.log(gray + _DARK), share), 1.0)
    return _evidence(_moved(slopes, ball.scaled(share), step=0.005))


def _evidence(ball: Ball) -> float:
    """Support beyond chance, which is greater for short contours than for long ones; of a large ball up to 1."""
    return (ball.score - _CHANCE) * math.sqrt(2 * ball.radius / SEARCHED_PX)


def _refined(gray: Floats, ball: Ball) -> Ball:
    """A ball that is nearly right, to fractions of a px, by its contour alone."""
    share = min(1.0, REFINED_PX / ball.radius)
    slopes = slopes_of(resized(gray, share), 1.0)
    return _moved(slopes, ball.scaled(share), 1, 1 / REFINED_PX).scaled(1 / share)


def resized(gray: Floats, share: float) -> Floats:
    """A picture [H, W] at a share of its size up to 1."""
    if share == 1:
        return gray
    smooth = gaussian_filter(gray, 0.4 / share, mode="nearest")
    y, x = ((np.arange(max(8, round(side * share))) + 0.5) / share - 0.5 for side in gray.shape)
    result: Floats = map_coordinates(smooth, np.meshgrid(y, x, indexing="ij"), order=1, mode="nearest")
    return result


def slopes_of(gray: Floats, sigma: float) -> Floats:
    """Gradients of a picture [H, W] that was smoothed by so many px, [3, H, W].

    Along x and y, and the length that counts as half an edge there.
    """
    y, x = np.gradient(gaussian_filter(gray, sigma, mode="nearest"))
    around = uniform_filter(np.hypot(x, y), round(_AROUND * max(gray.shape)), mode="nearest")
    return np.stack([x, y, np.maximum(around, _NOISE)])


def _scored(slopes: Floats, ball: Ball) -> Ball:
    return ball._replace(score=support(slopes, ball))


def support(slopes: Floats, ball: Ball, rings: int = len(_RINGS)) -> float:
    """Agreement of edges with a ball, up to about 1: -1 where less than half of its contour is in the picture.

    The share of the contour that lies on edges along it; more where edges just inside run along it, too, as a mirror
    presses all that is around into its rim, and less where edges just outside do, as if it was inside a larger one.
    """
    px = ball.to_px(_UNITS[:, :rings])
    _, height, width = slopes.shape
    inside = np.all((px > 1) & (px < np.array([width - 1, height - 1])[:, None, None]), axis=0)
    if inside[0].mean() < _VISIBLE:
        return -1.0
    tangent = np.roll(px, -1, 2) - np.roll(px, 1, 2)
    tangent /= np.linalg.norm(tangent, axis=0)
    x, y, half = sampled(slopes, px)
    through = np.abs(x * tangent[1] - y * tangent[0])
    length = np.hypot(x, y)
    straight = (2 * (through / np.maximum(length, 1e-12)) ** 2 - 1) * through / (through + half) * inside
    found = straight.sum(1) / np.maximum(inside.sum(1), 0.2 * inside.shape[1])
    return float(found @ _WEIGHTS[:rings])


def _moved(slopes: Floats, ball: Ball, rings: int = len(_RINGS), step: float = 0.02) -> Ball:
    """The ball with most support by so many rings, near where it is: within about a few steps of its radius."""

    def worse(change: Floats) -> float:
        moved = _changed(ball, change)
        return _ROUND * math.hypot(*moved.slant) - support(slopes, moved, rings)

    free = 3 if ball.lens else 5
    simplex = np.concatenate([np.zeros((1, free)), np.diag([step] * free)]) - step / 4
    options = {"initial_simplex": simplex, "xatol": 1e-4, "fatol": 1e-4, "maxfev": 40 * free}
    done = minimize(worse, np.zeros(free), method="Nelder-Mead", options=options)
    moved = _changed(ball, done.x)
    return _scored(slopes, moved)


def _changed(ball: Ball, change: Floats) -> Ball:
    x, y, larger = (ball.radius * float(value) for value in change[:3])
    slant = ball.slant
    if len(change) == 5:
        slant = slant[0] + float(change[3]), slant[1] + float(change[4])
    return ball._replace(x=ball.x + x, y=ball.y + y, radius=ball.radius + larger, slant=slant)


def _candidates(slopes: Floats) -> list[tuple[float, float, float]]:
    """Centres and radii of circles with most votes, at most _CANDIDATES."""
    _, height, width = slopes.shape
    length = np.hypot(*slopes[:2])
    strength = length / (length + slopes[2])
    rows, columns = np.nonzero(strength > _EDGE)
    if not len(rows):
        return []
    weights = strength[rows, columns]
    x, y = slopes[:2, rows, columns] / length[rows, columns]
    margin = _BIN * round(_MARGIN * max(height, width) / _BIN)
    size = (height + 2 * margin) // _BIN + 1, (width + 2 * margin) // _BIN + 1
    least, most = _RADII[0] * min(height, width), _RADII[1] * max(height, width)
    radii = np.geomspace(least, most, 1 + int(np.log(most / least) / np.log1p(_STEP)))
    votes = np.zeros((len(radii), *size), np.float32)
    for number, radius in enumerate(radii):
        for side in (-radius, radius):
            row = np.floor((rows + 0.5 + side * y + margin) / _BIN).astype(int)
            column = np.floor((columns + 0.5 + side * x + margin) / _BIN).astype(int)
            kept = (row >= 0) & (row < size[0]) & (column >= 0) & (column < size[1])
            at = row[kept] * size[1] + column[kept]
            votes[number] += np.bincount(at, weights[kept], size[0] * size[1]).reshape(size)
        smooth = gaussian_filter(votes[number], (1 + _STEP * radius / 2) / _BIN, truncate=2.5)
        votes[number] = smooth / np.sqrt(_visible(radius, (height, width), margin, size))
    peaks = np.nonzero((votes == maximum_filter(votes, (3, 3, 3))) & (votes > 0))
    best = np.argsort(-votes[peaks])[:_CANDIDATES]
    centres = (np.stack(peaks)[:, best] + 0.5) * _BIN - margin
    return list(zip(centres[2].tolist(), centres[1].tolist(), radii[peaks[0][best]].tolist(), strict=True))


def _visible(radius: float, picture: tuple[int, int], margin: int, size: tuple[int, int]) -> Floats:
    """px of circles' contours inside the picture by their centres' bins; infinite for less than half of them."""
    unit = _UNIT[:, ::4] * radius
    row, column = (
        (np.arange(count)[:, None] + 0.5) * _BIN - margin + unit[1 - axis] for axis, count in enumerate(size)
    )
    rows, columns = ((place > 0) & (place < side) for place, side in zip((row, column), picture, strict=True))
    share = rows.astype(np.float64) @ columns.T.astype(np.float64) / unit.shape[1]
    return 2 * np.pi * radius * np.where(share > _VISIBLE, share, np.inf)
