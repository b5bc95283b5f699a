"""Where light comes from, learned from a render: per voxel, side of a surface and cell of directions.

A place is a voxel and the axis nearest to a surface's normal. In each place there are cells of the hemisphere above the
surface, all of the same share of it, weighed by the cosine. What is learned is the second moment of what paths carry
from each cell, whose root is the density of least variance (Rath et al. 2020), coarse to fine: cells that few paths
took lean on those around them.

A table has a row for each place that many paths met; the others share that of a voxel of twice the side. In a row,
directions are drawn by the alias method (Walker 1977): a word for each cell says how many of all SLOTS it has, never
fewer than 1 / SHARE of what would be even, and which other cell is drawn in its place how often.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

GRID, SIDE = 16, 16  # voxels along an axis, cells along a side of the hemisphere
SHARE = 16  # a cell's density is at least one in so many of the uniform one
AXES = 6
CELLS = SIDE * SIDE  # no more than a byte tells apart
SLOTS = CELLS * CELLS
PLACES = GRID**3 * AXES
OWN = 2048.0  # paths from which on a place has a row of its own
LEAN = 16.0  # paths that the coarser cells count as
POWER = 0.4  # of second moments; the density of least variance is the root, but a few paths make cells too bright

_TINY = 1e-300
_FLOOR = 1e-6  # of the brightest cell
_BYTE = 8  # bits; a word is, from below: another cell, the draws of CELLS that are not the other's, slots


Expects = Callable[[Tensor, Tensor, Tensor], Tensor]


class Spot(NamedTuple):
    """Points of surfaces in the cache.

    Attributes:
        place: its number.
        row: of the table.
        frame: about the normal, turned alike in all of a place.
    """

    place: Any
    row: Any
    frame: Any


class GuideCache:
    """What was learned about one scene, in the variant of Mitsuba that is active.

    Args:
        mi: Mitsuba, in a variant of Dr.Jit.
        low, high: corners of the box that voxels fill, [3] each; what is outside belongs to the outermost.

    Attributes:
        expects: the second moments in voxels of twice the side, as `moments` of their sums, or by what else is known.
    """

    def __init__(self, mi: Any, low: Any, high: Any) -> None:
        import drjit

        self.mi, self.dr = mi, drjit
        low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
        extent = np.maximum(high - low, 1e-6 * max(float((high - low).max()), 1e-6))
        self.low, self.scale = mi.ScalarPoint3f(low), mi.ScalarVector3f(GRID / extent)
        # in double precision the order in which threads add makes no difference that matters: pictures can be repeated
        self.sums = drjit.zeros(mi.Float64, PLACES * CELLS * 2)  # of squares and of counts in turn, to be met together
        self.rows = drjit.zeros(mi.UInt32, PLACES)  # each place's; the first is of places that nothing is known of
        self.met = drjit.zeros(mi.UInt32, PLACES)
        drjit.eval(self.sums, self.rows, self.met)
        self._tabulate(torch.ones(1, CELLS, dtype=torch.float64))
        self.expects: Expects = moments

    def spot(self, point: Any, normal: Any) -> Spot:
        """Where points with these unit normals are."""
        mi, dr = self.mi, self.dr
        voxel = mi.Vector3u(dr.clip(mi.Vector3i((point - self.low) * self.scale), 0, GRID - 1))
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
        place = ((voxel.z * GRID + voxel.y) * GRID + voxel.x) * AXES + axis
        row = dr.gather(mi.UInt32, self.rows, place)
        return Spot(place, row, mi.Frame3f(tangent, dr.cross(normal, tangent), normal))

    def cell(self, local: Any) -> Any:
        """The cell of directions in a spot's frame; anything below the surface."""
        mi, dr = self.mi, self.dr
        square = mi.warp.uniform_disk_to_square_concentric(mi.Point2f(local.x, local.y))
        within = dr.clip(mi.Vector2i(square * SIDE), 0, SIDE - 1)
        return mi.UInt32(within.y * SIDE + within.x)

    def draw(self, row: Any, point: Any, active: Any) -> tuple[Any, Any]:
        """Draw directions.

        Args:
            row: of spots.
            point: in [0, 1)^2, uniform.
            active: where to draw.

        Returns:
            the cell, and the direction in the spot's frame that was drawn in it.
        """
        mi, dr = self.mi, self.dr
        along = point.x * CELLS
        first = dr.minimum(mi.UInt32(along), CELLS - 1)
        word = dr.gather(mi.UInt32, self.words, row * CELLS + first, active)
        within, own = (along - mi.Float(first)) * CELLS, mi.Float(word >> _BYTE & 0xFF)
        is_own = within < own
        cell = dr.select(is_own, first, word & 0xFF)
        across = dr.select(is_own, within / own, (within - own) / (CELLS - own))
        inside = mi.Point2f(dr.clip(across, 0, dr.one_minus_epsilon(mi.Float)), point.y)
        place_in = (mi.Point2f(mi.Float(cell % SIDE), mi.Float(cell // SIDE)) + inside) * (1 / SIDE)
        return cell, mi.warp.square_to_cosine_hemisphere(place_in)

    def density(self, row: Any, cell: Any, active: Any) -> Any:
        """How densely directions in a cell are drawn, over the cosine's density."""
        word = self.dr.gather(self.mi.UInt32, self.words, row * CELLS + cell, active)
        return self.mi.Float(word >> 2 * _BYTE) * (CELLS / SLOTS)

    def add(self, index: Any, density: Any, carried: Any, active: Any) -> None:
        """Remember what paths carried.

        Args:
            index: place * CELLS + cell.
            density: of the direction over the cosine's.
            carried: luminance that came by it, over the density of its drawing.
            active: where there was a path.
        """
        dr, double = self.dr, self.mi.Float64
        for number, value in enumerate((carried * carried * density, dr.rcp(density))):
            dr.scatter_reduce(dr.ReduceOp.Add, self.sums, double(value), index * 2 + number, active)
        dr.scatter(self.met, self.mi.UInt32(1), index // CELLS, active)

    def taught(self) -> tuple[Tensor, Tensor, Tensor]:
        """Places that paths met, [P], and their sums of squares and of counts, float64 [P, SIDE, SIDE]."""
        # most places are in the air: they are left out before their sums are read
        seen = torch.from_numpy(self.met.numpy().view(np.int32)).nonzero()[:, 0]
        sums = torch.from_numpy(self.sums.numpy()).reshape(PLACES, SIDE, SIDE, 2)[seen]
        return seen, sums[..., 0].contiguous(), sums[..., 1].contiguous()

    def learn(self) -> int:
        """Share the slots out anew by all that was remembered.

        Returns:
            how many rows the table has, less the first.
        """
        seen, squares, counts = self.taught()
        total, count, coarse, which = halved(squares, counts, voxels_of(seen))
        around = self.expects(total, count, coarse)
        fine = (counts.flatten(1).sum(1) >= OWN).nonzero()[:, 0]
        own = refined(squares[fine], counts[fine], around[which[fine]])
        known = torch.cat([around, own]).flatten(1) ** POWER
        dark = known.sum(1) == 0
        self._tabulate(torch.cat([known.new_ones(1, CELLS), torch.where(dark[:, None], 1, known)]))
        rows = torch.zeros(*3 * (GRID // 2,), AXES, dtype=torch.int32)
        rows[tuple(coarse.T)] = torch.arange(1, 1 + len(coarse), dtype=torch.int32)
        for axis in range(3):
            rows = rows.repeat_interleave(2, axis)
        rows = rows.flatten()
        rows[seen[fine]] = torch.arange(1 + len(coarse), 1 + len(known), dtype=torch.int32)
        self.rows = self.mi.UInt32(rows.numpy().view(np.uint32))
        return len(known)

    def _tabulate(self, weights: Tensor) -> None:
        """Make the table, a row for each row of cells' weights."""
        words = words_of(slots_of(weights).numpy())
        self.words = self.mi.UInt32(words.flatten())
        self.dr.eval(self.words)


def voxels_of(places: Tensor) -> Tensor:
    """The three whole numbers of their voxels, and their axes, [P, 4]."""
    voxel = places // AXES
    return torch.stack([voxel // GRID**2, voxel // GRID % GRID, voxel % GRID, places % AXES], 1)


def halved(squares: Tensor, counts: Tensor, voxels: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Sums over voxels of twice the side, where these are, and which one each belongs to."""
    halved = torch.cat([voxels[:, :3] // 2, voxels[:, 3:]], 1)
    coarse, which = halved.unique(dim=0, return_inverse=True)
    total, count = (each.new_zeros(len(coarse), SIDE, SIDE).index_add_(0, which, each) for each in (squares, counts))
    return total, count, coarse, which


def moments(squares: Tensor, counts: Tensor, voxels: Tensor) -> Tensor:
    """The second moment of what comes from each cell, coarse to fine, in voxels and in directions.

    A voxel's are those of the eight about it, times a ratio, which is found for the whole hemisphere first, then for
    quarters of it and so on: where few paths came, it is that of the coarser cells.

    Args:
        squares: sums of what came by paths, squared and each over the density of the path, float64 [P, SIDE, SIDE].
        counts: sums of one over the same densities: about how many paths uniform directions would have sent there.
        voxels: where each of the P places is, three whole numbers, and its axis, [P, 4].

    Returns:
        of the same shape, of any scale.
    """
    if not bool(voxels[:, :3].any()):
        return refined(squares, counts, torch.ones_like(squares), 1e-9)  # the whole box leans on nothing
    total, count, coarse, which = halved(squares, counts, voxels)
    return refined(squares, counts, moments(total, count, coarse)[which])


def refined(squares: Tensor, counts: Tensor, expected: Tensor, lean: float = LEAN) -> Tensor:
    """Second moments of what comes from each cell, where few paths came those that are expected.

    Args:
        squares, counts: as of `moments`.
        expected: of the same shape.
        lean: paths that it counts as for the whole hemisphere.
    """
    levels = [(squares, counts, expected)]
    while levels[-1][0].shape[-1] > 1:
        total, count, prior = (_in_quarters(each) for each in levels[-1])
        levels.append((total, count, prior / 4))
    total, count, prior = levels[-1]
    ratio = (total + lean * prior) / (count + lean) / prior.clamp_min(_TINY)
    for total, count, prior in levels[-2::-1]:
        around = ratio.repeat_interleave(2, -1).repeat_interleave(2, -2) * prior
        ratio = (total + LEAN * around) / (count + LEAN) / prior.clamp_min(_TINY)
    return ratio * expected


def relative(values: Tensor) -> Tensor:
    """Logarithms of values [P, SIDE, SIDE] over their geometric mean in a place, float32."""
    highest = values.amax((1, 2), keepdim=True)
    logs = (values / highest.clamp_min(torch.finfo(values.dtype).tiny) + _FLOOR).log()
    return (logs - logs.mean((1, 2), keepdim=True)).float()


def _in_quarters(values: Tensor) -> Tensor:
    """Sums of two by two cells of directions."""
    rows = values[..., ::2, :] + values[..., 1::2, :]
    return rows[..., ::2] + rows[..., 1::2]


def slots_of(weights: Tensor) -> Tensor:
    """How many slots each cell has.

    Args:
        weights: float64 [P, CELLS], not negative, no row all zero.

    Returns:
        int32 [P, CELLS]: SLOTS / CELLS / SHARE each, and of the others by weight; SLOTS in each row.
    """
    least = SLOTS // (CELLS * SHARE)
    free = SLOTS - CELLS * least
    ends = (weights.cumsum(1) / weights.sum(1, keepdim=True) * free + 0.5).floor().int()
    ends[:, -1] = free
    return ends.diff(dim=1, prepend=torch.zeros(len(ends), 1, dtype=torch.int32)) + least


def words_of(slots: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """A row's words: of each cell another one, how many of CELLS draws are not the other's, and its slots.

    In the order of slots, draws that the poorest cell does not fill are the richest one's, until that has no more to
    give than it fills itself; then those of the next richest (Huebschle-Schneider and Sanders 2019, in sweeps).

    Args:
        slots: [P, CELLS], SLOTS in each row.

    Returns:
        uint32 [P, CELLS].
    """
    order = slots.argsort(1).astype(np.int32)
    known = np.ascontiguousarray(np.take_along_axis(slots, order, 1)).ravel()
    own, other = (np.zeros(slots.size, np.int32) for _ in range(2))
    start = np.arange(len(slots)) * CELLS
    poor, rich = start.copy(), start + CELLS - 1
    left = known[rich]
    for _ in range(CELLS - 1):
        gives = left > CELLS
        cell, has = np.where(gives, poor, rich), np.where(gives, known[poor], left)
        own[cell], other[cell] = has, rich - ~gives
        left = has - CELLS + np.where(gives, left, known[rich - 1])
        poor += gives
        rich -= ~gives
    own[poor], other[poor] = CELLS, poor
    full = own == CELLS  # a byte is too small: all of them are the other's, which is itself
    other[full] = full.nonzero()[0]
    own[full] = 0
    other = np.take_along_axis(order, (other - start.repeat(CELLS)).reshape(slots.shape), 1)
    sorted_words = other | own.reshape(slots.shape) << _BYTE | known.reshape(slots.shape) << 2 * _BYTE
    words = np.empty_like(sorted_words)
    np.put_along_axis(words, order, sorted_words, 1)
    return words.view(np.uint32)
