"""Data augmentation of photographs by phones: parallax, light of the room, vignetting, tone curves and sharpening."""

import pytest
import torch
from torch import Generator, Tensor

from metapp.appearance.flash import texel_positions
from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_nonstationary.multi_photo.handling import develop_photos, handle_photos

SIDE = 64
WITHOUT = {"max_registration_error": 0.0, "max_ambient_share": 0.0, "max_vignetting": 0.0}
EYES = torch.tensor([[[0.0, 0.0, 2.0], [0.8, 0.0, 2.0]]])


def surface(slope: Tensor) -> Maps:
    """Grey dielectric maps [1, C, SIDE, SIDE] of a surface that rises along x by `slope` [SIDE, SIDE]."""
    normal = torch.stack([-slope, torch.zeros_like(slope), torch.ones_like(slope)])
    ones = torch.ones(1, 1, SIDE, SIDE)
    return Maps(
        0.5 * ones.expand(-1, 3, -1, -1), 0.04 * ones.expand(-1, 3, -1, -1), ones, (normal / normal.norm(dim=0))[None]
    )


def stripes() -> Tensor:
    """Two equal photographs [1, 2, 3, SIDE, SIDE] of soft stripes across x."""
    x = texel_positions(SIDE, SIDE)[0]
    return (0.5 + 0.3 * torch.sin(12 * x)).expand(1, 2, 3, -1, -1)


def test_photographs_of_a_flat_surface_stay_without_the_effects() -> None:
    flat = surface(torch.zeros(SIDE, SIDE))
    handled = handle_photos(stripes(), flat, EYES, Generator().manual_seed(0), **WITHOUT)
    torch.testing.assert_close(handled, stripes(), atol=1e-4, rtol=0)


def test_raised_parts_move_away_from_a_camera_aside() -> None:
    x = texel_positions(SIDE, SIDE)[0]
    height = 0.05 * torch.exp(-((x / 0.3) ** 2))  # a ridge along y, in half sides
    slope = -2 * x / 0.3**2 * height
    handled = handle_photos(stripes(), surface(slope), EYES, Generator().manual_seed(0), **WITHOUT)[0, :, 0, SIDE // 2]
    middle = SIDE // 2
    mean_height = float(height[0].mean())
    # the ridge is seen from 0.8 to its right, at a height of 2: it moves to the left by its height times 0.8 / 2
    shift = -(0.05 - mean_height) * 0.8 / 2
    expected = 0.5 + 0.3 * torch.sin(12 * (x[0, middle] - shift))
    assert float(handled[0, middle]) == pytest.approx(float(stripes()[0, 0, 0, 0, middle]), abs=0.01)
    assert float(handled[1, middle]) == pytest.approx(float(expected), abs=0.02)
    assert abs(float(handled[1, middle] - handled[0, middle])) > 0.03


def test_the_room_adds_light_and_corners_lose_it() -> None:
    flat = surface(torch.zeros(SIDE, SIDE))
    photos = torch.full((1, 2, 3, SIDE, SIDE), 0.5)
    ambient, vignetting = (WITHOUT | {name: 0.1} for name in ("max_ambient_share", "max_vignetting"))
    lit = handle_photos(photos, flat, EYES, Generator().manual_seed(0), **ambient)
    assert 0.5 < float(lit.min()) <= float(lit.max()) < 0.6
    dark = handle_photos(photos, flat, EYES, Generator().manual_seed(0), **vignetting)[0, 0, 0]
    assert float(dark[0, 0]) < float(dark[0, SIDE // 2]) < float(dark[SIDE // 2, SIDE // 2])


def test_developing_keeps_black_white_and_flat_areas_and_sharpens_edges() -> None:
    display = torch.zeros(1, 1, 3, SIDE, SIDE)
    display[..., SIDE // 2 :] = 0.4  # where the tone curve adds nothing
    developed = develop_photos(display, Generator().manual_seed(0))
    torch.testing.assert_close(developed[..., 0], display[..., 0])
    torch.testing.assert_close(developed[..., -1], display[..., -1])
    assert float(developed[..., SIDE // 2].min()) > 0.4
