"""The SD-tree of Mueller, Gross & Novak 2017: a binary tree of space whose leaves hold quadtrees of directions.

Trees are flat. As space is halved in the middle, a table of the finest cells holds the leaf of each. The leaves of all
quadtrees are kept in Morton order: the one of a direction, or of a random number, is found by a bisection between
bounds from a table. Trees are refined in numpy between iterations, in one pass from the roots.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi

SPLIT = 1000.0  # c: a leaf of space is halved from c sqrt(samples a pixel) bounces on
FLUX = 0.01  # rho: a node of directions is divided if it has more of the flux
CELLS = 64  # finest cells of space along an axis
LEVELS = 10  # of quadtrees, at most
START = 4  # levels at first
CODES = 4**LEVELS  # Morton codes of the finest directions
SLOTS = 256  # of the tables from which searches start, for each quadtree
_Numbers = NDArray[Any]


class SDTree:
    """What was learned about one scene; `low` and `high` are the corners of the box that it divides.

    Attributes:
        sums, bounces: flux, and number of bounces of the iteration, by leaf of all quadtrees.
    """

    def __init__(self, low: _Numbers, high: _Numbers) -> None:
        extent = np.maximum(high - low, 1e-6 * max(float((high - low).max()), 1e-6))
        self.low, self.scale = mi.ScalarPoint3f(low), mi.ScalarVector3f(CELLS / extent)
        self.corners, self.halvings = np.zeros((1, 3), np.int64), np.zeros(1, np.int64)  # of leaves of space
        # of leaves of directions: tree * CODES + code, and level
        self.keys = np.arange(4**START) * (CODES >> 2 * START)
        self.depths = np.full(len(self.keys), START)
        self._tabulate(np.zeros(len(self.keys)))

    def tree(self, point: mt.Point3) -> mt.UInt32:
        """The quadtree of points."""
        cell = mi.Vector3u(dr.clip(mi.Vector3i((point - self.low) * self.scale), 0, CELLS - 1))
        return dr.gather(mi.UInt32, self.trees, (cell.x * CELLS + cell.y) * CELLS + cell.z)

    def leaf(self, tree: mt.UInt32, direction: mt.Vector3, active: mt.Mask) -> mt.UInt32:
        """The leaf of unit directions in the world."""
        place = mi.Point2f(dr.atan2(direction.y, direction.x) * (0.5 * dr.inv_pi) + 0.5, 0.5 * direction.z + 0.5)
        cell = mi.Vector2u(dr.clip(mi.Vector2i(place * 2**LEVELS), 0, 2**LEVELS - 1))
        code = _spread(cell.x) | _spread(cell.y) << 1
        return _last(self.by_code, tree * SLOTS + code // (CODES // SLOTS), self.codes, code, active)

    def sample(self, tree: mt.UInt32, choice: mt.Float, point: mt.Point2, active: mt.Mask) -> tuple[Any, mt.Vector3]:
        """The leaf and the direction, by a number and a point of the unit square."""
        slot = dr.minimum(mi.UInt32(choice * SLOTS), SLOTS - 1)
        leaf = _last(self.by_share, tree * SLOTS + slot, self.shares, choice, active)
        word = dr.gather(mi.UInt32, self.places, leaf, active)
        corner = mi.Point2f(mi.Float(word & 0x3FF), mi.Float(word >> 10 & 0x3FF))
        place = (corner + point * mi.Float(word >> 20)) * 2**-LEVELS
        z = 2 * place.y - 1
        radius = dr.safe_sqrt(1 - z * z)
        sine, cosine = dr.sincos(dr.two_pi * (place.x - 0.5))
        return leaf, mi.Vector3f(radius * cosine, radius * sine, z)

    def density(self, leaf: mt.UInt32, active: mt.Mask) -> mt.Float:
        """By which directions of a leaf are sampled, per solid angle."""
        return dr.gather(mi.Float, self.densities, leaf, active)

    def add(self, leaf: mt.UInt32, density: mt.Float, carried: mt.Float, _: mt.Float, active: mt.Mask) -> None:
        """Add the radiance of bounces, which `Records` give: what they carried over weight and density."""
        dr.scatter_reduce(dr.ReduceOp.Add, self.sums, mi.Float64(carried / density), leaf, active)
        dr.scatter_reduce(dr.ReduceOp.Add, self.bounces, mi.UInt32(1), leaf, active)

    def learn(self, spp: int) -> None:
        """Make the trees anew of what was added in an iteration of so many samples a pixel."""
        flux, counts = self.sums.numpy(), self.bounces.numpy()
        trees = np.bincount(self.keys // CODES, counts, len(self.corners))
        source = self._halve(trees, SPLIT * math.sqrt(spp))
        ends, total = np.append(self.keys, CODES * len(trees)), np.append(0, np.cumsum(flux))

        def flux_of(tree: _Numbers, code: _Numbers, depth: _Numbers) -> _Numbers:
            start = source[tree] * CODES + code
            flux: _Numbers = np.interp(start + (CODES >> 2 * depth), ends, total) - np.interp(start, ends, total)
            return flux

        tree = np.arange(len(source))
        code = depth = np.zeros_like(tree)
        whole = own = flux_of(tree, code, depth)
        leaves = []
        while len(tree):
            divided = (own > FLUX * whole[tree]) & (depth < LEVELS)
            leaves.append([part[~divided] for part in (tree * CODES + code, depth, own)])
            depth = np.repeat(depth[divided], 4) + 1
            tree, code = np.repeat(tree[divided], 4), np.repeat(code[divided], 4)
            code = code + np.tile(np.arange(4), len(code) // 4) * (CODES >> 2 * depth)
            own = flux_of(tree, code, depth)
        keys, depths, own = (np.concatenate(parts) for parts in zip(*leaves, strict=True))
        order = np.argsort(keys)
        self.keys, self.depths = keys[order], depths[order]
        self._tabulate(own[order])

    def _halve(self, bounces: _Numbers, most: float) -> _Numbers:
        """Halve leaves of space until none has more bounces; the tree that each was."""
        source = np.arange(len(bounces))
        while (large := (bounces > most) & (self.halvings < 3 * int(math.log2(CELLS)))).any():
            axis = self.halvings[large] % 3
            upper = self.corners[large]
            upper[np.arange(len(axis)), axis] += CELLS >> self.halvings[large] // 3 + 1
            self.halvings[large] += 1
            bounces = np.where(large, bounces / 2, bounces)
            self.corners = np.concatenate([self.corners, upper])
            self.halvings, source, bounces = (
                np.concatenate([each, each[large]]) for each in (self.halvings, source, bounces)
            )
        return source

    def _tabulate(self, flux: _Numbers) -> None:
        """Make the tables, of the flux of leaves."""
        tree, code, area = self.keys // CODES, self.keys % CODES, 4.0**-self.depths
        count = len(self.corners)
        whole = np.bincount(tree, flux, count)[tree]
        share = np.where(whole > 0, flux / np.where(whole > 0, whole, 1), area)
        before = np.cumsum(share) - share
        first = np.searchsorted(tree, np.arange(count))
        shares = np.clip(before - before[first][tree], 0, 1).astype(np.float32)
        slots = np.arange(count * SLOTS + 1)
        self.by_code = _bounds(self.keys, slots * (CODES // SLOTS))
        self.by_share = _bounds(tree + np.minimum(shares.astype(np.float64), 1 - 1e-9), slots / SLOTS)
        self.codes, self.shares = mi.UInt32(code.astype(np.uint32)), mi.Float(shares)
        self.densities = mi.Float((share / area / (4 * math.pi)).astype(np.float32))
        x, y = (sum((code >> 2 * bit + axis & 1) << bit for bit in range(LEVELS)) for axis in range(2))
        self.places = mi.UInt32((x | y << 10 | (2**LEVELS >> self.depths) << 20).astype(np.uint32))
        cells = np.zeros(3 * (CELLS,), np.uint32)
        for number, (corner, halvings) in enumerate(zip(self.corners.tolist(), self.halvings.tolist(), strict=True)):
            box = (slice(at, at + (CELLS >> (halvings + 2 - axis) // 3)) for axis, at in enumerate(corner))
            cells[tuple(box)] = number
        self.trees = mi.UInt32(cells.ravel())
        self.sums, self.bounces = dr.zeros(mi.Float64, len(tree)), dr.zeros(mi.UInt32, len(tree))
        dr.eval(self.sums, self.bounces)


def _bounds(keys: _Numbers, slots: _Numbers) -> mt.UInt32:
    """The leaf of the start of each slot, and the last one that begins before its end, in turn."""
    first = np.searchsorted(keys, slots[:-1], "right") - 1
    last = np.maximum(np.searchsorted(keys, slots[1:], "left") - 1, first)
    return mi.UInt32(np.stack([first, last], 1).ravel().astype(np.uint32))


def _last(bounds: mt.UInt32, slot: mt.UInt32, keys: Any, key: Any, active: mt.Mask) -> mt.UInt32:
    """The last leaf whose key is not above the one given, by bisection between the bounds of its slot."""
    bound = dr.gather(mi.Vector2u, bounds, slot, active)

    def halve(first: mt.UInt32, last: mt.UInt32) -> tuple[mt.UInt32, mt.UInt32]:
        middle = (first + last + 1) >> 1
        after = dr.gather(type(keys), keys, middle) <= key
        return dr.select(after, middle, first), dr.select(after, last, middle - 1)

    return dr.while_loop((bound.x, bound.y), lambda first, last: first < last, halve, label="bisection")[0]


def _spread(bits: mt.UInt32) -> mt.UInt32:
    """The same with a zero between any two of ten bits."""
    for shift, mask in ((8, 0x00FF00FF), (4, 0x0F0F0F0F), (2, 0x33333333), (1, 0x55555555)):
        bits = (bits | bits << shift) & mask
    return bits
