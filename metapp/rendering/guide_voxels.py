"""The voxels of a spatial cache: a grid whose planes lie closer where there are many points of surfaces."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metapp.rendering import types as mt
from metapp.rendering.guide_histogram import GRID
from metapp.rendering.jit import dr, mi

CROWDED = 0.8  # of the voxels along an axis, the share that goes by how many points there are
_STEPS = 64  # of an axis, within which voxels are alike


class Voxels:
    """GRID voxels along each axis of a box.

    Args:
        low, high: corners of the box, [3] each; what is outside belongs to the outermost voxels.
        points: of surfaces, [3, N]; all voxels are alike without any.
    """

    def __init__(self, low: ArrayLike, high: ArrayLike, points: ArrayLike | None = None) -> None:
        low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
        extent = np.maximum(high - low, 1e-6 * max(float((high - low).max()), 1e-6))
        self.low, self.scale = mi.ScalarPoint3f(low), mi.ScalarVector3f(_STEPS / extent)
        inside = np.zeros((3, 0)) if points is None else (np.asarray(points) - low[:, None]) / extent[:, None]
        self.below = [mi.Float(_below(along)) for along in inside]

    def index(self, point: mt.Point3) -> mt.Vector3:
        """The indices of the voxels that points are in, whole numbers."""
        along = dr.clip((point - self.low) * self.scale, 0, _STEPS * (1 - 1e-6))
        step = mi.Vector3u(along)
        indices = [
            dr.lerp(*(dr.gather(mi.Float, table, step[axis] + end) for end in range(2)), along[axis] - step[axis])
            for axis, table in enumerate(self.below)
        ]
        return mi.Vector3u(dr.clip(mi.Vector3i(*map(mi.Int, indices)), 0, GRID - 1))


def _below(along: ArrayLike) -> NDArray[np.float32]:
    """How many voxels lie below each step of an axis, [_STEPS + 1], of points at such shares of it, [N]."""
    steps = np.linspace(0, 1, _STEPS + 1)
    counts = np.concatenate([[0], np.histogram(along, steps)[0].cumsum()])
    crowded = counts / counts[-1] if counts[-1] else steps
    below: NDArray[np.float32] = (GRID * ((1 - CROWDED) * steps + CROWDED * crowded)).astype(np.float32)
    return below
