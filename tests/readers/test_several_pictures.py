"""Files that hold a preview beside the picture, raws under the name of a TIFF, and which suffixes are pictures."""

import struct
import warnings
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest
from PIL import Image

from data_tools.readers import material_files, square_photos
from data_tools.readers.camera_raws import is_raw
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


def tiff_directory(place: int, *tags: tuple[int, int, int]) -> bytes:
    """A directory of tags, types and values, without another one after it."""
    entries = b"".join(struct.pack("<HHII", tag, kind, 1, value) for tag, kind, value in tags)
    return struct.pack("<H", len(tags)) + entries + struct.pack("<I", place)


def raw_of(kind: str) -> bytes:
    """The beginning of a raw as cameras write it."""
    header = b"II*\0" + struct.pack("<I", 8)
    after = 8 + 2 + 12 + 4
    mosaic = tiff_directory(0, (0x0106, 3, 32803))
    return {
        "mosaic": header + mosaic,
        "mosaic after a preview": header + tiff_directory(after, (0x0106, 3, 2)) + mosaic,
        "mosaic below a preview": header + tiff_directory(0, (0x014A, 4, after)) + mosaic,
        "DNG": header + tiff_directory(0, (0xC612, 1, 1)),
        "Nikon": header + tiff_directory(0, (0x0103, 3, 34713)),
        "Canon": b"II*\0\x10\0\0\0CR\2\0",
        "Fujifilm": b"FUJIFILMCCD-RAW 0201",
        "Panasonic": b"IIU\0\x18\0\0\0",
        "CR3": b"\0\0\0\x18ftypcrx \0\0\0\1",
    }[kind]


RAWS = ("mosaic", "mosaic after a preview", "mosaic below a preview", "DNG", "Nikon", "Canon", "Fujifilm", "Panasonic",
        "CR3")  # fmt: skip


@pytest.mark.parametrize("kind", RAWS)
@pytest.mark.parametrize("name", ["DSC_1.TIF", "DSC_1.jpg", "DSC_1.nef"])
def test_raw_files_are_recognised_by_content_whatever_their_name(tmp_path: Path, kind: str, name: str) -> None:
    (path := tmp_path / name).write_bytes(raw_of(kind))
    assert is_raw(path)
    with pytest.raises(ValueError, match=r"raw values of a camera, .*; develop it and export it as JPEG or PNG"):
        square_photos.read_task(path)


def test_pictures_are_not_taken_for_raw_files(tmp_path: Path) -> None:
    for suffix in (".tif", ".jpg", ".png", ".exr"):
        values = PICTURE.astype(np.float32) if suffix == ".exr" else PICTURE
        assert not is_raw(write_image(tmp_path / f"a{suffix}", values))
    assert not is_raw(write_image(tmp_path / "f.tif", PICTURE.astype(np.float32)))
    assert not is_raw(pages(tmp_path / "pages.tif", PREVIEW, PICTURE))
    loop = b"II*\0" + struct.pack("<I", 8) + tiff_directory(8, (0x0106, 3, 2))  # a directory after itself
    for content in (b"", b"II*\0", b"II*\0\xff\xff\xff\xff", loop, b"MM\0*" + bytes(4)):
        (path := tmp_path / "damaged.tif").write_bytes(content)
        assert not is_raw(path)
    assert not is_raw(tmp_path)
    assert not is_raw(tmp_path / "none")


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
