"""Camera raws, recognised by their content: a sensor's values behind a mosaic of colour filters, and a preview.

Most are TIFF files, some even by their names, so image libraries would silently read the preview in their place.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from metapp.storage.files import open_regular

RAW_SUFFIXES = (
    ".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dcr", ".dng", ".erf", ".fff", ".iiq", ".kdc", ".mef", ".mos", ".mrw",
    ".nef", ".nrw", ".orf", ".pef", ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f",
)  # fmt: skip

_RAW_STARTS = (  # offset in a file, and bytes there
    (0, b"FUJIFILMCCD-RAW"), (0, b"FOVb"), (0, b"\0MRM"), (4, b"ftypcrx "), (6, b"HEAPCCDR"), (0, b"IIRO"),
    (0, b"IIRS"), (0, b"MMOR"), (0, b"IIU\0"), (8, b"CR\2"), (8, b"IIII"), (8, b"MMMM"),
)  # fmt: skip
_BYTE_ORDERS = {b"II*\0": "<", b"MM\0*": ">"}
_PHOTOMETRIC, _SUBIFDS, _COMPRESSION = 0x0106, 0x014A, 0x0103
_SENSOR_VALUES = (32803, 34892)  # of the photometric tag: colour filter array, linear raw
# The version of DNG; the pattern of filters of TIFF/EP, two tags; the block of raw values of Leaf and Phase One.
_RAW_TAGS = (0xC612, 0x828D, 0x828E, 0x8606)
_RAW_COMPRESSIONS = (262, 32767, 34713, 65000, 65535)  # Kodak, Sony, Nikon, Kodak, Pentax
_NUMBER_TYPES = {3: ("H", 2), 4: ("I", 4), 13: ("I", 4)}  # TIFF's short, long and IFD: letter of struct, bytes
_MAX_DIRECTORIES, _MAX_ENTRIES = 64, 4096  # directories of a file, and entries of a directory, that are read


def is_raw(path: Path) -> bool:
    """Tell whether a file holds the values of a camera's sensor, by its content; False if there is no such file."""
    try:
        with open_regular(path) as file:
            start = file.read(16)
            if any(start.startswith(mark, offset) for offset, mark in _RAW_STARTS):
                return True
            byte_order = _BYTE_ORDERS.get(start[:4])
            return byte_order is not None and any(_states_raw(tags) for tags in _read_directories(file, byte_order))
    except (OSError, ValueError, struct.error):
        return False


def _states_raw(tags: dict[int, list[int]]) -> bool:
    """Tell whether the tags of a TIFF directory, numbers by tag, are of a camera's sensor values."""
    return (
        any(value in _SENSOR_VALUES for value in tags.get(_PHOTOMETRIC, ()))
        or any(value in _RAW_COMPRESSIONS for value in tags.get(_COMPRESSION, ()))
        or any(tag in tags for tag in _RAW_TAGS)
    )


def _read_directories(file: BinaryIO, byte_order: str) -> Iterator[dict[int, list[int]]]:
    """Yield the tags of each directory of a TIFF file and of the directories below it.

    Tags map to their whole numbers; a tag of another type maps to [].
    """
    file.seek(4)
    offsets, seen_offsets = [struct.unpack(f"{byte_order}I", file.read(4))[0]], set[int]()
    while offsets and len(seen_offsets) < _MAX_DIRECTORIES:
        offset = offsets.pop()
        if not offset or offset in seen_offsets:
            continue
        seen_offsets.add(offset)
        file.seek(offset)
        count = min(struct.unpack(f"{byte_order}H", file.read(2))[0], _MAX_ENTRIES)
        entries = [struct.unpack(f"{byte_order}HHI4s", file.read(12)) for _ in range(count)]
        next_offset = file.read(4)
        tags = {
            tag: _read_numbers(file, byte_order, number_type, number_count, field)
            for tag, number_type, number_count, field in entries
        }
        yield tags
        offsets += tags.get(_SUBIFDS, [])
        if len(next_offset) == 4:
            offsets += struct.unpack(f"{byte_order}I", next_offset)


def _read_numbers(file: BinaryIO, byte_order: str, number_type: int, count: int, field: bytes) -> list[int]:
    """Read the whole numbers of a TIFF entry: from its field, or from where the field points to."""
    if number_type not in _NUMBER_TYPES or not 0 < count <= _MAX_DIRECTORIES:
        return []
    letter, size = _NUMBER_TYPES[number_type]
    if count * size > len(field):
        file.seek(struct.unpack(f"{byte_order}I", field)[0])
        field = file.read(count * size)
    return list(struct.unpack_from(f"{byte_order}{count}{letter}", field))
