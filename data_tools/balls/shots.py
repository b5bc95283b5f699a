"""Photographs of one ball, and how each shows it: bracketed by hand, so that it moves from one to the next."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from data_tools.balls.circle import best_ball, resized
from data_tools.balls.view import Ball, Floats, Lens, mirrored, sampled, seen_at
from data_tools.readers.image_files import Pixels
from data_tools.readers.photos import linear_light
from metapp.appearance.colour import linear_to_srgb

FOUND = 0.34  # least score of a ball
LARGEST_PX = 1024  # the ball's diameter, of what is kept of a photograph

_AROUND = 1.2  # of the radius, how much of the photograph is kept
_DARK, _BRIGHT = 0.003, 0.85  # linear values that two photographs are compared by
_LEVELS = (40, 80, 160)  # px of the discs that are compared, coarse to fine
_SHIFTS, _SIZES = np.linspace(-0.2, 0.2, 11), (0.94, 1.0, 1.06)  # tried first, of the radius
_LOOSE = np.array([0.3, 0.3, 0.1, 0.06, 0.06, 0.06])  # how far a photograph is expected to differ: radii and rad
_LEAST = 30  # px that can be compared, else a photograph is left where it is


class Shot(NamedTuple):
    """A photograph of a ball.

    Attributes:
        light: linear RGB [3, h, w] in [0, 1], of the part round the ball.
        ball: in that part.
        place: left and top of that part in the photograph, and how many of its px a side make one of these.
        turn: rotation vector, rad: from directions around the ball to those as its camera sees them.
    """

    light: NDArray[np.float32]
    ball: Ball
    place: tuple[int, int, int] = (0, 0, 1)
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def whole(self) -> Ball:
        """The ball in the whole photograph."""
        left, top, many = self.place
        return self.ball.scaled(many).shifted(-left, -top)

    def at(self, towards: Floats) -> tuple[Floats, NDArray[np.bool_]]:
        """Linear RGB [3, ...] that it shows in directions [3, ...], and whether it shows these at all."""
        turned = np.einsum("ij,j...->i...", Rotation.from_rotvec(self.turn).as_matrix(), towards)
        place, speed = seen_at(turned, self.ball.angle)
        px = self.ball.to_px(place)
        height, width = self.light.shape[1:]
        inside = (speed > 0) & (px > 0).all(0) & (px[0] < width) & (px[1] < height)
        return sampled(self.light, px), inside


def gray_of(pixels: Pixels) -> Floats:
    """Display values [H, W] in [0, 1], the mean of red, green and blue."""
    values = pixels.values[..., :3]
    if values.dtype.kind == "u":
        result: Floats = values.mean(-1) / float(np.iinfo(values.dtype).max)
        return result
    linear = torch.from_numpy(linear_light(pixels, slice(None))[..., :3])
    display: Floats = linear_to_srgb(linear).numpy().mean(-1).astype(np.float64)
    return display


def searched(pixels: Pixels, lens: Lens | None) -> Ball | None:
    """The best ball in a photograph, however bad; None where there is no edge."""
    gray = gray_of(pixels)
    share = min(1.0, LARGEST_PX / max(gray.shape))
    ball = best_ball(resized(gray, share), lens and Lens(*(share * value for value in lens)))
    return ball and ball.scaled(1 / share)


def shot_of(pixels: Pixels, ball: Ball) -> Shot:
    """The part of a photograph round a ball, no finer than LARGEST_PX across it."""
    height, width = pixels.values.shape[:2]
    reach = _AROUND * ball.radius
    left, right = max(0, int(ball.x - reach)), min(width, int(ball.x + reach) + 1)
    top, bottom = max(0, int(ball.y - reach)), min(height, int(ball.y + reach) + 1)
    part = pixels._replace(values=pixels.values[top:bottom, left:right])
    light = linear_light(part, slice(None))[..., :3].transpose(2, 0, 1)
    ball = ball.shifted(left, top)
    many = max(1, int(2 * ball.radius // LARGEST_PX))
    if many > 1:
        rows, columns = (side // many * many for side in light.shape[1:])
        light = light[:, :rows, :columns].reshape(3, rows // many, many, columns // many, many).mean((2, 4))
        ball = ball.scaled(1 / many)
    return Shot(np.ascontiguousarray(light, dtype=np.float32), ball, (left, top, many))


def disc(size: int) -> Floats:
    """Places [2, size, size] of the pixels of a square picture that a ball fills."""
    along = (np.arange(size) + 0.5) * (2 / size) - 1
    return np.stack(np.meshgrid(along, -along))


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
    """What differs of logarithms after the best gain and power, and of what is expected."""

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
