"""Hierarchical histograms: densities that integrate to 1 and come nearer to the true one with more samples."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from metapp.extensions.baselines.transport import (
    DIRECTIONS,
    FIRST,
    GRIDS,
    PLACES,
    Counts,
    Densities,
    Histograms,
    _above,
    _areas,
    _film,
    _keys,
    _mean,
    _moved,
    _prior,
    baselines,
    counted,
    morton,
    pair,
    square,
)
from metapp.learning.task import Tasks
from tests.quick import app_by


@pytest.fixture
def numbers() -> np.random.Generator:
    return np.random.default_rng(0)


def peaked(numbers: np.random.Generator, count: int) -> np.ndarray:
    """Places that are denser to the left, and directions that depend on them."""
    film = numbers.random((count, 2)) ** [2, 1]
    directions = (0.3 * numbers.random((count, 2)) + 0.7 * film) % 1
    return np.concatenate([film, directions], 1)


def grid(side: int) -> np.ndarray:
    """The middles of cells of the unit square, [side^2, 2]."""
    middles = (np.arange(side) + 0.5) / side
    return np.stack([np.tile(middles, side), np.repeat(middles, side)], 1)


def test_cells_nest_and_coarser_counts_are_sums(numbers: np.random.Generator) -> None:
    points = grid(32)
    fine, coarse = morton(points, 4), morton(points, 2)
    assert np.array_equal(fine >> 4, coarse)
    assert len(np.unique(fine)) == 256
    points = numbers.random((1000, 2))
    found, expected = counted(morton(points, 5)).coarser(3), counted(morton(points, 2))
    assert np.array_equal(found.keys, expected.keys)
    assert np.array_equal(found.counts, expected.counts)
    assert Counts(np.array([2, 5]), np.array([7, 9])).of(np.array([1, 2, 5, 8])).tolist() == [0, 7, 9, 0]


@pytest.mark.parametrize("with_prior", [False, True])
def test_a_film_histogram_integrates_to_1(numbers: np.random.Generator, with_prior: bool) -> None:
    prior = numbers.random(16) if with_prior else None
    prior = prior / prior.sum() if prior is not None else None
    found = square(peaked(numbers, 300)[:, :2], 4, prior)
    density = np.exp(found.log_density(grid(16), np.array([5.0, 3, 2, 1])))
    assert density.mean() == pytest.approx(1)
    assert density.std() > 0.3


@pytest.mark.parametrize("shifted", [False, True])
def test_directions_integrate_to_1_in_every_place(numbers: np.random.Generator, shifted: bool) -> None:
    """Cells of a shifted grid do not lie on a grid of 1/64 unless its shifts do."""
    shifts = numbers.integers(0, 16, 4) / 16 if shifted else None
    found = pair(peaked(numbers, 2000), 3, 4, shifts)
    directions = grid(64)
    for place in ([0.1, 0.2], [0.7, 0.55], [0.99, 0.01]):
        points = np.concatenate([np.tile(place, (len(directions), 1)), directions], 1)
        density = np.exp(found.counts_at(points).log_density(np.full((4, 4), 4.0)))
        assert density.mean() == pytest.approx(1)
        assert density.std() > 0.3


def test_strength_leads_from_the_samples_to_uniform_or_the_prior(numbers: np.random.Generator) -> None:
    points = peaked(numbers, 5000)[:, :2]
    found = square(points, 1)
    density = np.exp(found.log_density(grid(2), np.array([1e-12])))
    shares = np.array([((points * 2).astype(int) == cell).all(1).mean() for cell in ([0, 0], [1, 0], [0, 1], [1, 1])])
    np.testing.assert_allclose(density, 4 * shares, rtol=1e-9)
    points = peaked(numbers, 500)  # endless strength
    assert np.allclose(square(points[:, :2], 3).log_density(grid(8), np.full(3, 1e12)), 0, atol=1e-6)
    assert np.allclose(pair(points, 2, 3).counts_at(points).log_density(np.full((3, 3), 1e12)), 0, atol=1e-6)
    image = torch.rand(3, 4, 4, generator=torch.Generator().manual_seed(0))
    drawn_to = square(points[:, :2], 3, _prior(image)).log_density(grid(4), np.full(3, 1e12))
    light = np.einsum("chw,c->hw", image.numpy(), [0.2126, 0.7152, 0.0722]).ravel()  # rows down are y, as of samples
    np.testing.assert_allclose(np.exp(drawn_to), 16 * light / light.sum(), rtol=1e-4)


def _scene(numbers: np.random.Generator) -> Tasks:
    samples, held = (torch.from_numpy(peaked(numbers, count)).float()[None] for count in (3000, 500))
    image = torch.ones(1, 3, 32, 32)
    return Tasks(("s",), {"samples": samples, "held": held, "image": image}, torch.tensor([0]))


def test_samples_are_those_of_the_application_and_the_lesser_of_cells_and_samples_is_kept(
    numbers: np.random.Generator,
) -> None:
    scene = _scene(numbers)
    made = Histograms(1, False).made(scene, torch.Generator().manual_seed(4), 512)
    batch = app_by("transport").sample(scene, torch.Generator().manual_seed(4), 512)["points"][0].T.double().numpy()
    assert np.array_equal(made.film.levels[-1].keys, counted(morton(batch[:, :2], 7)).keys)
    assert made.samples == len(np.unique(batch, axis=0))
    rng = torch.Generator().manual_seed(4)
    one, many = (Histograms(grids, False).made(scene, rng, 2000) for grids in (1, GRIDS))
    assert many.kept == (5 * many.samples, 9 * many.samples)
    crowded = Densities(one.film, one.directions, 10**6)
    cells = len(one.film.levels[-1].keys) + len(one.directions[0].levels[-1][-1].keys)
    assert crowded.kept == (2 * cells, 6 * cells)


def test_strengths_are_of_the_levels_they_are_said_to_be_of(numbers: np.random.Generator) -> None:
    """An endless one leaves a level as even as the one above, one of almost nothing the samples' own shares."""
    points = peaked(numbers, 5000)[:, :2]
    found, free, held = square(points, 2), 1e-9, 1e12
    cells = grid(4)
    fine = np.exp(found.log_density(cells, np.array([free, free])))
    coarse = np.exp(found.log_density(cells, np.array([free, held])))
    within = np.exp(found.log_density(cells, np.array([held, free])))
    np.testing.assert_allclose(coarse, np.exp(square(points, 1).log_density(cells, np.array([free]))), rtol=1e-6)
    np.testing.assert_allclose(coarse * within, fine, rtol=1e-6)
    everywhere = pair(np.concatenate([points, points[::-1]], 1), 0, 3).counts_at(np.concatenate([cells, cells], 1))
    shares = [np.exp(everywhere.log_density(np.array([each]))) for each in np.where(np.eye(3), free, held)]
    np.testing.assert_allclose(
        np.prod(shares, axis=0), np.exp(everywhere.log_density(np.full((1, 3), free))), rtol=1e-6
    )


