"""A spatial cache of directional histograms, learned from the paths of one scene, in the active variant of Mitsuba.

An entry stands for a voxel and one of six axes, the one nearest to a surface's normal. Its histogram has bins of the
hemisphere above the surface, all of the same projected solid angle. An entry that many paths visited has a histogram of
its own in the table of histograms. The others share a histogram with all entries of their axis in the same coarse
voxel, which has twice the side; where no path came near, the histogram is uniform. The cache knows nothing of how paths
are traced.

Two luminances are learned from each bounce of a path, both per unit of the path's throughput. The outgoing luminance
estimates all light that the surface reflects along the path. The continuation is the part of it that the path brought
by going on in the sampled direction, without the emitter that was sampled at the bounce.
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

# Sum of 1 / density over the bounces in an entry from which on it has a histogram of its own. Densities are relative to
# cosine sampling: if directions are sampled so, the sum is the number of bounces, and otherwise it is so in the mean.
MIN_ENTRY_INVERSE_DENSITY = 2048.0
MAX_RECORDED_BOUNCES = 8  # the cache learns from so many bounces of a path, the first ones
MIN_ROW_BOUNCES = 8  # a row of fewer bounces has no expected luminances
_SUMS_PER_ENTRY = 3  # the sum of outgoing luminances, the sum of squared continuations, and the number of bounces
POINT_DENSITY_SHARE = 0.8  # share of the voxels along an axis that are spread by the density of points, not evenly
_AXIS_PARTS = 64  # parts of an axis within which voxels have one width
_AXIS_STEPS = 1024  # equal steps of an axis, each in one voxel: the voxel of a point is looked up, not searched


class VoxelGrid:
    """A grid of GRID_SIDE_VOXELS voxels along each axis of a box.

    Args:
        low, high: the corners of the box, [3] each; points outside belong to the outermost voxels.
        points: points of surfaces, [3, N]: along each axis voxels are narrower where there are many points. Without
            any, all voxels are equally wide.

    Attributes:
        low: the lower corner of the box.
        scale: the number of steps of each axis in a unit of length.
        voxels: for each axis the voxel that each of its steps is in.
    """

    def __init__(self, low: ArrayLike, high: ArrayLike, points: ArrayLike) -> None:
        low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
        extent = np.maximum(high - low, 1e-6 * max(float((high - low).max()), 1e-6))
        self.low, self.scale = mi.ScalarPoint3f(low), mi.ScalarVector3f(_AXIS_STEPS / extent)
        relative_points = (np.asarray(points) - low[:, None]) / extent[:, None]
        self.voxels = [mi.UInt32(_divide_axis(coordinates)) for coordinates in relative_points]

    def index(self, point: mt.Point3) -> mt.Vector3:
        """Return the indices along the three axes of the voxels that points are in."""
        step = mi.Vector3u(dr.clip((point - self.low) * self.scale, 0, _AXIS_STEPS - 1))
        return mi.Vector3u(*(dr.gather(mi.UInt32, voxels, step[axis]) for axis, voxels in enumerate(self.voxels)))


def _divide_axis(coordinates: ArrayLike) -> NDArray[np.uint32]:
    """Divide an axis of the box into GRID_SIDE_VOXELS voxels, which are narrower where there are many points.

    A part of the axis gets voxels for its length and for its points: a share of POINT_DENSITY_SHARE of all voxels is
    given by points, the rest by length.

    Args:
        coordinates: the coordinates of points along the axis, [N]. The box goes from 0 to 1; points outside do not
            count.

    Returns:
        The index of the voxel that each of _AXIS_STEPS equal steps of the axis is in, [_AXIS_STEPS].
    """
    part_ends = np.linspace(0, 1, _AXIS_PARTS + 1)
    counts = np.concatenate([[0], np.histogram(coordinates, part_ends)[0].cumsum()])
    point_share = counts / counts[-1] if counts[-1] else part_ends
    voxels_below = GRID_SIDE_VOXELS * ((1 - POINT_DENSITY_SHARE) * part_ends + POINT_DENSITY_SHARE * point_share)
    voxels: NDArray[np.uint32] = np.interp(
        (np.arange(_AXIS_STEPS) + 0.5) / _AXIS_STEPS, part_ends, voxels_below
    ).astype(np.uint32)
    return voxels


class Location(NamedTuple):
    """The places of surface points in the cache.

    Attributes:
        entry: the index of the entry.
        row: the entry's row in the table of histograms.
        frame: the frame in which the entry's histogram has its directions: z is the normal, and x the projection of a
            coordinate axis onto the tangent plane. It is the same coordinate axis at all points of an entry, so that
            their bins mean nearly the same directions of the scene.
    """

    entry: mt.UInt32
    row: mt.UInt32
    frame: mt.Frame


class GuideCache:
    """The directional histograms of one scene.

    Args:
        low, high: the corners of the box that voxels fill, [3] each; points outside belong to the outermost voxels.
        points: points of surfaces that paths meet, [3, N]: along each axis voxels are narrower where there are many
            points.

    Attributes:
        voxels: the grid of voxels.
        sums: for each bin of each entry two sums over bounces, side by side: of the squared continuation times the
            density of the direction, and of 1 / density.
        bounces: for each entry _SUMS_PER_ENTRY sums over its bounces: of outgoing luminances, of squared continuations,
            and of ones.
        rows: the row of each entry in the table of histograms. Row 0 is the uniform histogram, for entries near which
            no path had been when :meth:`update_histograms` was called last: on no surface of their axis in their coarse
            voxel.
        words: the table of histograms, HISTOGRAM_BINS words of the alias method for each row; see
            :func:`metapp.extensions.guided.histogram.alias_words`.
        expected_luminances: for each row of that table the two numbers that :meth:`row_expectations` returns.
        prior: a function that estimates the second moments of coarse voxels from their sums. The default,
            :func:`second_moments`, shrinks them towards the moments of coarser voxels.
    """

    def __init__(self, low: ArrayLike, high: ArrayLike, points: ArrayLike) -> None:
        self.voxels = VoxelGrid(low, high, points)
        # Sums are in double precision, where the order in which threads add hardly matters: pictures can be repeated.
        # A bin's sum of squares and its count stand side by side, as they are read together.
        self.sums = dr.zeros(mi.Float64, CACHE_ENTRIES * HISTOGRAM_BINS * 2)
        # At first all entries have row 0, the uniform histogram, which is the only row of the table.
        self.rows = dr.zeros(mi.UInt32, CACHE_ENTRIES)
        self.bounces = dr.zeros(mi.Float64, CACHE_ENTRIES * _SUMS_PER_ENTRY)
        self.expected_luminances = dr.zeros(mi.Float, 2)  # two numbers for each row; see `row_expectations`
        dr.eval(self.sums, self.rows, self.bounces, self.expected_luminances)
        self._tabulate(torch.ones(1, HISTOGRAM_BINS, dtype=torch.float64))
        self.prior: MomentPrior = second_moments

    def locate(self, point: mt.Point3, normal: mt.Vector3) -> Location:
        """Locate surface points in the cache: by the voxel of a point and the axis nearest to its unit normal."""
        voxel = self.voxels.index(point)
        magnitude = dr.abs(normal)
        along_x = (magnitude.x >= magnitude.y) & (magnitude.x >= magnitude.z)
        along_y = ~along_x & (magnitude.y >= magnitude.z)
        axis_component = dr.select(along_x, normal.x, dr.select(along_y, normal.y, normal.z))
        axis = dr.select(along_x, mi.UInt32(0), dr.select(along_y, mi.UInt32(2), mi.UInt32(4)))
        axis += dr.select(axis_component < 0, mi.UInt32(1), mi.UInt32(0))
        # A coordinate axis other than the one nearest to the normal, so that its projection is no point: z where the
        # nearest is x, x where it is y, and y where it is z.
        other_axis = mi.Vector3f(dr.select(along_y, 1.0, 0.0), dr.select(along_x | along_y, 0.0, 1.0), 0.0)
        other_axis.z = dr.select(along_x, 1.0, 0.0)
        tangent = dr.normalize(other_axis - normal * dr.dot(normal, other_axis))
        entry = ((voxel.z * GRID_SIDE_VOXELS + voxel.y) * GRID_SIDE_VOXELS + voxel.x) * NORMAL_AXES + axis
        row = dr.gather(mi.UInt32, self.rows, entry)
        return Location(entry, row, mi.Frame3f(tangent, dr.cross(normal, tangent), normal))

    def bin_of_direction(self, local: mt.Vector3) -> mt.UInt32:
        """Return the bin of directions in a location's frame; below the surface it is any bin."""
        square = mi.warp.uniform_disk_to_square_concentric(mi.Point2f(local.x, local.y))
        cell = dr.clip(mi.Vector2i(square * HISTOGRAM_SIDE_BINS), 0, HISTOGRAM_SIDE_BINS - 1)
        return mi.UInt32(cell.y * HISTOGRAM_SIDE_BINS + cell.x)

    def sample(self, row: mt.UInt32, point: mt.Point2, active: mt.Mask) -> tuple[mt.UInt32, mt.Vector3]:
        """Sample directions from histograms by the alias method.

        Args:
            row: the row of the table of histograms.
            point: uniform random points of the unit square.
            active: where directions are sampled.

        Returns:
            The bins, and the directions in the frame of their location; within a bin directions are sampled by
            projected solid angle.
        """
        scaled = point.x * HISTOGRAM_BINS
        drawn_bin = dr.minimum(mi.UInt32(scaled), HISTOGRAM_BINS - 1)
        # A word's lowest byte is another bin. Its next byte is how many of HISTOGRAM_BINS draws keep the drawn bin; all
        # others go to that other bin. Its two highest bytes are the bin's slots, which `density` reads.
        word = dr.gather(mi.UInt32, self.words, row * HISTOGRAM_BINS + drawn_bin, active)
        draw, own_draws = (scaled - mi.Float(drawn_bin)) * HISTOGRAM_BINS, mi.Float(word >> BYTE_BITS & 0xFF)
        keeps_bin = draw < own_draws
        index = dr.select(keeps_bin, drawn_bin, word & 0xFF)
        bin_coordinate = dr.select(keeps_bin, draw / own_draws, (draw - own_draws) / (HISTOGRAM_BINS - own_draws))
        bin_place = mi.Point2f(dr.clip(bin_coordinate, 0, dr.one_minus_epsilon(mi.Float)), point.y)
        square = (
            mi.Point2f(mi.Float(index % HISTOGRAM_SIDE_BINS), mi.Float(index // HISTOGRAM_SIDE_BINS)) + bin_place
        ) * (1 / HISTOGRAM_SIDE_BINS)
        return index, mi.warp.square_to_cosine_hemisphere(square)

    def density(self, row: mt.UInt32, index: mt.UInt32, active: mt.Mask) -> mt.Float:
        """Return the density by which directions of a bin are sampled, divided by the density of cosine sampling."""
        word = dr.gather(mi.UInt32, self.words, row * HISTOGRAM_BINS + index, active)
        return mi.Float(word >> 2 * BYTE_BITS) * (HISTOGRAM_BINS / PROBABILITY_SLOTS)

    def row_expectations(self, row: mt.UInt32, active: mt.Mask) -> mt.Vector2:
        """Return two luminances that paths are expected to bring from surfaces of a row, learned from earlier paths.

        Args:
            row: the row of the table of histograms.
            active: where the luminances are wanted; they are 0 elsewhere.

        Returns:
            The mean outgoing luminance, and the root mean square of continuations; see :meth:`add_radiance`. Both are 0
            for row 0, and for rows of fewer than MIN_ROW_BOUNCES bounces.
        """
        return dr.gather(mi.Vector2f, self.expected_luminances, row, active)

    def add_radiance(
        self, index: mt.UInt32, density: mt.Float, continuation: mt.Float, outgoing: mt.Float, active: mt.Mask
    ) -> None:
        """Add what paths brought from one of their bounces to the sums :attr:`sums` and :attr:`bounces`.

        A bin of an entry gets the squared continuation times the density, and 1 / density: in the mean both sums are
        then those that cosine sampling would have given, whatever the densities were.

        Args:
            index: entry * HISTOGRAM_BINS + bin.
            density: the density of the sampled direction, divided by the density of cosine sampling.
            continuation: the luminance that the path brought by going on in the sampled direction, per unit of the
                throughput before the bounce. It contains the BSDF's value divided by the density.
            outgoing: `continuation` and the light of the emitter that was sampled at the bounce: an estimate of all
                light that the surface reflects.
            active: where there was a bounce.
        """
        squares = continuation * continuation
        for sums, start, values in (
            (self.sums, index * 2, (squares * density, dr.rcp(density))),
            (self.bounces, index // HISTOGRAM_BINS * _SUMS_PER_ENTRY, (outgoing, squares, mi.Float(1))),
        ):
            for offset, value in enumerate(values):
                dr.scatter_reduce(dr.ReduceOp.Add, sums, mi.Float64(value), start + offset, active)

    def visited_sums(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return the entries that paths visited, and the two sums of each of their bins.

        Returns:
            The indices of the entries, [P]; for each bin the sum of squared continuations times densities, and the sum
            of 1 / density, float64 [P, SIDE, SIDE] each, where SIDE is HISTOGRAM_SIDE_BINS.
        """
        # most entries are in the air: they are left out before sums are read
        visited = self._entry_sums()[:, -1].nonzero()[:, 0]
        sums = torch.from_numpy(self.sums.numpy()).reshape(CACHE_ENTRIES, HISTOGRAM_SIDE_BINS, HISTOGRAM_SIDE_BINS, 2)[
            visited
        ]
        return visited, sums[..., 0].contiguous(), sums[..., 1].contiguous()

    def update_histograms(self) -> int:
        """Compute all histograms anew from the sums, and with them the rows of entries and the expected luminances.

        The rows of the table are, in this order, the uniform histogram; a histogram for each coarse voxel and axis that
        paths visited; and a histogram for each entry that many paths visited. An entry gets its own row, else the row
        of its coarse voxel and axis, else row 0.

        Returns:
            The number of histograms, without the uniform one.
        """
        visited, squares, counts = self.visited_sums()
        coarse_squares, coarse_counts, coarse_entries, coarse_index = coarsen_sums(
            squares, counts, voxels_of_entries(visited)
        )
        coarse_moments = self.prior(coarse_squares, coarse_counts, coarse_entries)
        frequent_index = (counts.flatten(1).sum(1) >= MIN_ENTRY_INVERSE_DENSITY).nonzero()[:, 0]
        fine_moments = shrink_moments(
            squares[frequent_index], counts[frequent_index], coarse_moments[coarse_index[frequent_index]]
        )
        weights = torch.cat([coarse_moments, fine_moments]).flatten(1) ** SECOND_MOMENT_POWER
        is_dark = weights.sum(1) == 0
        self._tabulate(torch.cat([weights.new_ones(1, HISTOGRAM_BINS), torch.where(is_dark[:, None], 1, weights)]))
        self._tabulate_luminances(visited, coarse_index, len(coarse_entries), frequent_index)
        rows = torch.zeros(*3 * (GRID_SIDE_VOXELS // 2,), NORMAL_AXES, dtype=torch.int32)
        rows[tuple(coarse_entries.T)] = torch.arange(1, 1 + len(coarse_entries), dtype=torch.int32)
        for axis in range(3):
            rows = rows.repeat_interleave(2, axis)
        rows = rows.flatten()
        rows[visited[frequent_index]] = torch.arange(1 + len(coarse_entries), 1 + len(weights), dtype=torch.int32)
        self.rows = mi.UInt32(rows.numpy().view(np.uint32))
        return len(weights)

    def _entry_sums(self) -> Tensor:
        """Return :attr:`bounces`, the sums over the bounces of each entry, as [CACHE_ENTRIES, _SUMS_PER_ENTRY]."""
        return torch.from_numpy(self.bounces.numpy()).reshape(CACHE_ENTRIES, _SUMS_PER_ENTRY)

    def _tabulate_luminances(
        self, visited: Tensor, coarse_index: Tensor, coarse_count: int, frequent_index: Tensor
    ) -> None:
        """Make the table that :meth:`row_expectations` reads; its rows are those of the table of histograms.

        Args:
            visited: the entries that paths visited, [P].
            coarse_index: for each of these entries the index of its coarse voxel and axis among those that paths
                visited, [P].
            coarse_count: the number of coarse voxels, each with an axis, that paths visited.
            frequent_index: the indices, among the P entries, of those that have a histogram of their own.
        """
        entry_sums = self._entry_sums()[visited]
        coarse_sums = entry_sums.new_zeros(coarse_count, _SUMS_PER_ENTRY).index_add_(0, coarse_index, entry_sums)
        sums = torch.cat([entry_sums.new_zeros(1, _SUMS_PER_ENTRY), coarse_sums, entry_sums[frequent_index]])
        means = torch.where(sums[:, 2:] < MIN_ROW_BOUNCES, 0, sums[:, :2] / sums[:, 2:])
        means[:, 1] = means[:, 1].sqrt()
        self.expected_luminances = mi.Float(means.float().flatten().numpy())

    def _tabulate(self, weights: Tensor) -> None:
        """Make the table of histograms from the weights of bins, [rows, HISTOGRAM_BINS], no row all zero."""
        self.words = mi.UInt32(alias_words(quantise_weights(weights).numpy()).flatten())
        dr.eval(self.words)


class BounceRecords:
    """The first MAX_RECORDED_BOUNCES bounces of each path, kept until the radiance of the paths is known.

    Args:
        paths: the number of paths.

    Attributes:
        lane: the index of each path.
        stores: an array for each of the first `numbers` values of this list, with a place for each of
            MAX_RECORDED_BOUNCES bounces of each path; 0 where no bounce was recorded.

            - entry * HISTOGRAM_BINS + bin + 1
            - the density of the sampled direction, divided by the density of cosine sampling
            - the luminance of the path's throughput before the bounce
            - the luminance that the path had brought up to the bounce and by the emitter that was sampled there
            - the luminance that the path had brought up to the bounce, without that emitter
            - x, y and z of the point, then of the normal: six values
        numbers: how many of these values are stored.
    """

    numbers = 5

    def __init__(self, paths: int) -> None:
        self.paths, self.lane = paths, dr.arange(mi.UInt32, paths)
        kinds = [mi.UInt32, *[mi.Float] * (self.numbers - 1)]
        self.stores = [dr.zeros(kind, paths * MAX_RECORDED_BOUNCES) for kind in kinds]
        dr.eval(self.lane, self.stores)

    def record_bounce(self, depth: mt.UInt32, values: tuple[mt.Float | mt.UInt32, ...], active: mt.Mask) -> None:
        """Record the bounce of all active paths at a depth.

        Args:
            depth: the number of surfaces that each path met before.
            values: the values of :attr:`stores`, in this order; those beyond the first `numbers` are dropped.
            active: which paths have a bounce to record.
        """
        slot, active = self.lane * MAX_RECORDED_BOUNCES + depth, active & (depth < MAX_RECORDED_BOUNCES)
        for store, value in zip(self.stores, values[: self.numbers], strict=True):
            dr.scatter(store, value, slot, active)

    def add_to_cache(self, cache: GuideCache, radiance: mt.Color) -> None:
        """Add all recorded bounces to the sums of a cache.

        Bounces are left out whose density is 0 or whose outgoing luminance is not finite.

        Args:
            cache: the cache that learns from the bounces; its histograms stay as they are.
            radiance: the radiance that each path brought in the end.
        """
        final_luminance = mi.luminance(radiance)
        dr.eval(final_luminance, self.stores)
        index, density, throughput, lit_luminance, unlit_luminance = self.stores[:5]
        final_luminance = dr.gather(
            mi.Float, final_luminance, dr.arange(mi.UInt32, self.paths * MAX_RECORDED_BOUNCES) // MAX_RECORDED_BOUNCES
        )
        # Both are the luminance in the end less an earlier one, per unit of throughput: the continuation leaves out the
        # emitter that was sampled at the bounce, the outgoing luminance includes it. Rounding could make them negative.
        continuation, outgoing = (
            dr.maximum(final_luminance - earlier_luminance, 0) / dr.maximum(throughput, 1e-12)
            for earlier_luminance in (lit_luminance, unlit_luminance)
        )
        active = (index > 0) & (density > 0) & dr.isfinite(outgoing)
        cache.add_radiance(index - 1, density, continuation, outgoing, active)
        dr.eval(cache.sums, cache.bounces)
