"""Orthonormal transforms, what is kept of them, and baselines of maps."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.fft import dctn
from scipy.special import sph_harm_y

from metapp.extensions.baselines.harmonics import from_harmonics, harmonics, orders
from metapp.extensions.baselines.illumination import COSINES, HAAR, _harmonics, _orders, _texels, haar, largest
from metapp.learning.task import Tasks


@pytest.fixture
def numbers() -> np.random.Generator:
    return np.random.default_rng(0)


def test_haar_of_a_constant_is_one_number_and_of_a_step_two() -> None:
    picture = np.full((1, 8, 8), 3.0)
    assert np.count_nonzero(np.abs(haar(picture)) > 1e-12) == 1
    assert haar(picture)[0, 0, 0] == pytest.approx(3 * 8)
    picture[:, :, 4:] = 1
    assert np.count_nonzero(np.abs(haar(picture)) > 1e-12) == 2
    with pytest.raises(ValueError, match="powers of two"):
        haar(np.zeros((1, 24, 64)))


@pytest.mark.parametrize("shape", [(3, 32, 64), (1, 16, 16), (2, 1, 8), (1, 64, 4)])
@pytest.mark.parametrize("transform", [HAAR, COSINES])
def test_transforms_have_an_inverse_and_keep_energy(
    transform: object, shape: tuple[int, ...], numbers: np.random.Generator
) -> None:
    pictures = numbers.normal(size=shape)
    found = transform.forward(pictures)  # type: ignore[attr-defined]
    assert (found**2).sum() == pytest.approx((pictures**2).sum())
    np.testing.assert_allclose(transform.inverse(found), pictures, atol=1e-12)  # type: ignore[attr-defined]


def test_the_largest_coefficients_are_the_best_so_many(numbers: np.random.Generator) -> None:
    pictures = numbers.normal(size=(3, 16, 16))
    found = dctn(pictures, axes=(-2, -1), norm="ortho")
    energy = np.sort((found**2).sum(0).ravel())[::-1]
    for count in (1, 10, 200):
        kept = largest(found, count)
        lost = ((found - kept.coefficients()) ** 2).sum()
        assert lost == pytest.approx(energy[count:].sum(), rel=1e-3)
        assert kept.numbers == 4 * count  # three values and a place


def test_bytes_are_of_halves_and_places_and_suns_are_kept() -> None:
    few, many = (largest(np.ones((3, 32, 64)), count) for count in (10, 2000))
    assert few.size == 4 + 10 * (3 * 2 + 2)
    assert many.size == 4 + 2000 * 3 * 2 + 32 * 64 // 8  # a bit each is less than a list of places
    assert largest(np.zeros((1, 4, 4)), 3).coefficients().any() == False  # noqa: E712  (numpy's own)
    bright = np.zeros((1, 4, 4))
    bright[0, 1, 2] = 1e9
    np.testing.assert_allclose(largest(bright, 2).coefficients(), bright)


def basis_of(order: int, height: int, width: int) -> np.ndarray:
    """Real spherical harmonics at the texels' centres of a lat-long map, [(order + 1)^2, H, W], by definition."""
    theta = ((np.arange(height) + 0.5) * (math.pi / height))[:, None]
    phi = (np.arange(width) + 0.5) * (math.tau / width)
    found = []
    for degree in range(order + 1):
        found.append(sph_harm_y(degree, 0, theta, phi).real)
        for m in range(1, degree + 1):
            complex_one = math.sqrt(2) * sph_harm_y(degree, m, theta, phi)
            found += [complex_one.real, complex_one.imag]
    return np.stack(found)


@pytest.mark.parametrize(("height", "width"), [(8, 16), (9, 18), (9, 12), (5, 31), (7, 11)])
def test_harmonics_are_those_of_weighted_least_squares(height: int, width: int, numbers: np.random.Generator) -> None:
    maps = numbers.normal(size=(3, height, width))
    root = np.sqrt(np.sin((np.arange(height) + 0.5) * (math.pi / height)))[:, None]
    for order in range(orders(height, width)):
        basis = basis_of(order, height, width)
        a, b = ((root * each).reshape(len(each), -1).T for each in (basis, maps))
        wanted = np.linalg.lstsq(a, b, rcond=None)[0].T
        found = harmonics(maps, order)
        np.testing.assert_allclose(found, wanted, atol=1e-13)
        made = from_harmonics(found, height, width)
        np.testing.assert_allclose(made, np.tensordot(found, basis, 1), atol=1e-13)


@pytest.mark.parametrize(("height", "width", "count"), [(8, 16, 8), (9, 12, 6), (4, 64, 4), (1, 1, 1)])
def test_texels_tell_so_many_orders_apart(height: int, width: int, count: int) -> None:
    assert orders(height, width) == count
    for order in (count - 1, count):
        columns = basis_of(order, height, width).reshape((order + 1) ** 2, -1)
        assert (np.linalg.matrix_rank(columns) == len(columns)) == (order < count)
    with pytest.raises(ValueError, match=f"order {count} .* at most {count - 1}"):
        harmonics(np.zeros((1, height, width)), count)
    with pytest.raises(ValueError, match=f"order {count} .* at most {count - 1}"):
        from_harmonics(np.zeros((1, (count + 1) ** 2)), height, width)


def _task(radiance: np.ndarray) -> Tasks:
    return Tasks(("m",), {"map": torch.from_numpy(radiance).float()[None]}, torch.tensor([0]))


def test_more_coefficients_come_nearer_until_the_map_itself(numbers: np.random.Generator) -> None:
    radiance = np.exp(numbers.normal(size=(3, 16, 32)))
    tasks, wanted = _task(radiance), torch.from_numpy(radiance).float()
    for encode, rungs in ((HAAR.encode, _texels), (COSINES.encode, _texels), (_harmonics, _orders)):
        count = rungs(tasks)
        fitted = [encode(tasks, rung) for rung in (0, count // 4, count - 1)]
        errors = [(each.answer()[0] - wanted).square().mean().item() for each in fitted]
        assert errors[0] > errors[1] > errors[2]
        assert [each.size for each in fitted] == sorted(each.size for each in fitted)
        if encode is not _harmonics:
            assert errors[2] < 1e-5
