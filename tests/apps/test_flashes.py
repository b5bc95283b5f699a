"""Flashes that unbounded numbers stand for: where they and the cameras are, and how bright they are."""

import pytest
import torch

from metapp.appearance.flash import camera_position
from metapp.apps.svbrdf_nonstationary.flashes import (
    FLASH_NUMBERS,
    CameraMotion,
    decode_flash,
    render_photo,
    render_photos,
)
from tests.surfaces import flat_maps

PLACES = torch.tensor([[[[0.1, 0.2, 3.0], [0.3, 0.2, 2.0]]]])  # of a camera and its flash
MOVED = torch.tensor([1.0, -1.0, 0.5, 0.0])


def test_zeros_stand_for_measured_positions() -> None:
    flash = decode_flash(torch.zeros(1, 1, FLASH_NUMBERS), PLACES, camera="held")
    torch.testing.assert_close(torch.stack([flash.eye, flash.place], 2), PLACES)
    beside_lens = decode_flash(torch.zeros(2, FLASH_NUMBERS))
    for position in (beside_lens.eye, beside_lens.place):
        torch.testing.assert_close(position.expand(2, 3), camera_position().expand(2, 3))
    assert beside_lens.falloff.tolist() == [0, 0]


@pytest.mark.parametrize(
    ("camera", "shift", "factor"), [("fixed", 0.0, 1.0), ("raised", 0.0, 1.1052), ("held", 0.3, 1.1052)]
)
def test_cameras_move_with_flashes_as_stated(camera: CameraMotion, shift: float, factor: float) -> None:
    flash = decode_flash(MOVED[None, None], PLACES, camera=camera)
    expected = torch.tensor([[[0.1 + shift, 0.2 - shift, 3 * factor]]])
    torch.testing.assert_close(flash.eye, expected, rtol=1e-4, atol=0)
    torch.testing.assert_close(flash.place, torch.tensor([[[0.6, -0.1, 2 * 1.1052]]]), rtol=1e-4, atol=0)


def test_a_white_patch_below_a_flash_has_radiance_1_at_any_height() -> None:
    white = flat_maps(1.0, 0.0, 1.0, size=(33, 33))
    white = type(white)(*(part[None].float() for part in white))
    above = torch.tensor([0.0, 0.0, 5.0]).expand(1, 1, 2, 3)
    photos = render_photos(white, decode_flash(torch.zeros(1, 1, FLASH_NUMBERS), above))
    assert float(photos[0, 0, 0, 16, 16]) == pytest.approx(1, abs=1e-3)
    raised = decode_flash(torch.tensor([[0.0, 0.0, 3.0, 0.0]]), camera="raised")
    assert float(render_photo(white, raised)[0, 0, 16, 16]) == pytest.approx(1, abs=1e-3)
