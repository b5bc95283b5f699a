"""The field of view that EXIF tells, and what of a photograph a narrower camera would have seen."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch

from data_tools.readers import flash, photos, svbrdf_inputs
from data_tools.readers.image_files import focal_length_of
from data_tools.readers.photos import field_of_view, seen_share
from tests.pictures import write


def photo(path: Path, focal: int = 0, height: int = 96, width: int = 128) -> Path:
    """A ramp along both axes, so that every crop is another picture."""
    y, x = np.mgrid[:height, :width]
    attributes = {"Exif:FocalLengthIn35mmFilm": focal} if focal else {}
    return write(path, np.uint8(np.stack([x + 40, 2 * y + 20, 100 + 0 * x], -1)), **attributes)


@pytest.mark.parametrize(
    ("focal", "height", "width", "degrees"),
    [(50, 24, 36, 26.99), (24, 36, 24, 53.13), (26, 3024, 4032, 53.07), (13, 3024, 4032, 89.91)],
)
def test_fields_of_view_of_known_lenses(focal: float, height: int, width: int, degrees: float) -> None:
    """50 mm and 24 mm on film, 24 mm along the shorter side; a phone's main and wide lens, of pictures 4:3."""
    assert math.degrees(field_of_view(focal, height, width)) == pytest.approx(degrees, abs=0.05)


def test_a_narrower_camera_sees_the_middle() -> None:
    assert seen_share(math.radians(90), math.radians(45)) == pytest.approx(math.tan(math.radians(22.5)))
    assert seen_share(math.radians(45), math.radians(45)) == pytest.approx(1)
    assert seen_share(math.radians(30), math.radians(45)) == 1  # nothing can be added


@pytest.mark.parametrize("suffix", ["jpg", "tif", "png"])
def test_of_a_wide_lens_fits_see_what_their_camera_does(tmp_path: Path, suffix: str) -> None:
    path = photo(tmp_path / f"a.{suffix}", focal=26)
    share = math.tan(math.radians(22.5)) / math.tan(field_of_view(26, 96, 128) / 2)
    side = round(96 * share)
    assert 76 < side < 82
    found = flash.read_task(path, side).data["image"].float()
    low = (128 - side) // 2 + 40
    assert (found[0].mean() - (low + (side - 1) / 2)).abs() < 1
    assert (found[0, side // 2, -1] - found[0, side // 2, 0] - (side - 1)).abs() < 3
    assert torch.equal(svbrdf_inputs.read_task(path, side).data["photo"].float(), found)


def test_the_user_s_word_counts_more_than_the_file_s(tmp_path: Path) -> None:
    wide, plain = photo(tmp_path / "a.png", focal=26), photo(tmp_path / "b.png")
    said = [flash.read_task(path, 64, math.radians(70)).data["image"] for path in (wide, plain)]
    assert torch.equal(*said)
    assert not torch.equal(said[0], flash.read_task(wide, 64).data["image"])


def test_without_a_word_about_the_lens_the_whole_square_counts(tmp_path: Path) -> None:
    plain, texture = photo(tmp_path / "a.png"), photo(tmp_path / "b.png", focal=13)
    whole = photos.read_task(plain, 96).data["image"]
    assert torch.equal(flash.read_task(plain, 96).data["image"], whole)
    assert torch.equal(photos.read_task(texture, 96).data["image"], whole)  # no flash, no camera


@pytest.mark.parametrize("exif", [None, b"", b"Exif\0\0", b"Exif\0\0II*\0\xff\xff\xff\xff", b"nonsense" * 9])
def test_damaged_exif_says_nothing(exif: bytes | None) -> None:
    assert focal_length_of(exif) == 0