def test_places_lead_down_from_the_whole_film(numbers: np.random.Generator) -> None:
    """Endless strengths in all places but the whole leave what is known of all samples together."""
    points = peaked(numbers, 3000)
    whole = pair(points, 0, 3).counts_at(points).log_density(np.full((1, 3), 4.0))
    strengths = np.concatenate([np.full((1, 3), 4.0), np.full((2, 3), 1e12)])
    np.testing.assert_allclose(pair(points, 2, 3).counts_at(points).log_density(strengths), whole, rtol=1e-6, atol=1e-6)


def test_cells_above_are_those_of_coarser_points(numbers: np.random.Generator) -> None:
    points, places, directions = numbers.random((500, 4)), 3, 4
    key = _keys(points, places, directions)
    for i in range(places + 1):
        for j in range(directions + 1):
            expected = (morton(points[:, :2], i) << (2 * j)) | morton(points[:, 2:], j)
            assert np.array_equal(_above(key, places, directions, i, j), expected), (i, j)


@pytest.mark.parametrize("level", [0, 1, 2, 3])
def test_areas_of_shifted_cells_are_how_much_of_the_square_they_hold(numbers: np.random.Generator, level: int) -> None:
    points = np.concatenate([np.zeros((400**2, 2)), grid(400)], 1)
    for shifts in (None, np.zeros(4), numbers.random(4)):
        moved = _moved(points, shifts)[:, 2:]
        _, cells, counts = np.unique(morton(moved, level), return_inverse=True, return_counts=True)
        areas = _areas(moved, shifts, level)
        np.testing.assert_allclose(areas, counts[cells] / 400**2, atol=0.01)
        assert (1 / areas).mean() == pytest.approx(len(counts), rel=0.1)


