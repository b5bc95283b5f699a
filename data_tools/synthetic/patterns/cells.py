"""Periodic cells: lattices at any angle with an identity for every cell, and Worley noise on them.

Bricks, tiles, weaves and stones are made of them, but no material is known here.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from data_tools.random_streams import Rng
from data_tools.synthetic.patterns.fields import texel_centres
from data_tools.synthetic.random_values import Field, Ids, uniforms


class CellLattice:
    """A lattice of cells in rows that repeat after one tile, whatever their angle.

    The vectors that turn tile coordinates into columns and rows are whole numbers: one tile further is a whole number
    of cells further. Of all such vectors near the wanted ones, the most nearly orthogonal are taken.

    Args:
        size: S, texels along a side of the tile.
        columns: cells per tile along the angle, about.
        rows: cells per tile across the angle, about.
        angle_rad: direction of the rows, from x towards y.
        shift: shift of each row against the row before, in cells; a multiple of 1 / multiple.
        multiple: rows come in multiples of it, and so do columns if `period` says so.
        period: columns come in multiples of it.
        warp: displacement of columns and rows, two fields [S, S] in cells.

    Attributes:
        u: position [S, S] within the cell along the row, in [0, 1).
        v: position [S, S] across the row, in [0, 1).
        column, row: numbers [S, S] of the cell.
        cell: identity [S, S] of the cell, 0 .. count - 1, equal for a cell and its repetitions.
        count: number of cells.
        width, height: size of a cell, in tiles.
        direction_rad: true angle of the rows.
    """

    def __init__(
        self,
        size: int,
        columns: float,
        rows: float,
        angle_rad: float = 0.0,
        shift: float = 0.0,
        multiple: int = 1,
        period: int = 1,
        warp: tuple[Field, Field] | None = None,
    ) -> None:
        (a, b), (c, d) = _whole_vectors(columns, rows, angle_rad, period, multiple)
        x, y = texel_centres(size)
        across = c * x + d * y if warp is None else c * x + d * y + warp[1]
        self.row = np.floor(across).astype(np.int64)
        along = a * x + b * y + np.float32(shift) * self.row
        along = (along if warp is None else along + warp[0]).astype(np.float32)
        self.column = np.floor(along).astype(np.int64)
        self.u = (along - self.column).astype(np.float32)
        self.v = (across - self.row).astype(np.float32)
        self.shift = shift
        determinant = abs(a * d - b * c)
        self.width, self.height = math.hypot(c, d) / determinant, math.hypot(a, b) / determinant
        self.direction_rad = math.atan2(b, a)
        self._origin = (int(self.column.min()) - 2, int(self.row.min()) - 2)
        shape = (int(self.column.max()) - self._origin[0] + 3, int(self.row.max()) - self._origin[1] + 3)
        i, j = np.meshgrid(np.arange(shape[0]), np.arange(shape[1]), indexing="ij")
        # Two cells are one where they differ by a whole number of tiles: their images under the adjugate are equal
        # modulo the determinant.
        a, b = round(a + shift * c), round(b + shift * d)
        first, second = (d * i - b * j) % determinant, (a * j - c * i) % determinant
        keys, identities = np.unique(first * determinant + second, return_inverse=True)
        self.count = len(keys)
        self._identities = identities.reshape(shape).astype(np.int64)
        self.cell = self.neighbour(0, 0)

    def neighbour(self, columns: int | Ids, rows: int | Ids) -> Ids:
        """Return the identity [S, S] of the cell that is some columns and rows further (at most 2)."""
        result: Ids = self._identities[self.column + columns - self._origin[0], self.row + rows - self._origin[1]]
        return result


def _whole_vectors(
    columns: float, rows: float, angle_rad: float, period: int, multiple: int
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Find two vectors of whole numbers near the wanted ones that are nearly orthogonal.

    The first is a multiple of `period`, the second of `multiple`.
    """
    cos, sin = math.cos(angle_rad), math.sin(angle_rad)

    def nearby_multiples(target: float, unit: int) -> list[int]:
        """Return the three multiples of a unit around a wanted number."""
        middle = round(target / unit)
        return [unit * (middle + offset) for offset in (-1, 0, 1)]

    lowest_cost, vectors = math.inf, ((1, 0), (0, 1))
    for a, b in itertools.product(nearby_multiples(columns * cos, period), nearby_multiples(columns * sin, period)):
        for c, d in itertools.product(nearby_multiples(-rows * sin, multiple), nearby_multiples(rows * cos, multiple)):
            first, second = math.hypot(a, b), math.hypot(c, d)
            if first == 0 or second == 0 or a * d - b * c <= 0:
                continue
            skew = abs(a * c + b * d) / (first * second)
            turn = 1 - (a * cos + b * sin) / first
            scale = abs(math.log(first / columns)) + abs(math.log(second / rows))
            cost = 8 * skew + 2 * turn + 0.5 * scale
            if cost < lowest_cost:
                lowest_cost, vectors = cost, ((a, b), (c, d))
    return vectors


