"""A spatial cache of directional histograms, learned from the paths of one scene, in the active variant of Mitsuba.

An entry is a voxel and the axis nearest to a surface's normal. Its histogram has bins of the hemisphere above the
surface, all of the same projected solid angle. An entry that many paths visited has a histogram of its own; the others
share that of a voxel of twice the side.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from metapp.extensions.guided.histogram import (
    BYTE_BITS,
    CACHE_ENTRIES,
    GRID_SIDE_VOXELS,
    HISTOGRAM_BINS,
    HISTOGRAM_SIDE_BINS,
    NORMAL_AXES,
    PROBABILITY_SLOTS,
    SECOND_MOMENT_POWER,
    MomentPrior,
    alias_words,
    coarsen_sums,
    quantise_weights,
    second_moments,
    shrink_moments,
    voxels_of_entries,
)
from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi

MIN_ENTRY_PATHS = 2048.0  # from which an entry has a histogram of its own
MAX_RECORDED_BOUNCES = 8  # bounces of a path that the cache learns from
MIN_ROW_BOUNCES = 8  # bounces from which a row's expectations are known
_SUMS = 3
POINT_DENSITY_SHARE = 0.8  # of the voxels along an axis, the share that goes by how many points there are
_COUNTED = 64  # parts of an axis, within which voxels are alike
_STEPS = 1024  # of an axis, each of one voxel: a look-up where paths are, not a search


class VoxelGrid:
    """GRID voxels along each axis of a box.

    Args:
        low, high: corners of the box, [3] each; points outside belong to the outermost voxels.
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
    below = GRID_SIDE_VOXELS * ((1 - POINT_DENSITY_SHARE) * ends + POINT_DENSITY_SHARE * crowded)
    voxels: NDArray[np.uint32] = np.interp((np.arange(_STEPS) + 0.5) / _STEPS, ends, below).astype(np.uint32)
    return voxels


class Location(NamedTuple):
    """Points of surfaces in the cache.

    Attributes:
        entry: its index.
        row: of the table of histograms.
        frame: about the normal, turned alike in all of an entry.
    """

    entry: mt.UInt32
    row: mt.UInt32
    frame: mt.Frame


