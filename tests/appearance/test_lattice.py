"""Lattices of pictures, and how much of their order another picture keeps."""

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from metapp.appearance import lattice
from metapp.appearance.quilting import PHASE_TOLERANCE_PX, quilt

SIZE = 128
Vectors = tuple[tuple[float, float], tuple[float, float]]


def periodic(vectors: Vectors, generator: torch.Generator, offset: tuple[float, float] = (0.0, 0.0)) -> Tensor:
    """A picture [3, SIZE, SIZE] that repeats by these vectors: random waves on their lattice, and noise."""
    basis = torch.linalg.inv(torch.tensor(vectors, dtype=torch.float64)).T
    y, x = torch.meshgrid(torch.arange(SIZE) + offset[0], torch.arange(SIZE) + offset[1], indexing="ij")
    picture = torch.full((3, SIZE, SIZE), 0.5, dtype=torch.float64)
    waves = torch.Generator().manual_seed(9)
    for i, j in ((0, 1), (1, 0), (1, 1), (1, -1), (2, 1), (1, 2), (0, 2)):
        frequency = i * basis[0] + j * basis[1]
        phase = 2 * math.pi * (frequency[0] * y + frequency[1] * x + torch.rand((), generator=waves))
        picture += 0.1 * torch.randn(3, 1, 1, generator=waves) * phase.cos()
    return picture + 0.03 * torch.randn(picture.shape, generator=generator)


@pytest.mark.parametrize(
    "vectors",
    [
        ((16.0, 0.0), (0.0, 21.0)),
        ((11.0, 14.0), (-12.0, 13.0)),
        ((17.3, 3.1), (2.2, 24.6)),
        ((9.0, 15.0), (9.0, -15.0)),
    ],
)
def test_lattice_of_a_periodic_picture_is_found(vectors: Vectors) -> None:
    found = lattice.find_lattice(periodic(vectors, torch.Generator().manual_seed(3)))
    assert found.score > 0.4
    known = torch.tensor(vectors, dtype=torch.float64)
    times = torch.linalg.solve(known.T, found.vectors.T)  # whole numbers of periods
    assert float((times - times.round()).abs().max()) < 0.06
    assert abs(float(torch.linalg.det(times.round()))) == pytest.approx(1)


def test_pictures_without_order_have_none() -> None:
    generator = torch.Generator().manual_seed(0)
    for blurred in (0, 3, 9):
        noise = torch.rand(3, SIZE, SIZE, generator=generator)
        noise = torch.nn.functional.avg_pool2d(noise, 2 * blurred + 1, 1, blurred, count_include_pad=False)
        assert lattice.find_lattice(noise).score < lattice.MIN_LATTICE_SCORE
    assert lattice.find_lattice(torch.full((3, SIZE, SIZE), 0.4)).score < 0


def test_order_kept_is_one_for_as_much_order_and_none_for_noise() -> None:
    generator = torch.Generator().manual_seed(5)
    vectors = ((16.0, 0.0), (5.0, 21.0))
    exemplar = lattice.find_lattice(periodic(vectors, generator))
    assert lattice.kept_order_share(exemplar, periodic(vectors, generator, (7.3, 14.6))) == pytest.approx(1, abs=0.1)
    assert lattice.kept_order_share(exemplar, torch.rand(3, SIZE, SIZE, generator=generator)) < 0.15
    half = (periodic(vectors, generator) + torch.rand(3, SIZE, SIZE, generator=generator)) / 2
    assert 0.15 < lattice.kept_order_share(exemplar, half) < 0.9
    nothing = lattice.find_lattice(torch.rand(3, SIZE, SIZE, generator=generator))
    assert math.isnan(lattice.kept_order_share(nothing, periodic(vectors, generator)))
    for side in range(4, SIZE, 12):  # pictures that are smaller than the lattice tell nothing, and are no error
        share = lattice.kept_order_share(exemplar, periodic(vectors, generator)[:, :side, :side])
        assert math.isnan(share) or share >= 0
    assert math.isnan(lattice.kept_order_share(exemplar, torch.rand(3, 12, 12, generator=generator)))


def test_flattened_photos_have_one_brightness() -> None:
    ramp = torch.linspace(0.2, 0.8, SIZE).expand(3, SIZE, SIZE)
    flat = lattice.even_out_brightness(ramp)
    assert float(flat[..., 32:-32].std()) < 0.02 < float(ramp[..., 32:-32].std())
    assert float(flat.mean()) == pytest.approx(0.5, abs=0.03)


