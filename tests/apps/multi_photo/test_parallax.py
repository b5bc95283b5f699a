"""Heights are found by the parallax of photographs, and photographs without it show each point at one texel."""

import math

import pytest
import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, interpolate

from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.flash import camera_distance, render_maps, texel_positions
from metapp.appearance.height_fields import height_from_normal
from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_nonstationary.multi_photo.parallax import (
    RELIEF_CHANNELS,
    Heights,
    find_heights,
    read_displaced,
    remove_parallax,
)
from metapp.apps.svbrdf_nonstationary.multi_photo.recipe import of_several
from metapp.learning.task import Task
from tests.apps.multi_photo.test_several_photos import relief

SIDE = 128
INNER = slice(10, -10), slice(10, -10)


def photographs(slope: float, aside: float = 0.4) -> tuple[Tensor, Tensor]:
    """Linear photos [5, 3, SIDE, SIDE] of relief times a factor, without parallax, and their places."""
    maps = Maps(*(part.repeat(1, 1, 4, 4) for part in relief(SIDE // 4)))
    normal = maps.normal * torch.tensor([slope, slope, 1.0])[:, None, None]
    turns = torch.arange(5) * torch.pi / 2
    places = 4 * torch.stack([aside * turns.cos(), aside * turns.sin(), torch.ones(5)], 1)
    places[0, :2] = 0
    spots = torch.rand(1, 3, SIDE // 2, SIDE // 2, generator=torch.Generator().manual_seed(2))
    colour = interpolate(spots * 0.4 + 0.1, (SIDE, SIDE), mode="bicubic")
    maps = maps._replace(normal=normal / normal.norm(dim=1, keepdim=True), diffuse=colour)
    gains = (places[:, 2] / camera_distance()) ** 2
    photos = [
        render_maps(maps, texel_positions(SIDE, SIDE), place[None], place[None], intensity=gain)
        for place, gain in zip(places, gains, strict=True)
    ]
    return torch.cat(photos).clamp(0, 1), places[:, None].repeat(1, 2, 1)


def add_parallax(photos: Tensor, eyes: Tensor, height: Tensor) -> Tensor:
    """Move photographs that show each point at one texel as a surface of these heights moves, nearly."""
    texels = texel_positions(SIDE, SIDE)
    rates = (texels - eyes[:, :2, None, None]) / eyes[:, 2:, None, None]
    return read_displaced(photos, -height * (rates - rates[:1])).clamp(0, 1)


def waves(texels: float) -> Tensor:
    """Smooth heights [SIDE, SIDE] of an amplitude, in half sides, which moves the photographs by these texels."""
    x, y = texel_positions(SIDE, SIDE)
    return texels / 0.4 * 2 / SIDE * (torch.sin(math.pi * x) * torch.cos(math.pi * y))


@pytest.mark.parametrize("texels", [0.0, 0.7, 1.4])
@pytest.mark.parametrize("slope", [0.0, 1.0])
def test_heights_and_photographs_are_found(texels: float, slope: float) -> None:
    photos, places = photographs(slope)
    height = waves(texels)
    moved = add_parallax(photos, places[:, 0], height)
    found = find_heights(moved, places[:, 0], (SIDE, SIDE)).height
    texel = 2 / SIDE / 0.4  # the height that moves a photograph by a texel
    assert (found - height)[INNER].abs().mean() < 0.15 * texel
    straight = remove_parallax(moved, places[:, 0], found)
    assert torch.equal(straight[0], moved[0])
    off, left = ((values - photos)[..., *INNER].abs().mean() for values in (moved, straight))
    assert left < (0.35 * off if texels else 0.02)
    if not texels:  # heights below the noise count as none
        straight = moved
    display = (linear_to_srgb(moved) * 255).round().to(torch.uint8)
    task = Task("relief", {"photo": display[0], "others": display[1:], "places": places})
    prepared = of_several(SIDE, SIDE).prepare(task)
    assert prepared["relief"].shape == (RELIEF_CHANNELS, SIDE, SIDE)
    assert (prepared["photos"] - straight).abs().mean() < 0.01


def test_heights_are_described_by_the_slopes_of_their_normals() -> None:
    height = waves(2.0)
    slopes = Heights(height, torch.ones_like(height)).describe()[:2]
    normal = torch.cat([slopes, torch.ones_like(slopes[:1])])
    integrated = height_from_normal(normal[None] / normal.norm(dim=0), periodic=False)[0, 0] * 2 / SIDE
    assert (integrated - height + height.mean())[INNER].abs().max() < 0.1 * height.abs().max()


def test_finer_photographs_refine_heights() -> None:
    """At half the size, the second sweep sees the details that the first one does not."""
    photos, places = photographs(1.0)
    height = waves(1.4)
    moved, half = add_parallax(photos, places[:, 0], height), (SIDE // 2, SIDE // 2)
    fine, coarse = (find_heights(values, places[:, 0], half) for values in (moved, adaptive_avg_pool2d(moved, half)))
    off = [
        (adaptive_avg_pool2d(height[None], half)[0] - found.height)[5:-5, 5:-5].abs().mean() for found in (fine, coarse)
    ]
    assert off[0] < 0.7 * off[1]


def test_photographs_of_one_place_or_of_few_texels_have_no_heights() -> None:
    photos, places = photographs(1.0, aside=0.001)
    for few, eyes in ((photos, places[:, 0]), (photos[:1], places[:1, 0]), (photos[..., :16, :16], places[:, 0])):
        found = find_heights(few, eyes, (few.shape[-2], few.shape[-1]))
        assert not found.height.any()
        assert remove_parallax(few, eyes, found.height) is few
        assert torch.isfinite(found.describe()).all()
