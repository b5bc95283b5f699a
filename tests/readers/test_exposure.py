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


@pytest.mark.parametrize("stops", [-2.0, -1.0, -0.3, 0.5, 1.0, 2.0])
def test_a_photo_becomes_as_bright_as_it_should_be_and_what_clips_stays_white(stops: float) -> None:
    photo = encoded(RADIANCE * 2**stops)
    found, clips = rightly_exposed(photo, stops), (linear(photo) > 0.95).any(0)
    assert clips.any() == (stops > 0)
    assert not clips.all()
    assert torch.equal(found[:, clips], photo[:, clips])
    # half a step of 8 bits, at most 0.0044 of radiance, in the photo and in what it becomes
    tolerance = 0.0045 * (1 + 2**-stops) if stops < 0 else 0.009
    torch.testing.assert_close(linear(found)[:, ~clips], RADIANCE[:, ~clips], atol=tolerance, rtol=0)


def test_a_file_is_read_so(tmp_path: Path) -> None:
    path = tmp_path / "wall.png"
    pixels = encoded(RADIANCE / 2).permute(1, 2, 0).contiguous().numpy()
    image = oiio.ImageBuf(pixels)
    assert image.write(str(path))
    photos = [read_task(path, 32, stops=stops).data["photo"] for stops in (0.0, -1.0)]
    assert torch.equal(photos[1], rightly_exposed(photos[0], -1.0))
    assert float(linear(photos[1]).mean() / linear(photos[0]).mean()) == pytest.approx(2, rel=0.01)