def test_removing_shading_removes_slow_changes_alone() -> None:
    y, x = torch.meshgrid(torch.linspace(-1, 1, SIZE), torch.linspace(-1, 1, SIZE), indexing="ij")
    slow = torch.stack([0.2 * x, 0.1 * y * y - 0.1 * x, 0.3 * x * y])
    waves = torch.sin(2 * math.pi * torch.arange(SIZE) / 8).expand(3, SIZE, SIZE)
    torch.testing.assert_close(
        lattice.remove_quadratic_trend(0.5 + slow + waves),
        lattice.remove_quadratic_trend(0.5 + waves) + slow.mean((1, 2))[:, None, None],
        atol=1e-5,
        rtol=0,
    )
    torch.testing.assert_close(lattice.remove_quadratic_trend(waves), waves, atol=0.1, rtol=0)
    assert float(lattice.remove_quadratic_trend(0.5 + slow).std((1, 2)).max()) < 1e-5


def test_a_slope_without_peaks_ends_the_search_of_a_vector() -> None:
    """A correlation that falls off evenly from shift 0 has no peak at any multiple; the search ends all the same."""
    y, x = torch.meshgrid(torch.arange(-SIZE, SIZE), torch.arange(-SIZE, SIZE), indexing="ij")
    cone = torch.exp(-(y * y + x * x).double().sqrt() / 100)
    vector = lattice._refine_vector(cone, 0, 8)
    assert float((vector - torch.tensor([0.0, 8.0])).abs().max()) <= lattice.MAX_PEAK_SHIFT_PX


# Image quilting


def waves(size: int = 48, period: int = 8) -> np.ndarray:
    """A picture [size, size, 3] that repeats every `period` px."""
    at = np.arange(size) * (2 * np.pi / period)
    wave = 0.5 + 0.25 * np.sin(at)[:, None] + 0.25 * np.cos(at)
    return np.stack([wave, 1 - wave, 0.3 + 0.4 * wave], 2).astype(np.float32)


def steepest(picture: np.ndarray) -> float:
    """The greatest step between neighbours, across the edges too."""
    return max(float(np.abs(np.roll(picture, 1, axis) - picture).max()) for axis in (0, 1))


@pytest.mark.parametrize("tiles", [False, True])
def test_a_picture_is_made_of_pixels_of_the_exemplar(tiles: bool) -> None:
    exemplar = np.random.default_rng(1).random((20, 24, 3)).astype(np.float32)
    picture = quilt(exemplar, (33, 41), np.random.default_rng(0), block=8, overlap=2, tiles=tiles)
    assert picture.shape == (33, 41, 3)
    assert picture.dtype == np.float32
    assert {*map(tuple, picture.reshape(-1, 3).tolist())} <= {*map(tuple, exemplar.reshape(-1, 3).tolist())}


@pytest.mark.parametrize("size", [(48, 48), (64, 32), (40, 56)])
def test_periodic_exemplars_are_quilted_without_seams(size: tuple[int, int]) -> None:
    """Sizes that the period divides have no seams, nor have edges where the result tiles."""
    exemplar = waves()
    picture = quilt(exemplar, size, np.random.default_rng(0), block=12, overlap=4, tiles=True)
    assert steepest(picture) <= 1.01 * steepest(exemplar)


def test_blocks_are_in_phase_with_the_lattice() -> None:
    """Blocks are taken at whole periods from the first one, within PHASE_PX; the exemplar's values are positions."""
    side, period = 48, 8.0
    places = np.stack([*np.indices((side, side)), np.zeros((side, side))], 2).astype(float)
    frequencies = np.array([[1 / period, 0.0], [0.0, 1 / period]])
    picture = quilt(places, (64, 64), np.random.default_rng(0), block=16, overlap=4, frequencies=frequencies)
    shifts = picture[..., :2] - places_of(64)
    beside = (shifts - shifts[0, 0]) / period
    assert float(np.hypot(*np.moveaxis(beside - beside.round(), 2, 0)).max()) * period <= PHASE_TOLERANCE_PX
    free = quilt(places, (64, 64), np.random.default_rng(0), block=16, overlap=4)[..., :2] - places_of(64)
    beside = (free - free[0, 0]) / period
    assert float(np.hypot(*np.moveaxis(beside - beside.round(), 2, 0)).max()) * period > PHASE_TOLERANCE_PX


def places_of(side: int) -> np.ndarray:
    """The place of each px, [side, side, 2]."""
    return np.moveaxis(np.indices((side, side)), 0, 2)
