"""A ball found in a photograph: the circle, or with a lens the ellipse, that most edges run along.

Rings of all radii are correlated with the edges; the best ones are moved to where most of the contour lies on edges.
Borders may cut the ball, and edges inside and around it only add noise. Nothing here knows what the ball shows.
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

MIN_BALL_SCORE = 0.34  # a circle of a lower score is no ball

_SEARCH_PX = 160  # longer side of the picture that is searched
_REFINEMENT_RADIUS_PX = 150  # radius at which the contour is refined, at most
_RADIUS_SHARES = (0.12, 0.75)  # the least radius over the shorter side, the greatest over the longer side
_RADIUS_STEP = 0.03  # relative step from one radius to the next
_MARGIN_SHARE = 0.15  # of the longer side: how far outside the picture centres may be
_MIN_VISIBLE_SHARE = 0.5  # of the contour, inside the picture
_MAX_CANDIDATES, _MAX_REFINED = 60, 5  # circles that are scored, and the best of them that are moved
_CHANCE_SUPPORT = 0.15  # the support that a circle has by chance
_MIN_EDGE_STRENGTH = 0.35  # weaker edges do not count
_RING_ANGLES = np.arange(120) * (2 * np.pi / 120)
_RING_RADII = np.array((1.0, 0.88, 0.92, 0.96, 1.04, 1.07, 1.1))  # the contour, and rings inside and outside it
_RING_PLACES = np.stack([np.cos(_RING_ANGLES), np.sin(_RING_ANGLES)])[:, None] * _RING_RADII[:, None]
_RING_WEIGHTS = np.array([1.0, *[1 / 3] * 3, *[-1 / 3] * 3])
_BIN_PX = 2  # of the searched picture, in which votes for circles are counted
_LOG_OFFSET = 0.05  # display value that is added before logarithms
_NOISE_GRADIENT = 0.02  # of logarithms, per px: it counts as half an edge, or more where the edges around are strong
_NEIGHBOURHOOD_SHARE = 0.25  # of the picture's longer side: side of the square of edges around


def find_ball(grey: Floats, lens: PinholeLens = PARALLEL_LENS) -> Ball | None:
    """Return the circle that fits the edges of a picture best, however badly: its score says how well.

    Args:
        grey: display values, [H, W] in [0, 1].
        lens: the lens of the camera.

    Returns:
        The ball; None for a picture without edges.
    """
    share, logs = min(1.0, _SEARCH_PX / max(grey.shape)), log_display(grey)
    edges = find_edges(find_gradients(logs, share))
    resized_lens = lens.resize(share)
    candidates = [score_contour(edges, Ball(*circle, resized_lens)) for circle in find_circles(edges)]
    moved_balls = [move_ball(edges, ball) for ball in sorted(candidates, key=_evidence, reverse=True)[:_MAX_REFINED]]
    if not moved_balls:
        return None
    best = max(moved_balls, key=_evidence)
    refined_share = min(1.0, _REFINEMENT_RADIUS_PX * share / best.radius)
    refined = move_ball(
        find_edges(find_gradients(logs, refined_share)),
        best.resize(refined_share / share),
        1,
        1 / _REFINEMENT_RADIUS_PX,
    )
    return refined.resize(1 / refined_share)._replace(score=_evidence(best))


def score_ball(grey: Floats, ball: Ball) -> float:
    """Return the score that :func:`find_ball` would give a known ball.

    Args:
        grey: display values, [H, W] in [0, 1].
        ball: the ball in the picture.
    """
    share = min(1.0, _SEARCH_PX / max(grey.shape))
    return _evidence(score_contour(find_edges(find_gradients(log_display(grey), share)), ball.resize(share)))


def _evidence(ball: Ball) -> float:
    """Return how far the support of a ball is beyond chance, up to 1 for large balls.

    Chance supports short contours more than long ones, so that the excess counts by the root of the radius.
    """
    return (ball.score - _CHANCE_SUPPORT) * math.sqrt(2 * ball.radius / _SEARCH_PX)


def log_display(grey: Floats) -> Floats:
    """Return the logarithms of display values in [0, 1], by which edges in light and in shade compare."""
    logs: Floats = np.log(grey + _LOG_OFFSET)
    return logs


def find_gradients(values: Floats, share: float) -> Floats:
    """Return the gradients of a picture, resized by a share up to 1 and smoothed.

    Args:
        values: values such as :func:`log_display` returns, [H, W].
        share: the size of the result over the picture's.

    Returns:
        [2, h, w]: the gradients along x and y.
    """
    if share < 1:
        y, x = ((np.arange(max(8, round(side * share))) + 0.5) / share for side in values.shape)
        values = gaussian_filter(values, 0.4 / share, mode="nearest")
        (values,) = sample_pixels(values[None], np.stack(np.meshgrid(x, y)))
    return np.stack(np.gradient(gaussian_filter(values, 1.0, mode="nearest"))[::-1])


def find_edges(gradients: Floats) -> Floats:
    """Return gradients [2, h, w] along x and y with a third plane: the length that counts as half an edge there."""
    x, y = gradients
    mean_gradient = uniform_filter(np.hypot(x, y), round(_NEIGHBOURHOOD_SHARE * max(x.shape)), mode="nearest")
    return np.stack([x, y, np.maximum(mean_gradient, _NOISE_GRADIENT)])


def score_contour(edges: Floats, ball: Ball, rings: int = len(_RING_RADII)) -> Ball:
    """Return a ball with its score: how well edges agree with it, up to about 1.

    The score is the share of the contour that lies on edges along it. It is higher where edges just inside run along
    the contour, too, as a mirror presses its surroundings into its rim, and lower where edges just outside do, as
    inside a larger ball. It is -1 where half of the contour is not in the picture.

    Args:
        edges: the edges that :func:`find_edges` returns, [3, h, w].
        ball: the ball, in px of the edges.
        rings: how many of the rings are compared.
    """
    px = ball.to_px(_RING_PLACES[:, :rings])
    _, height, width = edges.shape
    inside = np.all((px > 1) & (px < np.array([width - 1, height - 1])[:, None, None]), axis=0)
    if inside[0].mean() < _MIN_VISIBLE_SHARE:
        return ball._replace(score=-1.0)
    tangent = np.roll(px, -1, 2) - np.roll(px, 1, 2)
    tangent /= np.linalg.norm(tangent, axis=0)
    x, y, half_length = sample_pixels(edges, px)
    normal_gradient = np.abs(x * tangent[1] - y * tangent[0])
    length = np.hypot(x, y)
    agreement = (
        (2 * (normal_gradient / np.maximum(length, 1e-12)) ** 2 - 1)
        * normal_gradient
        / (normal_gradient + half_length)
        * inside
    )
    support = agreement.sum(1) / np.maximum(inside.sum(1), 0.2 * inside.shape[1])
    return ball._replace(score=float(support @ _RING_WEIGHTS[:rings]))


def move_ball(edges: Floats, ball: Ball, rings: int = len(_RING_RADII), step: float = 0.02) -> Ball:
    """Move a ball by a few steps of its radius to where most of its contour lies on edges.

    Args:
        edges: the edges that :func:`find_edges` returns, [3, h, w].
        ball: the ball, in px of the edges.
        rings: how many of the rings are compared.
        step: the first step of the search, in radii.
    """

    def change_ball(change: Floats) -> Ball:
        x, y, radius = (ball.radius * change + ball[:3]).tolist()
        return ball._replace(x=x, y=y, radius=radius)

    simplex = np.concatenate([np.zeros((1, 3)), np.diag([step] * 3)]) - step / 4
    options = {"initial_simplex": simplex, "xatol": 1e-4, "fatol": 1e-4, "maxfev": 120}
    optimum = minimize(
        lambda change: -score_contour(edges, change_ball(change), rings).score,
        np.zeros(3),
        method="Nelder-Mead",
        options=options,
    )
    return score_contour(edges, change_ball(optimum.x))


def find_circles(
    edges: Floats, radius_shares: tuple[float, float] = _RADIUS_SHARES
) -> list[tuple[float, float, float]]:
    """Return the centres and radii of at most _MAX_CANDIDATES circles that edges agree with most.

    Edges are complex numbers of twice the angle of their gradients, and so are rings: an edge along a ring counts 1,
    one across it -1.

    Args:
        edges: the edges that :func:`find_edges` returns, [3, h, w].
        radius_shares: the least radius over the picture's shorter side, the greatest over the longer side.
    """
    x, y, half_length = edges[:, : edges.shape[1] // _BIN_PX * _BIN_PX, : edges.shape[2] // _BIN_PX * _BIN_PX]
    length = np.hypot(x, y)
    strength = length / (length + half_length)
    directed_edges = (
        np.where(strength > _MIN_EDGE_STRENGTH, strength, 0) * ((x + 1j * y) / np.maximum(length, 1e-12)) ** 2
    )
    height, width = (side // _BIN_PX for side in directed_edges.shape)
    directed_edges = directed_edges.reshape(height, _BIN_PX, width, _BIN_PX).mean((1, 3))
    min_radius, max_radius = radius_shares[0] * min(height, width), radius_shares[1] * max(height, width)
    radii = np.geomspace(min_radius, max_radius, 1 + int(np.log(max_radius / min_radius) / np.log1p(_RADIUS_STEP)))
    margin, ring_reach = round(_MARGIN_SHARE * max(height, width)), math.ceil(max_radius) + 2
    offsets = np.arange(-ring_reach, ring_reach + 1)
    distance = np.hypot(offsets, offsets[:, None])
    angles = ((offsets - 1j * offsets[:, None]) / np.maximum(distance, 1)) ** 2
    directed_edges, is_picture = np.pad(directed_edges, margin), np.pad(np.ones((height, width)), margin)
    votes = []
    for radius in radii:
        ring = np.exp(-(((distance - radius) / (1 / _BIN_PX + _RADIUS_STEP * radius / 2)) ** 2) / 2)
        vote, inside = fftconvolve(directed_edges, ring * angles, "same").real, fftconvolve(is_picture, ring, "same")
        votes.append(np.where(inside > _MIN_VISIBLE_SHARE * ring.sum(), vote / np.sqrt(np.maximum(inside, 1)), 0))
    peaks = np.nonzero((votes == maximum_filter(votes, (3, 3, 3))) & (np.stack(votes) > 1e-6))
    best = np.argsort(-np.stack(votes)[peaks])[:_MAX_CANDIDATES]
    rows, columns = (_BIN_PX * (peaks[axis][best] - margin + 0.5) for axis in (1, 2))
    return list(zip(columns.tolist(), rows.tolist(), (_BIN_PX * radii[peaks[0][best]]).tolist(), strict=True))
