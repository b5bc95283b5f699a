"""Baselines of light transport's flow: hierarchical histograms of the samples in primary sample space."""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
import torch
from scipy.optimize import minimize
from scipy.special import logsumexp
from torch import Generator, Tensor

from metapp.appearance.latlong import luminance
from metapp.baselines.baseline import Allowed, Baseline, Fitted, Prepared, Training
from metapp.baselines.methods.histogram import CELL, Floats, Looked, Pair, Square, morton, pair, square
from metapp.learning.app import App
from metapp.learning.task import Tasks

FILM, PLACES, DIRECTIONS = 7, 5, 5  # levels of the film's density; of places and of directions there
GRIDS = 8
SCENES, POINTS = 8, 1024  # training scenes and held-out samples of each that strengths are chosen on
SAMPLE = 9  # bytes of one that is kept: 2 a coordinate, 1 that counts how often it was drawn
# log of the film's strength and by how much it grows a level; the same of directions, by places and by directions
FIRST = (4.0, -0.5), (7.0, -1.0, 0.2)


class Smoothing(NamedTuple):
    """Logs of strengths, affine in the levels."""

    film: tuple[float, float]
    directions: tuple[float, float, float]


class Densities(NamedTuple):
    """What is fitted: the film's density, those of the directions on several grids, and of how many samples."""

    film: Square
    directions: tuple[Pair, ...]

    samples: int

    @property
    def kept(self) -> tuple[int, int]:
        """Numbers and bytes that it takes to keep it: the finest cells, or the samples where these are fewer bytes."""
        cells = len(self.film.levels[-1].keys) + sum(len(each.levels[-1][-1].keys) for each in self.directions)
        as_cells, as_samples = (2 * cells, CELL * cells), (5 * self.samples, SAMPLE * self.samples)
        return min(as_cells, as_samples, key=lambda kept: kept[1])


class Histograms(NamedTuple):
    """How densities are made.

    Attributes:
        grids: how many are averaged; one is not shifted.
        picture: whether the film's density is drawn towards the small picture of the scene.
    """

    grids: int
    picture: bool

    def prepare(self, training: Training, allowed: Allowed) -> Prepared:
        """Choose strengths on training scenes."""
        chosen = self._chosen(training.holding("held").stacked, allowed.samples)

        def fit(tasks: Tasks, rng: Generator, allowed: Allowed) -> Fitted:
            made = self.made(tasks, rng, allowed.samples)
            return Fitted(functools.partial(answer, tasks, made), *made.kept)

        def answer(tasks: Tasks, made: Densities) -> tuple[Tensor, Tensor]:
            points = _held(tasks)
            film = made.film.log_density(points[:, :2], _film(chosen.film))
            directions = _mean([each.look(points) for each in made.directions], chosen.directions)
            return torch.from_numpy(film)[None].float(), torch.from_numpy(directions)[None].float()

        return Prepared(fit, chosen={"smoothing": [[round(x, 3) for x in each] for each in chosen]})

    def made(self, tasks: Tasks, rng: Generator, count: int) -> Densities:
        """The densities of one scene's samples, as `Transport.sample` draws them."""
        (row,) = tasks.rows.tolist()
        samples = tasks.data["samples"][row]
        drawn = samples[torch.randint(len(samples), (1, count), generator=rng)[0]].double().numpy()
        prior = _prior(tasks.data["image"][row]) if self.picture else None
        film = square(drawn[:, :2], FILM, prior)
        shifts = np.random.default_rng(0).random((self.grids, 4)) if self.grids > 1 else [None]
        several = tuple(pair(drawn, PLACES, DIRECTIONS, each) for each in shifts)
        return Densities(film, several, len(np.unique(drawn, axis=0)))

    def _chosen(self, known: Tasks, count: int) -> Smoothing:
        """The strengths of least negative log-likelihood on a few training scenes."""
        scenes = [i * len(known) // min(SCENES, len(known)) for i in range(min(SCENES, len(known)))]
        films, directions = [], []
        for scene in scenes:
            one = known.select([scene])
            made, points = self.made(one, Generator().manual_seed(scene), count), _held(one)[:POINTS]
            films.append((made.film, points[:, :2]))
            directions.append([each.look(points) for each in made.directions])

        def film(x: Floats) -> float:
            return -float(np.mean([each.log_density(points, _film(x)) for each, points in films]))

        def direction(x: Floats) -> float:
            return -float(np.mean([_mean(each, x) for each in directions]))

        found = (minimize(f, x, method="Nelder-Mead", options={"maxfev": 100}).x
                 for f, x in zip((film, direction), FIRST, strict=True))  # fmt: skip
        return Smoothing(*(tuple(each.tolist()) for each in found))


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


def _mean(looked: list[Looked], smoothing: Floats | tuple[float, ...]) -> Floats:
    """The log of the mean density of several grids."""
    first, by_place, by_direction = smoothing
    levels = first + by_place * np.arange(PLACES + 1)[:, None] + by_direction * np.arange(DIRECTIONS)
    densities = [counts.log_density(np.exp(levels)) for counts in looked]
    return np.asarray(logsumexp(densities, axis=0) - np.log(len(looked)))
