"""Files that hold a preview beside the picture, camera raws, and which suffixes are pictures."""

import warnings
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
from PIL import Image

from data_tools.readers import material_files, square_photos
from data_tools.readers.image_files import read_pixels, shape_of
from data_tools.readers.opened_images import ALL_PICTURE_SUFFIXES, IMAGE_SUFFIXES
from tests.found_paths import find_paths
from tests.pictures import noise_image, write_image

PICTURE, PREVIEW = noise_image(60, 80, seed=1), noise_image(40, 48, seed=2)


def pages(path: Path, *values: np.ndarray) -> Path:
    first, *others = (Image.fromarray(page) for page in values)
    first.save(path, save_all=True, append_images=others)
    return path


def read(path: Path) -> tuple[np.ndarray, list[str]]:
    """The values of a file, and what is said meanwhile."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        values = read_pixels(path).values
    return values, [str(warning.message) for warning in caught]


@pytest.mark.parametrize("order", [(PREVIEW, PICTURE), (PREVIEW, PICTURE, PREVIEW), (PREVIEW, PICTURE, 255 - PICTURE)])
def test_the_largest_picture_of_a_tiff_counts_and_is_named(tmp_path: Path, order: tuple[np.ndarray, ...]) -> None:
    path = pages(tmp_path / "a.tif", *order)
    values, lines = read(path)
    np.testing.assert_array_equal(values, PICTURE)
    assert shape_of(path) == (60, 80)
    assert lines == [f"{path}: {len(order)} pictures, taken: number 2, 80x60 px, the largest."]


def test_first_picture_with_previews_causes_no_line(tmp_path: Path) -> None:
    for count in (1, 2, 3):
        values, lines = read(pages(tmp_path / f"{count}.tif", PICTURE, *[PREVIEW] * (count - 1)))
        np.testing.assert_array_equal(values, PICTURE)
        assert lines == []
    _, (line,) = read(pages(tmp_path / "scans.tif", PICTURE, 255 - PICTURE))  # which is meant is not known
    assert "2 pictures, taken: number 1, 80x60 px" in line


def test_raw_files_are_to_be_developed(tmp_path: Path) -> None:
    """Image libraries would read the preview of the raw, which is a TIFF file."""
    raw = write_image(tmp_path / "DSC_1.tif", PICTURE).rename(tmp_path / "DSC_1.NEF")
    with pytest.raises(ValueError, match=r"DSC_1.NEF: raw values of a camera, .*; develop it and export it as JPEG"):
        square_photos.read_task(raw)


# What is mostly no picture by its name, and names of OpenImageIO for no files
AMBIGUOUS = {".z", ".int", ".sm", ".vsm", ".null", ".nul", ".term", ".zfile"}


def test_folders_know_every_suffix_that_the_library_reads() -> None:
    kinds = [kind.partition(":") for kind in oiio.get_string_attribute("extension_list").split(";")]
    no_pictures = ("ffmpeg", "openvdb", "raw", "ptex", "heif", "dicom", "r3d")
    suffixes = {
        f".{suffix}"
        for kind, _, format_suffixes in kinds
        if kind not in no_pictures
        for suffix in format_suffixes.split(",")
    }
    assert suffixes - AMBIGUOUS <= set(IMAGE_SUFFIXES) <= set(ALL_PICTURE_SUFFIXES)


@pytest.mark.parametrize(("written", "suffix"), [("tif", "tx"), ("tga", "targa"), ("jp2", "j2k"), ("tif", "env"),
                                                ("sgi", "rgb"), ("tga", "vda"), ("jpg", "jfi")])  # fmt: skip
def test_files_that_are_read_by_name_are_found_in_folders(tmp_path: Path, written: str, suffix: str) -> None:
    files = []
    for role in ("photo", "rock_diffuse", "rock_roughness"):
        path = write_image(tmp_path / role / f"{role}.{written}", noise_image(64, 64))
        files.append(path.rename(tmp_path / f"{role}.{suffix}"))
        path.parent.rmdir()
    assert find_paths(square_photos.find, tmp_path) == (sorted(files), [])
    assert square_photos.read_task(files[0]).data["image"].shape == (3, 256, 256)
    (material,), _ = material_files.list_materials(tmp_path)
    assert material.name == "rock"
