"""Photographs that are registered some texels off are moved such that all show a surface at the same texels."""

import pytest
import torch
from torch import Tensor

from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.flash import Maps, camera_distance, render_maps, texel_positions
from metapp.apps.svbrdf_nonstationary.several.alignment import _resample, _shift_plane, align_photos
from metapp.apps.svbrdf_nonstationary.several.app import SeveralPhotos, Texels
from metapp.learning.task import Task
from tests.apps.several.test_several_photos import relief

SIDE = 128


def photographs(slope: float) -> tuple[Tensor, Tensor]:
    """Linear photos [5, 3, SIDE, SIDE] of relief times a factor, and their places."""
    maps = Maps(*(part.repeat(1, 1, 4, 4) for part in relief(SIDE // 4)))
    normal = maps.normal * torch.tensor([slope, slope, 1.0])[:, None, None]
    turns = torch.arange(5) * torch.pi / 2
    places = 4 * torch.stack([0.4 * turns.cos(), 0.4 * turns.sin(), torch.ones(5)], 1)
    places[0, :2] = 0
    maps = maps._replace(normal=normal / normal.norm(dim=1, keepdim=True))
    gains = (places[:, 2] / camera_distance()) ** 2
    photos = [
        render_maps(maps, texel_positions(SIDE, SIDE), place[None], place[None], intensity=gain)
        for place, gain in zip(places, gains, strict=True)
    ]
    return torch.cat(photos), places[:, None].repeat(1, 2, 1)


@pytest.mark.parametrize("texels", [1.0, 1.5])
def test_photographs_registered_below_the_surface_are_moved_onto_it(texels: float) -> None:
    photos, places = photographs(1.0)
    off = _shift_plane(photos, places[:, 0], torch.tensor(-texels * 2 / SIDE))
    inner = ..., slice(8, -8), slice(8, -8)
    display = (linear_to_srgb(off) * 255).round().to(torch.uint8)
    task = Task("relief", {"photo": display[0], "others": display[1:], "places": places})
    for moved in (align_photos(off, places), SeveralPhotos(Texels(SIDE, SIDE)).prepare(task)["photos"]):
        assert (moved[0] - photos[0]).abs().max() < 0.01
        assert (moved - photos)[inner].abs().mean() < 0.2 * (off - photos)[inner].abs().mean()


@pytest.mark.parametrize("slope", [0.0, 1.0])
def test_photographs_on_the_plane_or_with_too_little_data_stay_unchanged(slope: float) -> None:
    photos, places = photographs(slope)
    assert align_photos(photos, places) is photos
    for few, at in ((photos[..., ::2, ::2], places), (photos[:3], places[:3])):
        assert align_photos(few, at) is few


def test_photographs_that_are_shifted_are_moved_back() -> None:
    photos, places = photographs(1.0)
    shifts = torch.tensor([[0.0, 0.0], [0.4, 0.0], [0.0, -0.5], [-0.3, 0.3], [0.0, 0.2]]) * 2 / SIDE
    off = _resample(photos, texel_positions(SIDE, SIDE) + shifts[..., None, None])
    inner = ..., slice(8, -8), slice(8, -8)
    moved = align_photos(off, places)
    assert (moved - photos)[inner].abs().mean() < 0.25 * (off - photos)[inner].abs().mean()
