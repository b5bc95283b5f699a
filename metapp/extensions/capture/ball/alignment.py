"""Aligning photographs of one ball that were taken by hand, so that it moves from one to the next."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from metapp.extensions.capture.ball.shots import Shot, disc
from metapp.extensions.capture.ball.view import Floats, mirrored

_DARK, _BRIGHT = 0.003, 0.85  # linear values that two photographs are compared by
_LEVELS = (40, 80, 160)  # px of the discs that are compared, coarse to fine
_SHIFTS, _SIZES = np.linspace(-0.2, 0.2, 11), (0.94, 1.0, 1.06)  # tried first, of the radius
_LOOSE = np.array([0.3, 0.3, 0.1, 0.06, 0.06, 0.06])  # how far a photograph is expected to differ: radii and rad
_LEAST = 30  # px that can be compared, else a photograph is left where it is


def aligned(shots: Sequence[Shot], order: Sequence[int], first: int) -> list[Shot]:
    """The photographs with balls and turns that make them show the same in the same directions.

    Args:
        shots: the first one's ball is right, others' nearly so.
        order: of the exposures, so that neighbours can be compared.
        first: which one's camera directions refer to.
    """
    result = list(shots)
    start = list(order).index(first)
    for way in (order[start:], order[start::-1]):
        for known, other in itertools.pairwise(way):
            result[other] = _registered(result[known], result[other], shots[first].ball.angle)
    return result


def _registered(known: Shot, shot: Shot, angle: float) -> Shot:
    """A photograph with ball and turn that make it agree best with a known one, but for its exposure."""
    shot = shot._replace(turn=known.turn)
    change: Floats = np.zeros(6)
    for level in _LEVELS:
        places = disc(level)
        towards = mirrored(places, angle)[:, np.hypot(*places) < 0.96]
        light, seen = known.at(towards)
        values = light.mean(0)
        usable = seen & (values > _DARK) & (light.max(0) < _BRIGHT)
        if usable.sum() < _LEAST:
            continue
        towards, target = towards[:, usable], np.log(values[usable])
        if level == _LEVELS[0]:
            change = _nearest(shot, towards, target)
        residuals = _Residuals(shot, towards, target)
        done = least_squares(residuals, change, loss="soft_l1", f_scale=0.15, diff_step=1e-4, x_scale=_LOOSE / 10,
                             max_nfev=8)  # fmt: skip
        change = done.x
    return changed(shot, change)


class _Residuals(NamedTuple):
    """Residuals of logarithms after the best gain and power, and of what is expected."""

    shot: Shot
    towards: Floats
    target: Floats

    def __call__(self, change: Floats) -> Floats:
        light, seen = changed(self.shot, change).at(self.towards)
        values = light.mean(0)
        usable = seen & (values > _DARK) & (light.max(0) < _BRIGHT)
        result = np.zeros(len(self.target))
        if usable.sum() < _LEAST:
            return np.concatenate([result + 1, change / _LOOSE])
        logs, target = np.log(values[usable]), self.target[usable]
        spread = max(float(target.std()), 1e-3)
        power = np.clip(np.cov(logs, target)[0, 1] / spread**2, 0.5, 2)
        gain = np.median(logs - power * target)
        result[usable] = logs - power * target - gain
        result[~usable] = 0.3  # else nothing in common would be best
        return np.concatenate([result, change / _LOOSE])


def _nearest(shot: Shot, towards: Floats, target: Floats) -> Floats:
    """Of many shifts and sizes the best."""
    residuals = _Residuals(shot, towards, target)
    tried = [np.array([x, y, size - 1, 0, 0, 0]) for x in _SHIFTS for y in _SHIFTS for size in _SIZES]
    return min(tried, key=lambda change: float(np.minimum(np.abs(residuals(change)[:-6]), 0.5).sum()))


def changed(shot: Shot, change: Floats) -> Shot:
    """A photograph whose ball is moved and enlarged by shares of its radius, and turned by rad."""
    x, y, larger = (shot.ball.radius * float(value) for value in change[:3])
    ball = shot.ball._replace(x=shot.ball.x + x, y=shot.ball.y + y, radius=shot.ball.radius + larger)
    turn = Rotation.from_rotvec(change[3:]) * Rotation.from_rotvec(shot.turn)
    return shot._replace(ball=ball, turn=tuple(turn.as_rotvec().tolist()))
