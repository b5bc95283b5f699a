"""Pictures of pieces of a photo, and a photo as a flat material."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Generator, Tensor
from torch.nn.functional import interpolate, normalize

from metapp.appearance.flash import Maps
from metapp.appearance.quilting import beyond_cut
from metapp.apps.svbrdf_nonstationary.maps import FLASH, flash_of, photographed
from metapp.extensions.baselines.svbrdf_nonstationary import flat_maps
from metapp.extensions.baselines.texture import quilts
from metapp.networks.exemplar import JUDGED


@pytest.fixture
def smooth_maps(rng: Generator) -> Maps:
    def noise(channels: int) -> Tensor:
        return interpolate(torch.rand(1, channels, 5, 5, generator=rng), size=(32, 32), mode="bicubic").clamp(0.05, 0.9)

    normal = normalize(torch.cat([noise(2) - 0.5, torch.ones(1, 1, 32, 32)], 1), dim=1)
    return Maps(noise(3), noise(3) * 0.2, noise(1), normal)


@pytest.fixture
def exemplar() -> Tensor:
    return torch.rand(3, 32, 32, generator=Generator().manual_seed(1))


def test_pictures_are_made_of_the_exemplars_pixels(exemplar: Tensor) -> None:
    found, other = (quilts(exemplar, (32, 32), Generator().manual_seed(seed)) for seed in (0, 1))
    assert found.shape == (1, JUDGED, 3, 32, 32)
    known = {tuple(each) for each in exemplar.flatten(1).T.tolist()}
    assert {tuple(each) for each in found[0].movedim(1, -1).reshape(-1, 3).tolist()} <= known
    for different in (exemplar, found[0, 1], other[0, 0]):
        assert not torch.equal(found[0, 0], different)


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
