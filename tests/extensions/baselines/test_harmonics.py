"""Spherical harmonics of maps."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.special import sph_harm_y
from torch import Generator

from metapp.extensions.baselines.baseline import Allowed
from metapp.extensions.baselines.harmonics import from_harmonics, harmonics, orders
from metapp.extensions.baselines.illumination import spherical
from metapp.learning.task import Tasks


@pytest.fixture
def numbers() -> np.random.Generator:
    return np.random.default_rng(0)


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


def _task(radiance: np.ndarray) -> Tasks:
    return Tasks(("m",), {"map": torch.from_numpy(radiance).float()[None]}, torch.tensor([0]))


def test_more_bytes_come_nearer_until_the_map_itself(numbers: np.random.Generator, rng: Generator) -> None:
    radiance = np.exp(numbers.normal(size=(3, 16, 32)))
    tasks, wanted = _task(radiance), torch.from_numpy(radiance).float()
    sizes = (1, 10, 100, 400, 10**6)
    fitted = [spherical(tasks, rng, Allowed(1, size)) for size in sizes]
    errors = [(each.answer()[0] - wanted).square().mean().item() for each in fitted]  # type: ignore[index]
    assert errors[0] == errors[1] > errors[2] > errors[3] > errors[4]
    assert [each.numbers for each in fitted] == [3, 3, 48, 192, 768]  # of orders 0, 0, 3, 7, 15
    assert all(each.size == 4 + 2 * each.numbers for each in fitted)
    assert all(each.size <= size for each, size in zip(fitted[1:], sizes[1:], strict=True))
