"""The synthetic non-stationary svBRDFs: physical, metals among them, shown by their photographs."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from data_tools.synthetic.svbrdf_nonstationary import FAMILIES, SIZE, synthetic_tasks
from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.flash import Maps, camera, positions, render, unpack
from tests.synthetic.drawn import drawn


@pytest.fixture(scope="module")
def maps() -> Maps:
    """Each [64, C, 128, 128]."""
    return unpack(torch.stack([task.data["maps"] for task in drawn("svbrdf_nonstationary").tasks]).float())


def metal(maps: Maps) -> Tensor:
    """Where there is metal, [N, 128, 128]."""
    return maps.specular.mean(1) > 0.4


@pytest.mark.long
def test_maps_are_physical(maps: Maps) -> None:
    assert all(each.isfinite().all() for each in maps)
    assert (maps.normal.norm(dim=1) - 1).abs().max() < 2e-3  # of 16 bits
    assert maps.normal[:, 2].min() > 0
    for name, (low, high) in {"roughness": (0.0999, 0.9505), "specular": (0.0199, 1), "diffuse": (0, 0.8505)}.items():
        assert low <= getattr(maps, name).min() <= getattr(maps, name).max() <= high, name
    assert (maps.diffuse * (1 - maps.specular) + maps.specular).max() <= 1
    assert maps.diffuse.movedim(1, 0)[:, metal(maps)].mean() < 0.03
    dielectric = maps.diffuse.movedim(1, 0)[:, maps.specular.mean(1) < 0.1]
    assert dielectric.min() > 0.0199


@pytest.mark.long
def test_photos_show_the_maps_under_a_flash_nearby() -> None:
    """What the maps look like under one flash each, found by descent, is what the photographs show."""
    some = drawn("svbrdf_nonstationary").train[::4]
    maps, photos = (torch.stack([task.data[key] for task in some])[..., ::4, ::4] for key in ("maps", "photo"))
    place, above = positions(128, 128)[..., ::4, ::4], camera()
    beside = linear_to_srgb(render(unpack(maps.float()), place, above, above).clamp(0, 1))
    calibrated = (255 * beside - photos).abs().mean((1, 2, 3)) < 0.5
    assert 0 < calibrated.float().mean() < 0.6
    offsets = torch.zeros(len(some), 4, requires_grad=True)
    optimiser = torch.optim.Adam([offsets], 0.03)
    for _ in range(80):
        flash = torch.cat([offsets[:, :2], above[2] * offsets[:, 2:3].exp()], 1)
        lit = render(unpack(maps.float()), place, flash, above, intensity=offsets[:, 3:].exp())
        shown = linear_to_srgb(lit.clamp(1e-4, 1))
        off = (255 * shown - photos).abs().mean((1, 2, 3))
        optimiser.zero_grad()
        off.sum().backward()
        optimiser.step()
    assert off.median() < 1
    assert off.max() < 4
    assert 0.1 < offsets[~calibrated, :2].detach().std() < 0.4


def test_sets_of_larger_maps_hold_even_materials_too() -> None:
    count = len(FAMILIES) + 1
    large, usual = (list(synthetic_tasks("train", count, size=size)) for size in (SIZE + 32, SIZE))
    assert [task.name.startswith("even_") for task in large] == [False] * len(FAMILIES) + [True]
    assert not any(task.name.startswith("even_") for task in usual)
    assert large[-1].data["maps"].shape == (10, SIZE + 32, SIZE + 32)
