"""Highlights: profiles about the flash, photos without them, and the gloss of materials whose truth is known."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from metapp.appearance.flash import Maps, camera, expose, positions, render
from metapp.appearance.highlight import RINGS, gloss, profile, unlit

SIZE = 128


def above(x: float, y: float) -> Tensor:
    return (camera() + torch.tensor([x, y, 0.0]))[None]


def photo(
    roughness: float, specular: float, light: Tensor, diffuse: tuple[float, float, float] = (0.3, 0.2, 0.1)
) -> Tensor:
    """A flat even material [1, 3, SIZE, SIZE] under a flash."""
    one = torch.ones(1, 1, SIZE, SIZE)
    up = torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(1, 3, SIZE, SIZE)
    maps = Maps(torch.tensor(diffuse)[:, None, None] * one, specular * one, roughness * one, up)
    return expose(render(maps, positions(SIZE, SIZE), light, light, falloff=1.0))


@pytest.mark.parametrize(("roughness", "within"), [(0.16, 0.25), (0.25, 0.12), (0.4, 0.12), (0.6, 0.12)])
@pytest.mark.parametrize("place", [(0.0, 0.0), (0.2, -0.3)])
def test_gloss_of_flat_even_materials_is_found(roughness: float, within: float, place: tuple[float, float]) -> None:
    light = above(*place)
    found = gloss(photo(roughness, 0.04, light), light)
    assert float(found.roughness) == pytest.approx(roughness, rel=within)
    assert float(found.specular) == pytest.approx(0.04, rel=0.5)
    torch.testing.assert_close(found.diffuse, torch.tensor([[0.3, 0.2, 0.1]]), rtol=0.08, atol=0)


def test_clipped_highlights_still_say_how_wide_they_are() -> None:
    light = above(0.0, 0.0)
    picture = photo(0.25, 0.1, light)
    assert (picture > 0.99).float().mean() > 0.005
    assert float(gloss(picture, light).roughness) == pytest.approx(0.25, rel=0.2)


def test_contrast_tells_varnish_from_cloth_and_the_lobes_share_metal() -> None:
    light = above(0.0, 0.0)
    shiny, matte = (float(gloss(photo(*each, light), light).contrast) for each in ((0.2, 0.04), (0.8, 0.02)))
    assert matte < 0.3 < 0.8 < shiny
    bodies = ((0.2, (0.0, 0.0, 0.0)), (0.02, (0.4, 0.4, 0.4)))
    metal, cloth = (float(gloss(photo(0.5, f0, light, diffuse=body), light).share) for f0, body in bodies)
    assert cloth < 0.15 < 0.9 < metal


def test_profiles_of_even_pictures_are_even() -> None:
    means, belongs = profile(torch.full((2, 3, 40, 56), 0.3), above(0.1, 0.2).expand(2, -1))
    assert means.shape == (2, 3, RINGS)
    there = belongs.sum(-1) > 0.1
    torch.testing.assert_close(means.mT[there], torch.full_like(means.mT[there], 0.3))
    torch.testing.assert_close(belongs.sum(-2), torch.ones(2, 40 * 56))


def test_photos_without_their_light_are_as_bright_in_all_rings() -> None:
    light = above(0.1, 0.0)
    picture = photo(0.3, 0.05, light)
    even = unlit(picture, light)
    assert float(even.std((2, 3)).max()) < 0.1 * float(picture.std((2, 3)).max())
    torch.testing.assert_close(even.mean((2, 3)), picture.mean((2, 3)), rtol=0.05, atol=0)
    stains = 1 + 0.2 * (torch.rand(SIZE, SIZE, generator=torch.Generator().manual_seed(0)) < 0.5)
    stained = unlit(picture * stains, light)
    assert float((stained / even / stains).std()) < 0.05
