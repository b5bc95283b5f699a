"""Hierarchical histograms on the unit square and on pairs of squares: each level is drawn towards the one above.

Cells are halved along both sides from level to level. The share of a cell in the one above is
(n + c p) / (n' + c): n of n' samples are in it, p is its share before them, c says how many samples p counts for. This
is the mean of a Polya tree (Ferguson 1974); that shares of directions in a place are drawn towards those in the larger
place around it, for all places up to the whole film, makes it hierarchical (Teh et al. 2006, with fixed strengths).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CELL = 6  # bytes of an occupied cell: 4 of its place, 2 of its count


class Counts(NamedTuple):
    """Occupied cells, in order, and how many samples are in each."""

    keys: Ints
    counts: Ints

    def of(self, keys: Ints) -> Ints:
        """The counts of cells, 0 where they are not occupied."""
        places = np.searchsorted(self.keys, keys).clip(max=len(self.keys) - 1)
        return np.where(self.keys[places] == keys, self.counts[places], 0)

    def coarser(self, levels: int) -> Counts:
        """Those of cells so many levels above, whose keys are those of these without their last bits."""
        keys = self.keys >> (2 * levels)
        first = np.flatnonzero(np.diff(keys, prepend=-1))
        return Counts(keys[first], np.add.reduceat(self.counts, first))


def counted(keys: Ints) -> Counts:
    """Count samples by the cells they are in."""
    return Counts(*np.unique(keys, return_counts=True))


def morton(points: Floats, level: int) -> Ints:
    """Cells of points [N, 2] in [0, 1): those of 4^level, numbered so that a cell's first bits are the one around."""
    x, y = np.minimum((points * 2**level).astype(np.int64), 2**level - 1).T
    code: Ints = np.zeros_like(x)
    for bit in range(level):
        code |= (((x >> bit) & 1) << (2 * bit + 1)) | (((y >> bit) & 1) << (2 * bit))
    return code


class Square(NamedTuple):
    """A density on the unit square.

    Attributes:
        levels: [L + 1] counts, from the whole on.
        prior: of cells at some level, in Morton order, [4^l], sum 1; below that level all shares are a quarter.
    """

    levels: tuple[Counts, ...]
    prior: Floats

    def log_density(self, points: Floats, strengths: Floats) -> Floats:
        """Of points [N, 2]; `strengths` [L] of the shares at each level but the whole."""
        last = len(self.levels) - 1
        code, known = morton(points, last), round(np.log2(len(self.prior)) / 2)
        total, above, share_above = np.zeros(len(points)), self.levels[0].of(np.zeros_like(code)), np.ones(len(points))
        for level in range(1, last + 1):
            here = self.levels[level].of(code >> (2 * (last - level)))
            share = share_above / 4
            if level <= known:
                share = self.prior.reshape(4**level, -1).sum(1)[code >> (2 * (last - level))]
            strength = strengths[level - 1]
            total += np.log(4 * (here + strength * share / share_above) / (above + strength))
            above, share_above = here, share
        return total


def square(points: Floats, levels: int, prior: Floats | None = None) -> Square:
    """The histogram of points [N, 2]; `prior` as of `Square`, uniform where there is none."""
    finest = counted(morton(points, levels))
    by_level = tuple(finest.coarser(levels - level) for level in range(levels + 1))
    return Square(by_level, np.ones(1) if prior is None else prior)


class Pair(NamedTuple):
    """A density on the unit square, given a place on another.

    Both grids are shifted, so that several of these may be averaged: cells that reach beyond the squares count for as
    much as they hold of them.

    Attributes:
        levels: [F + 1][D + 1] counts by the levels of place and direction.
        shifts: in [0, 1), [4]; None: the grids are those of the squares themselves.
    """

    levels: tuple[tuple[Counts, ...], ...]
    shifts: Floats | None

    def look(self, points: Floats) -> Looked:
        """What is known about points [N, 4]: place, then direction."""
        places, directions = len(self.levels) - 1, len(self.levels[0]) - 1
        moved = _moved(points, self.shifts)
        key = _keys(moved, places, directions)
        counts = np.stack([
            np.stack([counts.of(_above(key, places, directions, i, j)) for j, counts in enumerate(of)])
            for i, of in enumerate(self.levels)
        ])  # fmt: skip
        return Looked(counts, np.stack([_areas(moved[:, 2:], self.shifts, j) for j in range(directions + 1)]))


class Looked(NamedTuple):
    """What a density knows about points.

    Attributes:
        counts: [F + 1, D + 1, N].
        areas: of their cells within the square, by the level of direction, [D + 1, N].
    """

    counts: Ints
    areas: Floats

    def log_density(self, strengths: Floats) -> Floats:
        """Of the directions, given the places, [N]; `strengths` [F + 1, D] of shares at each level but the whole."""
        total = np.zeros(self.counts.shape[2])
        for j in range(1, len(self.areas)):
            even = self.areas[j] / self.areas[j - 1]
            share = even
            for counts, strength in zip(self.counts, strengths[:, j - 1], strict=True):
                share = (counts[j] + strength * share) / (counts[j - 1] + strength)
            total += np.log(share / even)
        return total


def pair(points: Floats, places: int, directions: int, shifts: Floats | None = None) -> Pair:
    """The histogram of points [N, 4], place, then direction, with so many levels of each."""
    key = _keys(_moved(points, shifts), places, directions)
    finest = [counted(_above(key, places, directions, i, directions)) for i in range(places + 1)]
    return Pair(
        tuple(tuple(counts.coarser(directions - j) for j in range(directions + 1)) for counts in finest), shifts
    )


def _moved(points: Floats, shifts: Floats | None) -> Floats:
    return points if shifts is None else (points + shifts) / 2


def _keys(moved: Floats, places: int, directions: int) -> Ints:
    return (morton(moved[:, :2], places) << (2 * directions)) | morton(moved[:, 2:], directions)


def _above(key: Ints, places: int, directions: int, i: int, j: int) -> Ints:
    """The cells at levels i and j around the finest ones."""
    place, direction = key >> (2 * directions), key & (4**directions - 1)
    return np.asarray(((place >> (2 * (places - i))) << (2 * j)) | (direction >> (2 * (directions - j))))


def _areas(moved: Floats, shifts: Floats | None, level: int) -> Floats:
    """Areas [N], within the unit square, of the cells around points [N, 2] of a moved grid."""
    if shifts is None:
        return np.full(len(moved), 0.25**level)
    count = 2**level
    first = np.minimum(np.floor(moved * count), count - 1) * 2 / count - shifts[2:]
    sides = np.clip(first + 2 / count, 0, 1) - np.clip(first, 0, 1)
    return np.asarray(sides.prod(1))
