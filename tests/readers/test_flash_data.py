"""Photographs as tasks: the field of view that EXIF tells, which material each shows, and how these are split."""

from __future__ import annotations

import math
import random
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
import torch

from data_tools.readers import flash, photos, svbrdf_inputs
from data_tools.readers.flash import shown
from data_tools.readers.image_files import focal_length_of
from data_tools.readers.photos import field_of_view, seen_share
from data_tools.readers.svbrdf_inputs import read_task
from data_tools.readers.svbrdf_task import encoded, rightly_exposed
from metapp.appearance.colour import srgb_to_linear
from metapp.storage.shards import Entry, split_auto
from tests.pictures import write


def touch(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()


def splits_of(folder: Path) -> dict[str, str]:
    """The split of each photograph of a folder, by the name of its task."""
    found = flash.entries(flash.find([folder])[0], [folder], "auto").values()
    by_group = split_auto(sorted(entry.group for entry in found))
    return {entry.name: entry.split or by_group[entry.group] for entry in found}


PLACES = {
    ("train_0231_IMG_0785.jpg", ""): ("0231_IMG_0785", "0231", "train"),
    ("deep/Test_gold_a.jpg", ""): ("gold_a", "gold", "test"),
    ("test/0280/IMG_0786.JPG", ""): ("0280_IMG_0786", "0280", "test"),
    ("Train/tin.jpg", ""): ("tin", "tin", "train"),
    ("box/wood/IMG_1.jpg", ""): ("wood_IMG_1", "wood", ""),
    ("stone.jpg", ""): ("stone", "stone", ""),
    ("test_stone.jpg", ""): ("test_stone", "test_stone", ""),
    # what lies above the named folder says nothing, but the folder itself does, and the place of a file that was named
    ("test/photographs/wood/a.jpg", "test/photographs"): ("wood_a", "wood", ""),
    ("test/gold/a.jpg", "test"): ("gold_a", "gold", "test"),
    ("test/gold/a.jpg", None): ("gold_a", "gold", "test"),
    ("photographs/a.jpg", None): ("a", "a", ""),
}


@pytest.mark.parametrize(("file", "named"), PLACES)
def test_the_material_follows_from_name_and_place(tmp_path: Path, file: str, named: str | None) -> None:
    where = () if named is None else (tmp_path / named,)
    name, group, split = PLACES[file, named]
    assert shown(tmp_path / file, *where) == Entry(name, group=group, split=split)


@pytest.mark.parametrize(
    "layout", ["train_{material}_{image}.jpg", "{material}/{image}.jpg", "train/{material}/{image}.jpg"]
)
def test_every_fifth_material_is_for_tests_whole(tmp_path: Path, layout: str) -> None:
    rng = random.Random(0)
    counts = {f"m{i:02d}": rng.randint(1, 4) for i in range(23)}
    for material, count in counts.items():
        touch(tmp_path, *(layout.format(material=material, image=f"i{image}") for image in range(count)))
    split = splits_of(tmp_path)
    assert len(split) == sum(counts.values())
    sides = {side: {name.partition("_")[0] for name in split if split[name] == side} for side in ("train", "test")}
    assert sides["test"] == {"m04", "m09", "m14", "m19"}
    assert sides["train"] == set(counts) - sides["test"]
    assert splits_of(tmp_path) == split


def test_stated_splits_hold_where_both_occur(tmp_path: Path) -> None:
    touch(tmp_path, "test_a_1.jpg", "test_a_2.jpg", "train_b_1.jpg", "test/c/1.jpg", "train/d.jpg", "metadata.json")
    assert splits_of(tmp_path) == {"a_1": "test", "a_2": "test", "b_1": "train", "c_1": "test", "d": "train"}
    assert flash.find([tmp_path])[1] == []
    touch(tmp_path, "e.jpg")  # one that says nothing: the rule decides on all
    assert {name for name, side in splits_of(tmp_path).items() if side == "test"} == {"e"}


def test_a_material_on_both_sides_and_bad_paths_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no image in this folder"):
        flash.find([tmp_path])
    with pytest.raises(ValueError, match=r"none.jpg: no such file"):
        flash.find([tmp_path / "none.jpg"])
    touch(tmp_path, "train_a_1.jpg", "test_a_2.jpg")
    with pytest.raises(ValueError, match=r"test_a_2.jpg and .*train_a_1.jpg: training and test .* material 'a'"):
        splits_of(tmp_path)


def photo(path: Path, focal: int = 0, height: int = 96, width: int = 128) -> Path:
    """A ramp along both axes, so that every crop is another picture."""
    y, x = np.mgrid[:height, :width]
    attributes = {"Exif:FocalLengthIn35mmFilm": focal} if focal else {}
    return write(path, np.uint8(np.stack([x + 40, 2 * y + 20, 100 + 0 * x], -1)), **attributes)


def test_fields_of_view_of_known_lenses_and_what_a_narrower_camera_sees() -> None:
    """50 mm and 24 mm on film, 24 mm along the shorter side; a phone's main and wide lens, of pictures 4:3."""
    lenses = {(50, 24, 36): 26.99, (24, 36, 24): 53.13, (26, 3024, 4032): 53.07, (13, 3024, 4032): 89.91}
    found = {lens: math.degrees(field_of_view(*lens)) for lens in lenses}
    assert found == pytest.approx(lenses, abs=0.05)
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


def test_fields_of_view_go_by_the_user_then_the_file(tmp_path: Path) -> None:
    wide, plain = photo(tmp_path / "a.png", focal=26), photo(tmp_path / "b.png")
    said = [flash.read_task(path, 64, math.radians(70)).data["image"] for path in (wide, plain)]
    assert torch.equal(*said)
    assert not torch.equal(said[0], flash.read_task(wide, 64).data["image"])
    texture = photo(tmp_path / "c.png", focal=13)
    whole = photos.read_task(plain, 96).data["image"]
    assert torch.equal(flash.read_task(plain, 96).data["image"], whole)
    assert torch.equal(photos.read_task(texture, 96).data["image"], whole)  # no flash, no camera


@pytest.mark.parametrize("exif", [None, b"", b"Exif\0\0", b"Exif\0\0II*\0\xff\xff\xff\xff", b"nonsense" * 9])
def test_damaged_exif_says_nothing(exif: bytes | None) -> None:
    assert focal_length_of(exif) == 0


# Photographs that were exposed wrongly, as if they had been exposed rightly


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