class WorleyNoise(NamedTuple):
    """The distances to the feature points of cells, in widths of a mean cell.

    Attributes:
        nearest: distance [S, S] to the nearest point (F1).
        second: distance [S, S] to the next (F2).
        edge: distance [S, S] to the border between their two cells.
        cell: identity [S, S] of the nearest point's cell, 0 .. total - 1.
        total: number of cells.
        across_x, across_y: position [S, S] from the nearest point, along the lattice's rows and across them.
    """

    nearest: Field
    second: Field
    edge: Field
    cell: Ids
    total: int
    across_x: Field
    across_y: Field


def worley_noise(rng: Rng, lattice: CellLattice, jitter: float = 0.85) -> WorleyNoise:
    """Draw Worley noise with one feature point in each cell of a lattice.

    Args:
        rng: random numbers for the points.
        lattice: the cells; a warped lattice gives curved borders.
        jitter: 0 for points in the middle of their cells, up to 1 for any place in them.
    """
    offsets = np.float32(jitter) * (uniforms(rng, 2, lattice.count) - np.float32(0.5)) + np.float32(0.5)
    mean = math.sqrt(lattice.width * lattice.height)
    scale_x, scale_y = np.float32(lattice.width / mean), np.float32(lattice.height / mean)
    shape = lattice.u.shape
    first, second = np.full(shape, 1e9, np.float32), np.full(shape, 1e9, np.float32)
    cell = np.zeros(shape, np.int64)
    nearest_offset, second_offset = np.zeros((2, *shape), np.float32), np.zeros((2, *shape), np.float32)
    for dj, di in itertools.product((0, -1, 1), repeat=2):
        identity = lattice.neighbour(di, dj)
        px = (offsets[0][identity] + np.float32(di - lattice.shift * dj) - lattice.u) * scale_x
        py = (offsets[1][identity] + np.float32(dj) - lattice.v) * scale_y
        distance = px * px + py * py
        nearer = distance < first
        nearly = ~nearer & (distance < second)
        for axis, value in enumerate((px, py)):
            second_offset[axis] = np.where(nearer, nearest_offset[axis], np.where(nearly, value, second_offset[axis]))
            nearest_offset[axis] = np.where(nearer, value, nearest_offset[axis])
        second = np.where(nearer, first, np.where(nearly, distance, second))
        first = np.where(nearer, distance, first)
        cell = np.where(nearer, identity, cell)
    point_distance = np.hypot(second_offset[0] - nearest_offset[0], second_offset[1] - nearest_offset[1])
    edge = (second - first) / np.maximum(2 * point_distance, np.float32(1e-6))
    return WorleyNoise(
        np.sqrt(first), np.sqrt(second), edge, cell, lattice.count, -nearest_offset[0], -nearest_offset[1]
    )


def isotropic_cells(
    rng: Rng, size: int, cells: float, jitter: float = 0.85, warp: tuple[Field, Field] | None = None, aspect: float = 1
) -> WorleyNoise:
    """Draw Worley noise of about `cells` cells per tile side, on a lattice at a random angle.

    Args:
        rng: random numbers for the angle and the points.
        size: S, texels along a side of the tile.
        cells: number of cells per tile side.
        jitter: 0 for points in the middle of their cells, up to 1 for any place in them.
        warp: displacement [S, S] along and across, in cells.
        aspect: length of a cell over its width.
    """
    stretch = math.sqrt(aspect)
    lattice = CellLattice(size, cells / stretch, cells * stretch, float(rng.random()) * math.pi, warp=warp)
    return worley_noise(rng, lattice, jitter)
