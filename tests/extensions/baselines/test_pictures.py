"""Baselines of pictures: the cut of quilting, a photo as a flat material, a map of what a mirror ball shows."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Generator, Tensor
from torch.nn.functional import interpolate

from metapp.appearance.flash import Maps
from metapp.appearance.latlong import directions
from metapp.appearance.quilting import beyond_cut
from metapp.apps.svbrdf_nonstationary.maps import FLASH, flash_of, photographed
from metapp.extensions.baselines.baseline import Allowed
from metapp.extensions.baselines.illumination import shown, unwrapped
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
