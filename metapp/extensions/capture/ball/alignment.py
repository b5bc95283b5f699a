"""Aligning photographs of one ball that were taken by hand, so that it moves from one to the next, by OpenCV."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from metapp.extensions.capture.ball.shots import Shot, disc
from metapp.extensions.capture.ball.view import Floats, mirrored
from metapp.extensions.capture.opencv import opencv

_SIZE = 256  # px of the discs that are compared
_DARK, _BRIGHT = 0.003, 0.85  # linear values: added to all before their logarithm, from which on none is compared
_ENDS = (3, 100, 1e-5)  # OpenCV's criteria: at most so many steps, or until the correlation grows by less


def aligned(shots: Sequence[Shot], order: Sequence[int], first: int) -> list[Shot]:
    """The photographs with balls of place and size that make them show the same in the same directions.

    Args:
        shots: the first one's ball is right, others' nearly so.
        order: of the exposures, so that neighbours can be compared.
        first: which one's ball stays.

    Raises:
        ValueError: OpenCV is not installed.
    """
    result = list(shots)
    towards = mirrored(disc(_SIZE), shots[first].ball.angle)
    start = list(order).index(first)
    for way in (order[start:], order[start::-1]):
        for known, other in itertools.pairwise(way):
            result[other] = _registered(result[known], result[other], towards)
    return result


def _registered(known: Shot, shot: Shot, towards: Floats) -> Shot:
    """A photograph whose ball agrees with a known one's.

    By phase correlation, then by the enhanced correlation coefficient (Evangelidis & Psarakis 2008), to which exposures
    make no difference.
    """
    cv2 = opencv()
    target, bright = _logs(known, towards)
    away = np.hypot(*disc(_SIZE))
    window = np.clip((1 - away) / 0.15, 0, 1)
    logs, _ = _logs(shot, towards)
    shift, _ = cv2.phaseCorrelate(*(window * (values - values.mean()) for values in (target, logs)))
    shot = _moved(shot, np.array(shift), 1.0)
    logs, also_bright = _logs(shot, towards)
    mask = ((away < 0.96) & ~bright & ~also_bright).astype(np.uint8)
    unmoved = np.eye(2, 3, dtype=np.float32)
    pictures = target.astype(np.float32), logs.astype(np.float32)
    try:
        _, moved = cv2.findTransformECC(*pictures, unmoved, cv2.MOTION_AFFINE, _ENDS, mask, 5)
    except cv2.error:  # too little in common
        return shot
    middle = np.full(2, (_SIZE - 1) / 2)
    shift = moved @ [*middle, 1] - middle
    return _moved(shot, shift, float(np.sqrt(abs(np.linalg.det(moved[:, :2])))))


def _logs(shot: Shot, towards: Floats) -> tuple[Floats, np.ndarray]:
    light, _ = shot.at(towards)
    return np.log(light.mean(0) + _DARK), light.max(0) >= _BRIGHT


def _moved(shot: Shot, shift: Floats, size: float) -> Shot:
    """A photograph whose ball is moved by px of the discs that are compared, and enlarged."""
    x, y = shift * shot.ball.radius * 2 / _SIZE
    ball = shot.ball._replace(x=shot.ball.x + float(x), y=shot.ball.y + float(y), radius=size * shot.ball.radius)
    return shot._replace(ball=ball)