def test_strengths_grow_by_the_same_factor_from_level_to_level(numbers: np.random.Generator) -> None:
    film = _film((2.0, -0.5))
    assert film[0] == pytest.approx(np.exp(2))
    np.testing.assert_allclose(film[1:] / film[:-1], np.exp(-0.5))
    points, first, by_place, by_direction = peaked(numbers, 500), 3.0, -1.0, 0.4
    counts = pair(points, PLACES, DIRECTIONS).counts_at(points[:50])
    levels = np.array([[first + by_place * i + by_direction * j for j in range(DIRECTIONS)] for i in range(PLACES + 1)])
    alone = counts.log_density(np.exp(levels))
    for several in ([counts], [counts, counts]):  # the mean of what is the same
        np.testing.assert_allclose(_mean(several, (first, by_place, by_direction)), alone, rtol=1e-9, atol=1e-9)


def test_a_picture_is_a_prior_whatever_its_exposure_and_nowhere_0(numbers: np.random.Generator) -> None:
    image = torch.from_numpy(numbers.random((3, 4, 4)))
    image[:, 1, 2] = 0
    prior = _prior(image)
    assert prior.sum() == pytest.approx(1)
    np.testing.assert_allclose(_prior(1000 * image), prior, rtol=1e-9)
    assert 0 < prior.min() < 1e-5 * prior.mean()


def test_strengths_are_chosen_where_held_out_samples_are_likeliest(
    numbers: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On scenes that are spread over all: the choice is better than where the search begins."""
    samples, held = (torch.from_numpy(peaked(numbers, count)).float().expand(16, -1, -1) for count in (3000, 500))
    known = Tasks(tuple("abcdefghijklmnop"), {"samples": samples, "held": held}, torch.arange(16))
    rows, original = [], Histograms.made

    def made(self: Histograms, tasks: Tasks, rng: torch.Generator, count: int) -> Densities:
        rows.append(tasks.rows.tolist())
        return original(self, tasks, rng, count)

    monkeypatch.setattr(Histograms, "made", made)
    method = Histograms(1, False)
    chosen = method._chosen(known, 300)
    assert rows == [[row] for row in range(0, 16, 2)]
    found, points = method.made(known.select([4]), torch.Generator().manual_seed(4), 300), held[0].double().numpy()
    film, first = (found.film.log_density(points[:, :2], _film(x)).mean() for x in (chosen.film, FIRST[0]))
    assert film > first
    looked = [found.directions[0].counts_at(points)]
    assert _mean(looked, chosen.directions).mean() > _mean(looked, FIRST[1]).mean()


def test_only_the_mean_of_grids_looks_at_the_picture(numbers: np.random.Generator) -> None:
    """Its density of the film lies between that of the samples alone and that of the picture."""
    app, scene = app_by("transport"), _scene(numbers)
    dark = scene.data["image"].clone()
    dark[..., :16] = 0.01
    other = Tasks(scene.names, scene.data | {"image": dark}, scene.rows)
    for baseline in baselines(app):
        made = [baseline.prepare.__self__.made(each, torch.Generator().manual_seed(0), 64) for each in (scene, other)]  # type: ignore[attr-defined]
        films = [each.film.log_density(grid(8), _film((4.0, 0.0))) for each in made]
        assert np.array_equal(*films) == (baseline.name == "histogram")
        assert len(made[0].directions) == (1 if baseline.name == "histogram" else GRIDS)
