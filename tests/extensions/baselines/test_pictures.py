"""Picture files of maps, and pictures of patches."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Generator, Tensor
from torch.nn.functional import interpolate, normalize

from metapp.appearance.flash import Maps, pack
from metapp.appearance.quilting import beyond_cut
from metapp.apps.svbrdf_nonstationary.maps import FLASH, flash_of, photographed
from metapp.extensions.baselines import svbrdf_nonstationary as codec
from metapp.extensions.baselines.baseline import Allowed, BaselineFit, Training
from metapp.extensions.baselines.svbrdf_nonstationary import baselines, flat_maps, maps_of, sheets
from metapp.extensions.baselines.texture import quilt, random_patches
from metapp.learning.app import App
from metapp.learning.task import Tasks


@pytest.fixture
def smooth_maps(rng: Generator) -> Maps:
    def noise(channels: int) -> Tensor:
        return interpolate(torch.rand(1, channels, 5, 5, generator=rng), size=(32, 32), mode="bicubic").clamp(0.05, 0.9)

    normal = normalize(torch.cat([noise(2) - 0.5, torch.ones(1, 1, 32, 32)], 1), dim=1)
    return Maps(noise(3), noise(3) * 0.2, noise(1), normal)


class Photographed:
    """An application whose fits see the maps."""

    protocol = "reference"


def tasks_of(maps: Maps) -> Tasks:
    return Tasks(("a",), {"maps": pack(Maps(*(each[0] for each in maps)))[None]}, torch.tensor([0]))


def fits(maps: Maps, allowed: Allowed) -> dict[str, BaselineFit]:
    app: App = Photographed()  # type: ignore[assignment]
    prepared = {baseline.name: baseline.prepare(Training(app, []), allowed) for baseline in baselines(app)}
    return {name: each.fit(tasks_of(maps), Generator(), allowed) for name, each in prepared.items()}


def test_maps_come_back_from_their_pictures(smooth_maps: Maps) -> None:
    for found, wanted in zip(maps_of(sheets(smooth_maps)), smooth_maps, strict=True):
        torch.testing.assert_close(found, wanted, atol=1e-5, rtol=1e-4)
    picture = np.random.default_rng(0).random((16, 48, 3)).astype(np.float32)
    assert np.abs(codec.decoded(codec.jpeg(picture * 0 + 0.5, 100)) - 0.5).max() < 0.01
    assert codec.decoded(codec.jpeg(picture[..., :1], 90)).shape == (16, 48, 1)


@pytest.mark.parametrize("size", [2000, 4000, 12_000, 10**6])
def test_the_search_meets_the_budget_of_bytes(smooth_maps: Maps, size: int) -> None:
    found = fits(smooth_maps, Allowed(1, size))
    assert found["jpeg"].size <= size
    assert found["jpeg"].reached
    assert found["jpeg"].numbers is None


def test_the_search_uses_larger_budgets(smooth_maps: Maps) -> None:
    sizes = [{name: each.size for name, each in fits(smooth_maps, Allowed(1, size)).items()} for size in (2500, 5000)]
    assert sizes[0]["jpeg"] < sizes[1]["jpeg"]
    found = fits(smooth_maps, Allowed(1, 1))
    assert not found["jpeg"].reached


# Patches


@pytest.fixture
def exemplar() -> np.ndarray:
    return np.random.default_rng(1).random((32, 32, 3)).astype(np.float32)


@pytest.mark.parametrize("make", [quilt, random_patches])
def test_pictures_are_made_of_the_exemplars_pixels(make: object, exemplar: np.ndarray) -> None:
    found = make(exemplar, np.random.default_rng(0))  # type: ignore[operator]
    assert found.shape == exemplar.shape
    known = {tuple(each) for each in exemplar.reshape(-1, 3)}
    assert {tuple(each) for each in found.reshape(-1, 3)} <= known
    assert not np.array_equal(found, exemplar)
    other = make(exemplar, np.random.default_rng(1))  # type: ignore[operator]
    assert not np.array_equal(found, other)


def test_a_cut_is_the_path_of_least_cost() -> None:
    cost = np.array([[9.0, 1, 9, 9], [9, 9, 1, 9], [9, 1, 9, 9], [1, 9, 9, 9]])
    expected = [[0, 1, 1, 1], [0, 0, 1, 1], [0, 1, 1, 1], [1, 1, 1, 1]]
    assert np.array_equal(beyond_cut(cost), np.array(expected, dtype=bool))


def test_a_flat_matt_material_is_read_from_its_photo(smooth_maps: Maps) -> None:
    """But for the highlight of the F0 that is assumed; a photo at which the flash falls off is not of darker edges."""
    flat = torch.cat([torch.zeros(1, 2, 32, 32), torch.ones(1, 1, 32, 32)], 1)
    matt = smooth_maps._replace(specular=0 * smooth_maps.diffuse, normal=flat)
    found = flat_maps(photographed(matt, flash_of(torch.zeros(1, FLASH))))
    torch.testing.assert_close(found.diffuse, matt.diffuse, atol=1e-3, rtol=0.01)
    assert torch.equal(found.normal, flat)
