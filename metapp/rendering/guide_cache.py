"""Where light comes from, learned from a render: per voxel, side of a surface and cell of directions.

A place is a voxel and the axis nearest to a surface's normal. In each place there are cells of the hemisphere above the
surface, all of the same share of it, weighed by the cosine. What is learned is the second moment of what paths carry
from each cell, whose root is the density of least variance (Rath et al. 2020), coarse to fine: cells that few paths
took lean on those around them.

Directions are drawn from slots, SHARE for each cell, of which one is the cell's own and the others are shared out as
was learned: one look-up tells a cell and, by how many slots it has, its density, which is never below 1 / SHARE of the
uniform one.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

GRID, SIDE, SHARE = 8, 16, 4  # voxels along an axis, cells along a side of the hemisphere, slots for a cell
AXES = 6
CELLS = SIDE * SIDE
SLOTS = SHARE * CELLS
PLACES = GRID**3 * AXES
LEAN = 16.0  # paths that the coarser cells count as
POWER = 0.4  # of second moments; the density of least variance is the root, but a few paths make cells too bright

_TINY = 1e-300
_LOW = 0xFFFF  # of a slot: the cell; above, how many slots it has


class Spot(NamedTuple):
    """Points of surfaces in the cache.

    Attributes:
        place: its number.
        frame: about the normal, turned alike in all of a place.
    """

    place: Any
    frame: Any


class GuideCache:
    """What was learned about one scene, in the variant of Mitsuba that is active.

    Args:
        mi: Mitsuba, in a variant of Dr.Jit.
        low, high: corners of the box that voxels fill, [3] each; what is outside belongs to the outermost.
    """

    def __init__(self, mi: Any, low: Any, high: Any) -> None:
        import drjit

        self.mi, self.dr = mi, drjit
        low, high = np.asarray(low, np.float64), np.asarray(high, np.float64)
        extent = np.maximum(high - low, 1e-6 * max(float((high - low).max()), 1e-6))
        self.low, self.scale = mi.ScalarPoint3f(low), mi.ScalarVector3f(GRID / extent)
        # in double precision the order in which threads add makes no difference that matters: pictures can be repeated
        self.squares = drjit.zeros(mi.Float64, PLACES * CELLS)
        self.counts = drjit.zeros(mi.Float64, PLACES * CELLS)
        self.slots = mi.UInt32(drjit.arange(mi.UInt32, PLACES * SLOTS) % CELLS | (SHARE << 16))
        drjit.eval(self.squares, self.counts, self.slots)

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
        return Spot(place, mi.Frame3f(tangent, dr.cross(normal, tangent), normal))

    def cell(self, local: Any) -> Any:
        """The cell of directions in a spot's frame; anything below the surface."""
        mi, dr = self.mi, self.dr
        square = mi.warp.uniform_disk_to_square_concentric(mi.Point2f(local.x, local.y))
        within = dr.clip(mi.Vector2i(square * SIDE), 0, SIDE - 1)
        return mi.UInt32(within.y * SIDE + within.x)

    def draw(self, place: Any, cell: Any, is_drawn: Any, point: Any, active: Any) -> tuple[Any, Any, Any]:
        """Draw directions, or tell how densely those in a cell are drawn, by the same look-up.

        Args:
            place: of spots.
            cell: of directions, for where none is drawn.
            is_drawn: where to draw.
            point: in [0, 1)^2, uniform.
            active: where to do anything.

        Returns:
            the cell; the direction in the spot's frame that was drawn in it; and its density over the cosine's.
        """
        mi, dr = self.mi, self.dr
        along = point.x * SLOTS
        slot = dr.minimum(mi.UInt32(along), SLOTS - 1)
        found = dr.gather(mi.UInt32, self.slots, place * SLOTS + dr.select(is_drawn, slot, cell), active)
        cell = dr.select(is_drawn, found & _LOW, cell)
        corner = mi.Point2f(mi.Float(cell % SIDE), mi.Float(cell // SIDE))
        place_in = (corner + mi.Point2f(along - mi.Float(slot), point.y)) * (1 / SIDE)
        return cell, mi.warp.square_to_cosine_hemisphere(place_in), mi.Float(found >> 16) * (1 / SHARE)

    def density(self, place: Any, cell: Any, active: Any) -> Any:
        """How densely directions in a cell are drawn, over the cosine's density."""
        dr, mi = self.dr, self.mi
        found = dr.gather(mi.UInt32, self.slots, place * SLOTS + cell, active)
        return mi.Float(found >> 16) * (1 / SHARE)

    def add(self, index: Any, density: Any, carried: Any, active: Any) -> None:
        """Remember what paths carried.

        Args:
            index: place * CELLS + cell.
            density: of the direction over the cosine's.
            carried: luminance that came by it, over the density of its drawing.
            active: where there was a path.
        """
        dr, double = self.dr, self.mi.Float64
        dr.scatter_reduce(dr.ReduceOp.Add, self.squares, double(carried * carried * density), index, active)
        dr.scatter_reduce(dr.ReduceOp.Add, self.counts, double(dr.rcp(density)), index, active)

    def learn(self) -> int:
        """Share the slots out anew by all that was remembered.

        Returns:
            how many places have been seen.
        """
        mi = self.mi
        sums = (torch.from_numpy(each.numpy()).reshape(PLACES, SIDE, SIDE) for each in (self.squares, self.counts))
        squares, counts = sums
        seen = (counts.flatten(1).sum(1) > 0).nonzero()[:, 0]
        voxels = torch.stack(
            [seen // AXES // GRID**2, seen // AXES // GRID % GRID, seen // AXES % GRID, seen % AXES], 1
        )
        known = moments(squares[seen], counts[seen], voxels).flatten(1) ** POWER
        bright = known.sum(1) > 0
        seen = seen[bright]
        if len(seen):
            where = (seen[:, None] * SLOTS + torch.arange(SLOTS)).flatten()
            tables = (slots_of(known[bright]).flatten(), where)
            values, places = (mi.UInt32(each.int().numpy().view(np.uint32)) for each in tables)
            self.dr.scatter(self.slots, values, places)
            self.dr.eval(self.slots)
        return len(seen)


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
    whole = not bool(voxels[:, :3].any())
    if whole:
        expected = torch.ones_like(squares)
    else:
        halved = torch.cat([voxels[:, :3] // 2, voxels[:, 3:]], 1)
        coarse, which = halved.unique(dim=0, return_inverse=True)
        total, count = (
            each.new_zeros(len(coarse), SIDE, SIDE).index_add_(0, which, each) for each in (squares, counts)
        )
        expected = moments(total, count, coarse)[which]
    levels = [(squares, counts, expected)]
    while levels[-1][0].shape[-1] > 1:
        total, count, prior = (_in_quarters(each) for each in levels[-1])
        levels.append((total, count, prior / 4))
    total, count, prior = levels[-1]
    lean = 1e-9 if whole else LEAN  # the whole box leans on nothing
    ratio = (total + lean * prior) / (count + lean) / prior.clamp_min(_TINY)
    for total, count, prior in levels[-2::-1]:
        around = ratio.repeat_interleave(2, -1).repeat_interleave(2, -2) * prior
        ratio = (total + LEAN * around) / (count + LEAN) / prior.clamp_min(_TINY)
    return ratio * expected


def _in_quarters(values: Tensor) -> Tensor:
    """Sums of two by two cells of directions."""
    rows = values[..., ::2, :] + values[..., 1::2, :]
    return rows[..., ::2] + rows[..., 1::2]


def slots_of(weights: Tensor) -> Tensor:
    """The slots of places by their cells' weights: cell | number of its slots << 16.

    Args:
        weights: float64 [P, CELLS], not negative, no row all zero.

    Returns:
        int64 [P, SLOTS]; the first CELLS are the cells in order, the others in proportion to the weights.
    """
    free = SLOTS - CELLS
    ends = (weights.cumsum(1) / weights.sum(1, keepdim=True) * free + 0.5).floor().long()
    ends[:, -1] = free
    counts = ends.diff(dim=1, prepend=torch.zeros(len(ends), 1, dtype=torch.long))
    packed = torch.arange(CELLS) | ((counts + 1) << 16)
    shared = packed.flatten().repeat_interleave(counts.flatten()).reshape(len(weights), free)
    return torch.cat([packed, shared], 1)
