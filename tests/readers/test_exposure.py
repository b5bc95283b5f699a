"""Photographs that were exposed wrongly, as if they had been exposed rightly."""

from __future__ import annotations

from pathlib import Path

import OpenImageIO as oiio
import pytest
import torch

from data_tools.readers.svbrdf_inputs import read_task
from data_tools.readers.svbrdf_task import encoded, rightly_exposed
from metapp.appearance.colour import srgb_to_linear

RADIANCE = 0.02 + 0.9 * torch.rand(3, 64, 64, generator=torch.Generator().manual_seed(0))


def linear(photo: torch.Tensor) -> torch.Tensor:
    return srgb_to_linear(photo.float() / 255)


@pytest.mark.parametrize("stops", [-2.0, -1.0, -0.3])
def test_a_dark_photo_becomes_as_bright_as_it_should_be(stops: float) -> None:
    photo = encoded(RADIANCE * 2**stops)
    found = linear(rightly_exposed(photo, stops))
    # half a step of 8 bits, at most 0.0044 of radiance, in the photo and in what it becomes
    torch.testing.assert_close(found, RADIANCE, atol=0.0045 * (1 + 2**-stops), rtol=0)


@pytest.mark.parametrize("stops", [0.5, 1.0, 2.0])
def test_what_a_bright_photo_clips_stays_white_and_the_rest_is_as_it_should_be(stops: float) -> None:
    photo = encoded(RADIANCE * 2**stops)
    found, clips = rightly_exposed(photo, stops), (linear(photo) > 0.95).any(0)
    assert clips.any()
    assert not clips.all()
    assert torch.equal(found[:, clips], photo[:, clips])
    torch.testing.assert_close(linear(found)[:, ~clips], RADIANCE[:, ~clips], atol=0.009, rtol=0)


def test_a_file_is_read_so(tmp_path: Path) -> None:
    path = tmp_path / "wall.png"
    pixels = encoded(RADIANCE / 2).permute(1, 2, 0).contiguous().numpy()
    image = oiio.ImageBuf(pixels)
    assert image.write(str(path))
    photos = [read_task(path, 32, exposure=stops).data["photo"] for stops in (0.0, -1.0)]
    assert torch.equal(photos[1], rightly_exposed(photos[0], -1.0))
    assert float(linear(photos[1]).mean() / linear(photos[0]).mean()) == pytest.approx(2, rel=0.01)
