"""Baselines of light transport's flow: hierarchical histograms of the samples in primary sample space.

They are of the unit square and of pairs of squares; each level is drawn towards the one above. Cells are halved along
both sides from level to level. The share of a cell in the one above is (n + c p) / (n' + c): n of n' samples are in it,
p is its share before them, c says how many samples p counts for. This is the mean of a Polya tree (Ferguson 1974); that
shares of directions in a place are drawn towards those in the larger place around it, for all places up to the whole
film, makes it hierarchical (Teh et al. 2006, with fixed strengths).
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import logsumexp
from torch import Generator, Tensor

from metapp.appearance.latlong import luminance
from metapp.extensions.baselines.baseline import Allowed, Baseline, BaselineFit, PreparedBaseline, Training
from metapp.learning.app import App
from metapp.learning.task import Tasks

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

CELL = 6  # bytes of an occupied cell: 4 of its place, 2 of its count
FILM, PLACES, DIRECTIONS = 7, 5, 5  # levels of the film's density; of places and of directions there
GRIDS = 8
SCENES, POINTS = 8, 1024  # training scenes and held-out samples of each that strengths are chosen on
SAMPLE = 9  # bytes of one that is kept: 2 a coordinate, 1 that counts how often it was drawn
# log of the film's strength and by how much it grows a level; the same of directions, by places and by directions
FIRST = (4.0, -0.5), (7.0, -1.0, 0.2)


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
        code, deepest = morton(points, last), round(np.log2(len(self.prior)) / 2)
        total, above, share_above = np.zeros(len(points)), self.levels[0].of(np.zeros_like(code)), np.ones(len(points))
        for level in range(1, last + 1):
            here = self.levels[level].of(code >> (2 * (last - level)))
            share = share_above / 4
            if level <= deepest:
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

    def counts_at(self, points: Floats) -> PointCounts:
        """Counts and areas at points [N, 4]: place, then direction."""
        places, directions = len(self.levels) - 1, len(self.levels[0]) - 1
        moved = _moved(points, self.shifts)
        key = _keys(moved, places, directions)
        counts = np.stack([
            np.stack([counts.of(_above(key, places, directions, i, j)) for j, counts in enumerate(of)])
            for i, of in enumerate(self.levels)
        ])  # fmt: skip
        return PointCounts(counts, np.stack([_areas(moved[:, 2:], self.shifts, j) for j in range(directions + 1)]))


class PointCounts(NamedTuple):
    """Counts and areas of the cells around points.

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


class Smoothing(NamedTuple):
    """Logs of strengths, affine in the levels."""

    film: tuple[float, float]
    directions: tuple[float, float, float]


class Densities(NamedTuple):
    """The densities of the film and of the directions on several grids, and the number of samples."""

    film: Square
    directions: tuple[Pair, ...]

    samples: int

    @property
    def kept(self) -> tuple[int, int]:
        """Numbers and bytes that it takes to keep it: the finest cells, or the samples where these are fewer bytes."""
        cells = len(self.film.levels[-1].keys) + sum(len(grid.levels[-1][-1].keys) for grid in self.directions)
        as_cells, as_samples = (2 * cells, CELL * cells), (5 * self.samples, SAMPLE * self.samples)
        return min(as_cells, as_samples, key=lambda kept: kept[1])


