"""TIFF files that hold more than the picture that is read: raws of cameras by content, previews, pyramids."""

import struct
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from data_tools.readers.image_files import read_pixels
from data_tools.readers.tiff_directories import read_tiff_directories
from tests.cli.messages import says

WIDTH, HEIGHT, CFA, LINEAR_RAW, NIKON = 80, 60, 32803, 34892, 34713
FORMATS = {3: "H", 4: "I"}


class Page(NamedTuple):
    """A picture of a TIFF file: its size, what its tags say, and the pictures in directories below it."""

    width: int
    height: int
    channels: int = 3
    photometric: int = 2
    compression: int = 1
    below: tuple["Page", ...] = ()


PREVIEW = Page(WIDTH, HEIGHT)


def tiff(*pages: Page, order: str = "<", mark: bytes = b"") -> bytes:
    """A TIFF file of uncompressed pictures of noise."""
    content = bytearray({"<": b"II", ">": b"MM"}[order] + struct.pack(f"{order}HI", 42, 0) + mark.ljust(8, b"\0"))

    def add(page: Page) -> tuple[int, int]:
        """Add a page; return the places of its directory and of the offset to the next one."""
        below = [add(inner)[0] for inner in page.below]
        count = page.width * page.height * page.channels
        strip = len(content)
        content.extend(np.random.default_rng(0).integers(0, 255, count, np.uint8).tobytes())
        tags = {
            256: (4, [page.width]), 257: (4, [page.height]), 258: (3, [8] * page.channels),
            259: (3, [page.compression]), 262: (3, [page.photometric]), 273: (4, [strip]), 277: (3, [page.channels]),
            278: (4, [page.height]), 279: (4, [count]),
        } | ({330: (4, below)} if below else {})  # fmt: skip
        entries = b""
        for tag, (kind, values) in sorted(tags.items()):
            data = struct.pack(f"{order}{len(values)}{FORMATS[kind]}", *values)
            if len(data) > 4:
                place = len(content)
                content.extend(data)
                data = struct.pack(f"{order}I", place)
            entries += struct.pack(f"{order}HHI", tag, kind, len(values)) + data.ljust(4, b"\0")
        directory = len(content)
        content.extend(struct.pack(f"{order}H", len(tags)) + entries + bytes(4))
        return directory, len(content) - 4

    offset_place = 4
    for page in pages:
        directory, next_place = add(page)
        content[offset_place : offset_place + 4] = struct.pack(f"{order}I", directory)
        offset_place = next_place
    return bytes(content)


RAW = Page(400, 300, 1, CFA)
RAWS = {
    "a raw below the preview": (PREVIEW._replace(below=(RAW,)),),
    "linear values below the preview": (PREVIEW._replace(below=(Page(400, 300, 3, LINEAR_RAW),)),),
    "a raw beside the preview": (PREVIEW, RAW),
    "a raw alone": (RAW,),
    "previews and a raw": (PREVIEW._replace(below=(Page(320, 240), RAW._replace(compression=NIKON))),),
}


@pytest.mark.parametrize("pages", RAWS.values(), ids=RAWS)
@pytest.mark.parametrize("order", ["<", ">"])
def test_raws_are_told_by_content(tmp_path: Path, pages: tuple[Page, ...], order: str) -> None:
    path = tmp_path / "DSC_1.TIF"
    path.write_bytes(tiff(*pages, order=order))
    with pytest.raises(ValueError, match=r"DSC_1.TIF: raw values of a camera, .*; develop it and export it as JPEG"):
        read_pixels(path)


def test_canons_raws_are_told_by_their_mark(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    path.write_bytes(tiff(PREVIEW, mark=b"CR\x02\0"))
    with pytest.raises(ValueError, match="raw values of a camera"):
        read_pixels(path)


def lines_of(path: Path, content: bytes) -> list[str]:
    path.write_bytes(content)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read_pixels(path)
    return [str(warning.message) for warning in caught]


def test_a_larger_picture_that_is_not_read_is_said(tmp_path: Path) -> None:
    (line,) = lines_of(tmp_path / "a.tif", tiff(PREVIEW._replace(below=(Page(400, 300),))))
    assert says(line, "a.tif", "80 x 60", "400 x 300", "preview", "develop it")
    (line,) = lines_of(tmp_path / "b.tif", tiff(PREVIEW) + bytes(11 * 10**6))  # in a place that no directory names
    assert says(line, "b.tif", "80 x 60", "11.0 MB", "preview", "develop it")


@pytest.mark.parametrize(
    "pages",
    [
        (PREVIEW,),
        (Page(400, 300, below=(Page(200, 150), Page(100, 75))),),
        (Page(400, 300), Page(200, 150), Page(100, 75)),
        (Page(400, 300, 1, 1),),
    ],
    ids=["one", "levels below", "levels beside", "gray"],
)
def test_pictures_and_their_smaller_levels_cause_no_line(tmp_path: Path, pages: tuple[Page, ...]) -> None:
    assert lines_of(tmp_path / "a.tif", tiff(*pages) + bytes(10_000)) == []


def test_damaged_directories_are_read_as_far_as_they_are_sound(tmp_path: Path) -> None:
    path, rng = tmp_path / "a.tif", np.random.default_rng(0)
    content = tiff(PREVIEW._replace(below=(RAW,)), Page(100, 75))
    path.write_bytes(content)
    assert {directory[:2] for directory in read_tiff_directories(path)} == {(80, 60), (400, 300), (100, 75)}
    for number in range(60):
        damaged = bytearray(content if number % 2 else content[: rng.integers(2, len(content))])
        for place in rng.integers(max(0, len(damaged) - 500), len(damaged), 6):
            damaged[place] = rng.integers(256)
        path.write_bytes(damaged)
        assert len(read_tiff_directories(path)) < 10
