"""The voxels of a spatial cache: a grid whose planes lie closer where there are many points of surfaces."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from metapp.extensions.guided.histogram import GRID
from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi

CROWDED = 0.8  # of the voxels along an axis, the share that goes by how many points there are
_COUNTED = 64  # parts of an axis, within which voxels are alike
_STEPS = 1024  # of an axis, each of one voxel: a look-up where paths are, not a search


class Voxels:
    """GRID voxels along each axis of a box.

    Args:
        low, high: corners of the box, [3] each; what is outside belongs to the outermost voxels.
        points: of surfaces, [3, N]; all voxels are alike without any.
    """

    def __init__(self, low: ArrayLike, high: ArrayLike, points: ArrayLike) -> None:
        low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
        extent = np.maximum(high - low, 1e-6 * max(float((high - low).max()), 1e-6))
        self.low, self.scale = mi.ScalarPoint3f(low), mi.ScalarVector3f(_STEPS / extent)
        inside = (np.asarray(points) - low[:, None]) / extent[:, None]
        self.voxels = [mi.UInt32(_voxels(along)) for along in inside]

    def index(self, point: mt.Point3) -> mt.Vector3:
        """The indices of the voxels that points are in, whole numbers."""
        step = mi.Vector3u(dr.clip((point - self.low) * self.scale, 0, _STEPS - 1))
        return mi.Vector3u(*(dr.gather(mi.UInt32, table, step[axis]) for axis, table in enumerate(self.voxels)))


def _voxels(along: ArrayLike) -> NDArray[np.uint32]:
    """The voxel of each step of an axis, [_STEPS], of points at such shares of it, [N]."""
    ends = np.linspace(0, 1, _COUNTED + 1)
    counts = np.concatenate([[0], np.histogram(along, ends)[0].cumsum()])
    crowded = counts / counts[-1] if counts[-1] else ends
    below = GRID * ((1 - CROWDED) * ends + CROWDED * crowded)
    voxels: NDArray[np.uint32] = np.interp((np.arange(_STEPS) + 0.5) / _STEPS, ends, below).astype(np.uint32)
    return voxels
