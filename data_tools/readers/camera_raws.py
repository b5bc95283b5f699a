"""Camera raws, told by their content: the values of a sensor behind a mosaic of filters, and a preview.

Most are TIFF files, some by their name, too: image libraries open these as their preview.
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

_STARTS = (  # place and bytes
    (0, b"FUJIFILMCCD-RAW"), (0, b"FOVb"), (0, b"\0MRM"), (4, b"ftypcrx "), (6, b"HEAPCCDR"), (0, b"IIRO"),
    (0, b"IIRS"), (0, b"MMOR"), (0, b"IIU\0"), (8, b"CR\2"), (8, b"IIII"), (8, b"MMMM"),
)  # fmt: skip
_BYTE_ORDERS = {b"II*\0": "<", b"MM\0*": ">"}
_PHOTOMETRIC, _SUBIFDS, _COMPRESSION = 0x0106, 0x014A, 0x0103
_SENSOR_VALUES = (32803, 34892)  # colour filter array, linear raw
# of DNG: its version; of TIFF/EP: the pattern of filters; of Leaf and Phase One: their block of raw values
_RAW_TAGS = (0xC612, 0x828D, 0x828E, 0x8606)
_RAW_COMPRESSIONS = (262, 32767, 34713, 65000, 65535)  # Kodak, Sony, Nikon, Kodak, Pentax
_TYPES = {3: ("H", 2), 4: ("I", 4), 13: ("I", 4)}
_MOST_DIRECTORIES, _MOST_ENTRIES = 64, 4096


def is_raw(path: Path) -> bool:
    """Return whether a file holds the values of a camera's sensor, by its content; False for one that is no file."""
    try:
        with open_regular(path) as file:
            start = file.read(16)
            if any(start.startswith(mark, place) for place, mark in _STARTS):
                return True
            order = _BYTE_ORDERS.get(start[:4])
            return order is not None and any(_states_raw(tags) for tags in _directories(file, order))
    except (OSError, ValueError, struct.error):
        return False


def _states_raw(tags: dict[int, list[int]]) -> bool:
    return (
        any(value in _SENSOR_VALUES for value in tags.get(_PHOTOMETRIC, ()))
        or any(value in _RAW_COMPRESSIONS for value in tags.get(_COMPRESSION, ()))
        or any(tag in tags for tag in _RAW_TAGS)
    )


def _directories(file: BinaryIO, order: str) -> Iterator[dict[int, list[int]]]:
    """Yield the tags of each directory of a TIFF file, those below others, too: whole numbers, [] for other types."""
    file.seek(4)
    places, seen = [struct.unpack(f"{order}I", file.read(4))[0]], set[int]()
    while places and len(seen) < _MOST_DIRECTORIES:
        place = places.pop()
        if not place or place in seen:
            continue
        seen.add(place)
        file.seek(place)
        count = min(struct.unpack(f"{order}H", file.read(2))[0], _MOST_ENTRIES)
        entries = [struct.unpack(f"{order}HHI4s", file.read(12)) for _ in range(count)]
        after = file.read(4)
        tags = {tag: _numbers(file, order, kind, amount, field) for tag, kind, amount, field in entries}
        yield tags
        places += tags.get(_SUBIFDS, [])
        if len(after) == 4:
            places += struct.unpack(f"{order}I", after)


def _numbers(file: BinaryIO, order: str, kind: int, count: int, field: bytes) -> list[int]:
    if kind not in _TYPES or not 0 < count <= _MOST_DIRECTORIES:
        return []
    letter, size = _TYPES[kind]
    if count * size > len(field):
        file.seek(struct.unpack(f"{order}I", field)[0])
        field = file.read(count * size)
    return list(struct.unpack_from(f"{order}{count}{letter}", field))
