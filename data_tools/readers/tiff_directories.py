"""Larger pictures than the one that is read: by the directories of TIFF files, and by the size that EXIF states.

Raws of many cameras are TIFF files whose first picture is a preview; their values lie in a directory below it.
"""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import BinaryIO, NamedTuple

import OpenImageIO as oiio

from data_tools.readers.input_source import DEFAULT_PHOTO_PX
from metapp.storage.files import open_regular

_WIDTH, _HEIGHT, _COMPRESSION, _PHOTOMETRIC, _SUB_DIRECTORIES, _CFA_PATTERN = 256, 257, 259, 262, 330, 0x828E
_READ_TAGS = (_WIDTH, _HEIGHT, _COMPRESSION, _PHOTOMETRIC, _SUB_DIRECTORIES, _CFA_PATTERN)
_RAW_PHOTOMETRICS = (32803, 34892)  # colour filter array (TIFF/EP), linear raw (DNG)
_RAW_COMPRESSIONS = (32767, 34713)  # of Sony's and Nikon's raws
_CR2_MARK = b"CR"  # bytes 8 and 9 of Canon's raws
_VALUE_FORMATS = {1: "B", 3: "H", 4: "I", 13: "I", 16: "Q", 18: "Q"}  # of whole numbers, by the number of a type
_MAX_DIRECTORIES, _MAX_ENTRIES, _MAX_VALUES = 1000, 1000, 100  # that are looked at, of damaged files, too

_MIN_LARGER_AREA = 4  # px of a photograph over those of a picture of it that counts as a preview
_MAX_UNREAD_BYTES = 2**20  # beside the pictures of a TIFF file, such as colour profiles; more may be a camera's raw


class TiffDirectory(NamedTuple):
    """A directory of a TIFF file, which describes a picture.

    Attributes:
        width, height: the size of the picture in px; 0 where it is not stated.
        is_raw: whether the picture holds raw values of a camera.
    """

    width: int
    height: int
    is_raw: bool


def describe_larger_picture(path: Path, file_format: str, spec: oiio.ImageSpec, stated_px: tuple[int, int]) -> str:
    """Return a note that a file holds a larger picture than the one that is read, or is of one; "" if it is not.

    Args:
        path: the file.
        file_format: its format by OpenImageIO.
        spec: the description of the picture that is read.
        stated_px: width and height of the photograph that EXIF states.
    """
    found, remedy = f"{spec.width:,} x {spec.height:,} px", "take the photo itself; develop it if it is a camera's raw"
    read_px, stated_area, unread_bytes = spec.width * spec.height, math.prod(stated_px), 0
    if file_format == "tiff":
        sizes = [(directory.width, directory.height) for directory in read_tiff_directories(path)]
        width, height = max(sizes, key=math.prod, default=(0, 0))
        if width * height > read_px:
            return f"{found}, a preview of a picture of {width:,} x {height:,} px that cannot be read here; {remedy}"
        unread_bytes = path.stat().st_size - sum(map(math.prod, sizes)) * spec.image_bytes() // read_px
    is_small = min(spec.width, spec.height) < DEFAULT_PHOTO_PX
    if stated_area >= _MIN_LARGER_AREA * read_px and (is_small or unread_bytes > stated_area / 2):
        return (
            f"{found} of a photo of {stated_px[0]:,} x {stated_px[1]:,} px by its EXIF, a preview or a part; {remedy}"
        )
    if is_small and unread_bytes > _MAX_UNREAD_BYTES:
        return (
            f"{found} in a file with {unread_bytes / 1e6:.1f} MB that are no part of its pictures, a preview; {remedy}"
        )
    return ""


class _Layout(NamedTuple):
    """The layout of a TIFF file: byte order, and the formats of counts of entries, counts of values and offsets."""

    order: str
    entry_count: str
    offset: str

    def unpack(self, stream: BinaryIO, numbers: str) -> tuple[int, ...]:
        """Read numbers by their formats at the current position; raise struct.error at the end of the file."""
        form = self.order + numbers
        return struct.unpack(form, stream.read(struct.calcsize(form)))


def read_tiff_directories(path: Path) -> list[TiffDirectory]:
    """Read the directories of a TIFF file, those below others among them, as far as the file is sound."""
    found: list[TiffDirectory] = []
    with open_regular(path) as stream:
        start = stream.read(16)
        order, version = {b"II": "<", b"MM": ">"}.get(start[:2], ""), start[2:4].strip(b"\0")
        if not order or version not in (b"*", b"+"):  # 42, and 43 for files above 4 GB
            return []
        layout = _Layout(order, "H", "I") if version == b"*" else _Layout(order, "Q", "Q")
        first_place = struct.calcsize(f"<{layout.offset}")  # behind the order, the version and sizes of large files
        is_cr2 = start[8:10] == _CR2_MARK
        pending, seen = [*struct.unpack_from(order + layout.offset, start.ljust(16, b"\0"), first_place)], {0}
        while pending and len(found) < _MAX_DIRECTORIES:
            offset = pending.pop()
            if offset in seen:
                continue
            seen.add(offset)
            try:
                tags, following = _read_directory(stream, offset, layout)
            except (struct.error, OverflowError, OSError):
                continue
            is_raw = is_cr2 or _CFA_PATTERN in tags or _first(tags, _PHOTOMETRIC) in _RAW_PHOTOMETRICS
            is_raw |= _first(tags, _COMPRESSION) in _RAW_COMPRESSIONS
            found.append(TiffDirectory(_first(tags, _WIDTH), _first(tags, _HEIGHT), is_raw))
            pending += [following, *tags.get(_SUB_DIRECTORIES, ())]
    return found


def _first(tags: dict[int, tuple[int, ...]], tag: int) -> int:
    """Return the first value of a tag, 0 if there is none."""
    return next(iter(tags.get(tag, ())), 0)


def _read_directory(stream: BinaryIO, offset: int, layout: _Layout) -> tuple[dict[int, tuple[int, ...]], int]:
    """Read a directory.

    Args:
        stream: the file.
        offset: the place of the directory.
        layout: the layout of the file.

    Returns:
        The values of each of _READ_TAGS, and the offset of the directory that follows, 0 if none does.

    Raises:
        struct.error: the file ends before.
    """
    stream.seek(offset)
    (count,) = layout.unpack(stream, layout.entry_count)
    if count > _MAX_ENTRIES:
        raise struct.error
    tags: dict[int, tuple[int, ...]] = {}
    for _ in range(count):
        tag, kind, value_count = layout.unpack(stream, f"HH{layout.offset}")
        behind_value = stream.tell() + struct.calcsize(f"<{layout.offset}")
        value_format = _VALUE_FORMATS.get(kind, "")
        if tag in _READ_TAGS and value_format:
            if value_count * struct.calcsize(f"<{value_format}") > struct.calcsize(f"<{layout.offset}"):
                stream.seek(*layout.unpack(stream, layout.offset))
            tags[tag] = layout.unpack(stream, min(value_count, _MAX_VALUES) * value_format)
        stream.seek(behind_value)
    return tags, layout.unpack(stream, layout.offset)[0]
