"""Baselines of pictures: the cut of quilting, a photo as a flat material, a map of what a mirror ball shows."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from scipy.special import sph_harm_y
from torch import Generator, Tensor
from torch.nn.functional import interpolate

from metapp.appearance.flash import Maps
from metapp.appearance.latlong import directions
from metapp.appearance.quilting import beyond_cut
from metapp.apps.svbrdf_nonstationary.maps import FLASH, flash_of, photographed
from metapp.extensions.baselines.baseline import Allowed
from metapp.extensions.baselines.harmonics import from_harmonics, harmonics, orders
from metapp.extensions.baselines.illumination import shown, spherical, unwrapped
from metapp.extensions.baselines.svbrdf_nonstationary import flat_maps
from metapp.learning.task import Tasks


def test_a_cut_is_the_path_of_least_cost() -> None:
    cost = np.array([[9.0, 1, 9, 9], [9, 9, 1, 9], [9, 1, 9, 9], [1, 9, 9, 9]])
    expected = [[0, 1, 1, 1], [0, 0, 1, 1], [0, 1, 1, 1], [1, 1, 1, 1]]
    assert np.array_equal(beyond_cut(cost), np.array(expected, dtype=bool))


def test_a_flat_matt_material_is_read_from_its_photo(rng: Generator) -> None:
    """But for the highlight of the F0 that is assumed; a photo at which the flash falls off is not of darker edges."""

    def noise(channels: int) -> Tensor:
        return interpolate(torch.rand(1, channels, 5, 5, generator=rng), size=(32, 32), mode="bicubic").clamp(0.05, 0.9)

    flat = torch.cat([torch.zeros(1, 2, 32, 32), torch.ones(1, 1, 32, 32)], 1)
    matt = Maps(noise(3), torch.zeros(1, 3, 32, 32), noise(1), flat)
    found = flat_maps(photographed(matt, flash_of(torch.zeros(1, FLASH))))
    torch.testing.assert_close(found.diffuse, matt.diffuse, atol=1e-3, rtol=0.01)
    assert torch.equal(found.normal, flat)


def test_what_a_mirror_shows_stays_and_what_is_behind_mirrors_it() -> None:
    towards = directions(32, 64)
    lamp = ((torch.einsum("c,chw->hw", torch.tensor([0.6, 0.0, 0.8]), towards) - 1) * 200).exp()
    light = 0.2 + 0.1 * towards[:1] + 40 * lamp * torch.tensor([1.0, 0.5, 0.25])[:, None, None]
    front = (towards[2] > 0).float()
    made = shown({"seen": light[None], "certain": torch.stack([front, 0 * front])[None]})
    torch.testing.assert_close(made[0][:, front > 0], light[:, front > 0])
    torch.testing.assert_close(made, made.flip(-1).roll(32, -1))


def test_a_glossy_sphere_is_refused(rng: Generator) -> None:
    """Nothing is certain in its photograph: what was said before is that the error is not finite."""
    data = {"seen": torch.zeros(1, 3, 8, 16), "certain": torch.zeros(1, 2, 8, 16)}
    tasks = Tasks(("garden",), data, torch.arange(1))
    with pytest.raises(ValueError, match="garden: a photo of a glossy sphere, expected a mirror ball's"):
        unwrapped(tasks, rng, Allowed(1, 1))


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