class GuideCache:
    """The directional histograms of one scene.

    Args:
        low, high: corners of the box that voxels fill, [3] each; points outside belong to the outermost.
        points: of surfaces that paths meet, [3, N]: along each axis voxels are narrower if there are many of them.

    Attributes:
        prior: expected second moments in voxels of twice the side; by default those of the voxels around them.
    """

    def __init__(self, low: ArrayLike, high: ArrayLike, points: ArrayLike) -> None:
        self.voxels = VoxelGrid(low, high, points)
        # in double precision the order in which threads add makes no difference that matters: pictures can be repeated
        self.sums = dr.zeros(
            mi.Float64, CACHE_ENTRIES * HISTOGRAM_BINS * 2
        )  # squares and counts in turn, which are read together
        self.rows = dr.zeros(mi.UInt32, CACHE_ENTRIES)  # each entry's; the first, uniform, is of unknown ones
        self.bounces = dr.zeros(
            mi.Float64, CACHE_ENTRIES * _SUMS
        )  # of radiance, of squares of what was carried, of ones
        self.expected = dr.zeros(mi.Float, 2)  # of each row; see `expect`
        dr.eval(self.sums, self.rows, self.bounces, self.expected)
        self._tabulate(torch.ones(1, HISTOGRAM_BINS, dtype=torch.float64))
        self.prior: MomentPrior = second_moments

    def locate(self, point: mt.Point3, normal: mt.Vector3) -> Location:
        """The location of points with these unit normals."""
        voxel = self.voxels.index(point)
        size = dr.abs(normal)
        along_x = (size.x >= size.y) & (size.x >= size.z)
        along_y = ~along_x & (size.y >= size.z)
        on_axis = dr.select(along_x, normal.x, dr.select(along_y, normal.y, normal.z))
        axis = dr.select(along_x, mi.UInt32(0), dr.select(along_y, mi.UInt32(2), mi.UInt32(4)))
        axis += dr.select(on_axis < 0, mi.UInt32(1), mi.UInt32(0))
        # another axis, which is never along the normal
        across = mi.Vector3f(dr.select(along_y, 1.0, 0.0), dr.select(along_x | along_y, 0.0, 1.0), 0.0)
        across.z = dr.select(along_x, 1.0, 0.0)
        tangent = dr.normalize(across - normal * dr.dot(normal, across))
        entry = ((voxel.z * GRID_SIDE_VOXELS + voxel.y) * GRID_SIDE_VOXELS + voxel.x) * NORMAL_AXES + axis
        row = dr.gather(mi.UInt32, self.rows, entry)
        return Location(entry, row, mi.Frame3f(tangent, dr.cross(normal, tangent), normal))

    def bin(self, local: mt.Vector3) -> mt.UInt32:
        """The bin of directions in a location's frame; any one below the surface."""
        square = mi.warp.uniform_disk_to_square_concentric(mi.Point2f(local.x, local.y))
        within = dr.clip(mi.Vector2i(square * HISTOGRAM_SIDE_BINS), 0, HISTOGRAM_SIDE_BINS - 1)
        return mi.UInt32(within.y * HISTOGRAM_SIDE_BINS + within.x)

    def sample(self, row: mt.UInt32, point: mt.Point2, active: mt.Mask) -> tuple[mt.UInt32, mt.Vector3]:
        """Sample directions by points of the unit square: the bin, and the direction in the location's frame."""
        along = point.x * HISTOGRAM_BINS
        first = dr.minimum(mi.UInt32(along), HISTOGRAM_BINS - 1)
        word = dr.gather(mi.UInt32, self.words, row * HISTOGRAM_BINS + first, active)
        within, own = (along - mi.Float(first)) * HISTOGRAM_BINS, mi.Float(word >> BYTE_BITS & 0xFF)
        is_own = within < own
        index = dr.select(is_own, first, word & 0xFF)
        across = dr.select(is_own, within / own, (within - own) / (HISTOGRAM_BINS - own))
        inside = mi.Point2f(dr.clip(across, 0, dr.one_minus_epsilon(mi.Float)), point.y)
        square = (
            mi.Point2f(mi.Float(index % HISTOGRAM_SIDE_BINS), mi.Float(index // HISTOGRAM_SIDE_BINS)) + inside
        ) * (1 / HISTOGRAM_SIDE_BINS)
        return index, mi.warp.square_to_cosine_hemisphere(square)

    def density(self, row: mt.UInt32, index: mt.UInt32, active: mt.Mask) -> mt.Float:
        """The density by which directions of a bin are sampled, over the cosine's."""
        word = dr.gather(mi.UInt32, self.words, row * HISTOGRAM_BINS + index, active)
        return mi.Float(word >> 2 * BYTE_BITS) * (HISTOGRAM_BINS / PROBABILITY_SLOTS)

    def expect(self, row: mt.UInt32, active: mt.Mask) -> mt.Vector2:
        """Expectations at a surface in a row of the table; 0 if few paths were.

        The luminance that it sends out, but for emission; the root mean square of the radiance of paths that go on.
        """
        return dr.gather(mi.Vector2f, self.expected, row, active)

    def add(self, index: mt.UInt32, density: mt.Float, carried: mt.Float, outgoing: mt.Float, active: mt.Mask) -> None:
        """Add the radiance of paths.

        Args:
            index: entry * BINS + bin.
            density: of the direction over the cosine's.
            carried: luminance that came from it, over the density by which it was sampled.
            outgoing: the same, and that of the emitter that was sampled there.
            active: where there was a path.
        """
        squares = carried * carried
        for sums, first, values in (
            (self.sums, index * 2, (squares * density, dr.rcp(density))),
            (self.bounces, index // HISTOGRAM_BINS * _SUMS, (outgoing, squares, mi.Float(1))),
        ):
            for number, value in enumerate(values):
                dr.scatter_reduce(dr.ReduceOp.Add, sums, mi.Float64(value), first + number, active)

    def statistics(self) -> tuple[Tensor, Tensor, Tensor]:
        """Entries that paths visited, [P], and their sums of squares and of counts, float64 [P, SIDE, SIDE]."""
        # most entries are in the air: they are left out before their sums are read
        visited = self._bounces()[:, -1].nonzero()[:, 0]
        sums = torch.from_numpy(self.sums.numpy()).reshape(CACHE_ENTRIES, HISTOGRAM_SIDE_BINS, HISTOGRAM_SIDE_BINS, 2)[
            visited
        ]
        return visited, sums[..., 0].contiguous(), sums[..., 1].contiguous()

    def learn(self) -> int:
        """Make the histograms anew of all that was added.

        Returns:
            how many there are, less the uniform one.
        """
        visited, squares, counts = self.statistics()
        total, count, coarse, parent = coarsen_sums(squares, counts, voxels_of_entries(visited))
        expected = self.prior(total, count, coarse)
        fine = (counts.flatten(1).sum(1) >= MIN_ENTRY_PATHS).nonzero()[:, 0]
        own = shrink_moments(squares[fine], counts[fine], expected[parent[fine]])
        weights = torch.cat([expected, own]).flatten(1) ** SECOND_MOMENT_POWER
        dark = weights.sum(1) == 0
        self._tabulate(torch.cat([weights.new_ones(1, HISTOGRAM_BINS), torch.where(dark[:, None], 1, weights)]))
        self._expect(visited, parent, len(coarse), fine)
        rows = torch.zeros(*3 * (GRID_SIDE_VOXELS // 2,), NORMAL_AXES, dtype=torch.int32)
        rows[tuple(coarse.T)] = torch.arange(1, 1 + len(coarse), dtype=torch.int32)
        for axis in range(3):
            rows = rows.repeat_interleave(2, axis)
        rows = rows.flatten()
        rows[visited[fine]] = torch.arange(1 + len(coarse), 1 + len(weights), dtype=torch.int32)
        self.rows = mi.UInt32(rows.numpy().view(np.uint32))
        return len(weights)

    def _bounces(self) -> Tensor:
        return torch.from_numpy(self.bounces.numpy()).reshape(CACHE_ENTRIES, _SUMS)

    def _expect(self, visited: Tensor, parent: Tensor, coarse: int, fine: Tensor) -> None:
        """Make the table of `expect`, of the same rows as that of histograms."""
        own = self._bounces()[visited]
        shared = own.new_zeros(coarse, _SUMS).index_add_(0, parent, own)
        sums = torch.cat([own.new_zeros(1, _SUMS), shared, own[fine]])
        means = torch.where(sums[:, 2:] < MIN_ROW_BOUNCES, 0, sums[:, :2] / sums[:, 2:])
        means[:, 1] = means[:, 1].sqrt()
        self.expected = mi.Float(means.float().flatten().numpy())

    def _tabulate(self, weights: Tensor) -> None:
        """Make the table of histograms, of weights [rows, BINS]."""
        self.words = mi.UInt32(alias_words(quantise_weights(weights).numpy()).flatten())
        dr.eval(self.words)


class BounceRecords:
    """The first RECORDED bounces of so many paths, kept until the radiance of these is known.

    Attributes:
        stores: the first `numbers` values of a bounce, each of all paths, 0 if there was none: entry *
            BINS + bin + 1; the density of the sampled direction, over the cosine's; luminance of the path's throughput
            before it; luminance that the path had, with the emitter sampled here, and without; point; normal.
    """

    numbers = 5

    def __init__(self, paths: int) -> None:
        self.paths, self.lane = paths, dr.arange(mi.UInt32, paths)
        kinds = [mi.UInt32, *[mi.Float] * (self.numbers - 1)]
        self.stores = [dr.zeros(kind, paths * MAX_RECORDED_BOUNCES) for kind in kinds]
        dr.eval(self.lane, self.stores)

    def add(self, depth: mt.UInt32, values: tuple[mt.Float | mt.UInt32, ...], active: mt.Mask) -> None:
        """Record a bounce, all that `stores` may hold of it."""
        slot, active = self.lane * MAX_RECORDED_BOUNCES + depth, active & (depth < MAX_RECORDED_BOUNCES)
        for store, value in zip(self.stores, values[: self.numbers], strict=True):
            dr.scatter(store, value, slot, active)

    def train(self, cache: GuideCache, radiance: mt.Color) -> None:
        """Add all bounces to a cache, by the radiance that the paths have in the end."""
        total = mi.luminance(radiance)
        dr.eval(total, self.stores)
        index, density, throughput, radiance, unlit = self.stores[:5]
        total = dr.gather(
            mi.Float, total, dr.arange(mi.UInt32, self.paths * MAX_RECORDED_BOUNCES) // MAX_RECORDED_BOUNCES
        )
        carried, outgoing = (
            dr.maximum(total - before, 0) / dr.maximum(throughput, 1e-12) for before in (radiance, unlit)
        )
        active = (index > 0) & (density > 0) & dr.isfinite(outgoing)
        cache.add(index - 1, density, carried, outgoing, active)
        dr.eval(cache.sums, cache.bounces)