class Histograms(NamedTuple):
    """The design of densities.

    Attributes:
        grids: how many are averaged; one is not shifted.
        picture: whether the film's density is drawn towards the small picture of the scene.
    """

    grids: int
    picture: bool

    def prepare(self, training: Training, allowed: Allowed) -> PreparedBaseline:
        """Choose strengths on training scenes."""
        chosen = self._chosen(training.holding("held").stacked, allowed.samples)

        def fit(tasks: Tasks, rng: Generator, allowed: Allowed) -> BaselineFit:
            made = self.made(tasks, rng, allowed.samples)
            return BaselineFit(functools.partial(answer, tasks, made), *made.kept)

        def answer(tasks: Tasks, made: Densities) -> tuple[Tensor, Tensor]:
            points = _held(tasks)
            film = made.film.log_density(points[:, :2], _film(chosen.film))
            directions = _mean([grid.counts_at(points) for grid in made.directions], chosen.directions)
            return torch.from_numpy(film)[None].float(), torch.from_numpy(directions)[None].float()

        return PreparedBaseline(fit, chosen={"smoothing": [[round(x, 3) for x in strengths] for strengths in chosen]})

    def made(self, tasks: Tasks, rng: Generator, count: int) -> Densities:
        """The densities of one scene's samples, as `Transport.sample` draws them."""
        (row,) = tasks.rows.tolist()
        samples = tasks.data["samples"][row]
        drawn = samples[torch.randint(len(samples), (1, count), generator=rng)[0]].double().numpy()
        prior = _prior(tasks.data["image"][row]) if self.picture else None
        film = square(drawn[:, :2], FILM, prior)
        shifts = np.random.default_rng(0).random((self.grids, 4)) if self.grids > 1 else [None]
        several = tuple(pair(drawn, PLACES, DIRECTIONS, shift) for shift in shifts)
        return Densities(film, several, len(np.unique(drawn, axis=0)))

    def _chosen(self, known: Tasks, count: int) -> Smoothing:
        """The strengths of least negative log-likelihood on a few training scenes."""
        scenes = [i * len(known) // min(SCENES, len(known)) for i in range(min(SCENES, len(known)))]
        films, directions = [], []
        for scene in scenes:
            one = known.select([scene])
            made, points = self.made(one, Generator().manual_seed(scene), count), _held(one)[:POINTS]
            films.append((made.film, points[:, :2]))
            directions.append([grid.counts_at(points) for grid in made.directions])

        def film(x: Floats) -> float:
            return -float(np.mean([square.log_density(points, _film(x)) for square, points in films]))

        def direction(x: Floats) -> float:
            return -float(np.mean([_mean(grids, x) for grids in directions]))

        minima = (minimize(f, x, method="Nelder-Mead", options={"maxfev": 100}).x
                 for f, x in zip((film, direction), FIRST, strict=True))  # fmt: skip
        return Smoothing(*(tuple(strengths.tolist()) for strengths in minima))


def baselines(app: App) -> tuple[Baseline, ...]:
    """Of scenes."""
    cannot = "learn more of other scenes than how much to smooth"
    one = "a hierarchical histogram of the samples, quadtrees of directions in a quadtree of places"
    many = f"the mean of {GRIDS} such on shifted grids, the film's drawn towards the picture that General reads"
    return (
        Baseline("histogram", one, cannot, Histograms(1, False).prepare),
        Baseline(f"histogram_{GRIDS}", many, cannot, Histograms(GRIDS, True).prepare),
    )


def _held(tasks: Tasks) -> Floats:
    """The held-out samples [N, 4] of the one scene; none where it has none, which is then not judged."""
    if "held" not in tasks.data:
        return np.zeros((0, 4))
    (row,) = tasks.rows.tolist()
    return tasks.data["held"][row].double().numpy()


def _prior(image: Tensor) -> Floats:
    """The luminance of a picture [3, S, S], S a power of two, as shares of cells in Morton order."""
    light = luminance(image.double()).numpy()
    side = len(light)
    centres = (np.arange(side) + 0.5) / side
    places = np.stack([np.tile(centres, side), np.repeat(centres, side)], 1)  # x across, y down
    shares: Floats = np.empty(side * side)
    shares[morton(places, round(np.log2(side)))] = light.ravel() + 1e-6 * light.mean()
    shares /= shares.sum()
    return shares


def _film(smoothing: Floats | tuple[float, ...]) -> Floats:
    first, slope = smoothing
    return np.asarray(np.exp(first + slope * np.arange(FILM)))


def _mean(grids: list[PointCounts], smoothing: Floats | tuple[float, ...]) -> Floats:
    """The log of the mean density of several grids."""
    first, by_place, by_direction = smoothing
    levels = first + by_place * np.arange(PLACES + 1)[:, None] + by_direction * np.arange(DIRECTIONS)
    densities = [counts.log_density(np.exp(levels)) for counts in grids]
    return np.asarray(logsumexp(densities, axis=0) - np.log(len(grids)))
