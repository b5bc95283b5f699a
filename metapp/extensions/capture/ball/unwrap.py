"""Unwrapping of what a ball mirrors to a lat-long map, and how far its texels are seen."""

from __future__ import annotations

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from metapp.appearance.latlong import directions
from metapp.extensions.capture.ball.view import Floats, sampled, seen_at

SHARP = math.pi / 64  # rad a pixel: a texel of a map of 64 rows; what is seen so is seen
BLURRED = 4 * SHARP  # what is seen so, is not

_FINEST = 16  # samples along a texel


def unwrapped(
    radiance: Floats, clipped: NDArray[np.bool_], seen: NDArray[np.bool_], rows: int, angle: float, radius: float
) -> tuple[Tensor, Tensor]:
    """A map of a picture of a mirror ball.

    Texels are means over samples that lie as close as pixels do; where pixels are larger, they are interpolated.

    Args:
        radiance: [3, S, S] of the ball, which fills the picture.
        clipped: [S, S], where it is a lower bound.
        seen: [S, S], where it is known.
        rows: of the map.
        angle: half the angle that the ball fills for its camera, rad.
        radius: of the ball in the photograph, px.

    Returns:
        `seen`, radiance [3, rows, 2 * rows], 0 where nothing is seen; `certain` [2, rows, 2 * rows] in [0, 1]: how far
        a texel is seen unclipped, and how far it is seen but clipped. Both fall to 0 towards the contour, where a
        pixel shows BLURRED, and are 0 behind it.
    """
    size = radiance.shape[1]
    many = min(_FINEST, max(1, math.ceil(size / 4 * math.pi / rows)))
    total, known = np.zeros((3, rows, 2 * rows)), np.zeros((3, rows, 2 * rows))
    planes = np.concatenate([radiance, clipped[None], seen[None]]).astype(np.float64)
    fine = directions(rows * many, 2 * rows * many, dtype=torch.float64).numpy()
    for part in range(0, rows, step := max(1, 2**18 // (2 * rows * many * many))):
        towards = fine[:, part * many : (part + step) * many]
        place, speed = seen_at(towards, angle)
        weight = _sharpness(speed * radius) * (np.hypot(*place) < 1 - 1 / radius)
        px = np.stack([1 + place[0], 1 - place[1]]) * (size / 2)
        values = sampled(planes, px)
        weight = weight * (values[4] > 0.99)
        lost = values[3] > 0.01
        means = [_means(plane, many) for plane in (*(values[:3] * weight), weight * ~lost, weight * lost, weight)]
        total[:, part : part + step] = means[:3]
        known[:, part : part + step] = means[3:]
    light = total / np.maximum(known[2], 1e-6)
    return torch.from_numpy(light).float(), torch.from_numpy(known[:2].clip(0, 1)).float()


def _sharpness(px_a_rad: Floats) -> Floats:
    """1 where a pixel is no larger than SHARP, 0 where it is BLURRED, even in its logarithm."""
    extent = 1 / np.maximum(px_a_rad, 1e-9)
    result: Floats = np.clip(np.log(BLURRED / extent) / math.log(BLURRED / SHARP), 0, 1)
    return result


def _means(values: Floats, many: int) -> Floats:
    rows, columns = (side // many for side in values.shape)
    result: Floats = values.reshape(rows, many, columns, many).mean((1, 3))
    return result
