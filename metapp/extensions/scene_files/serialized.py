"""Meshes in Mitsuba's own format, .serialized, checked before Mitsuba reads them, as those of `meshes` are.

A file holds meshes one after the other, each a header of four bytes and a zlib stream, and a table of where they begin.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from metapp.extensions.scene_files.meshes import BLOCK, MOST, ROWS, check_finite, check_indices

_RATIO, _ALWAYS = 100, 2**26  # unpacked to packed bytes of a mesh; unpacked bytes that are always allowed
_MAGIC, _VERSIONS = 0x041C, (3, 4)
_NORMALS, _TEXTURE, _COLOURS, _DOUBLE = 1, 2, 8, 0x2000


def check_serialized(path: Path, index: int) -> None:
    """Refuse a mesh in Mitsuba's own format that is shorter than it says, or whose triangles name no vertices of it.

    Args:
        path: of the file.
        index: of the mesh in the file.

    Raises:
        ValueError: no such mesh.
    """
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(0)
        magic, version = struct.unpack("<HH", file.read(4).ljust(4, b"\0"))
        if magic != _MAGIC or version not in _VERSIONS:
            raise ValueError(f"begins with {magic:#x}, version {version}, expected {_MAGIC:#x} and version 3 or 4.")
        if index:
            file.seek(_offset(file, size, version, index))
            file.read(4)
        _check_stream(_Unpacked(file, size), version)


def _offset(file: IO[bytes], size: int, version: int, index: int) -> int:
    """Where a mesh begins, by the table at the file's end."""
    width = 8 if version == 4 else 4
    file.seek(max(size - 4, 0))
    count = int.from_bytes(file.read(4), "little")
    if not 0 <= index < count or width * count + 4 > size:
        raise ValueError(f"a shape_index of {index} in a file of {count:,} meshes, expected a smaller one; change it.")
    file.seek(size - 4 - width * (count - index))
    offset = int.from_bytes(file.read(width), "little")
    if offset > size:
        raise ValueError(f"a mesh at byte {offset:,} of {size:,}, expected it within the file; export it again.")
    return offset


class _Unpacked:
    """Reads a compressed stream, in blocks."""

    def __init__(self, file: IO[bytes], size: int) -> None:
        self.file, self.packed, self.waiting = file, size, b""
        self.stream = zlib.decompressobj()

    def read(self, count: int) -> bytes:
        """So many bytes, all of them."""
        parts: list[bytes] = []
        while count:
            self.waiting = self.waiting or self.file.read(BLOCK)
            try:
                part = self.stream.decompress(self.waiting, count)
            except zlib.error as error:
                raise ValueError(f"damaged ({error}), expected a whole file; copy it again.") from None
            ends = not part and (self.stream.eof or not self.stream.unconsumed_tail)
            if ends and (self.stream.eof or not self.waiting):
                raise ValueError("a mesh that ends before its last triangle, expected a whole file; copy it again.")
            self.waiting = self.stream.unconsumed_tail
            parts.append(part)
            count -= len(part)
        return b"".join(parts)

    def tables(self, kind: str, count: int) -> Iterator[NDArray[Any]]:
        """So many numbers of a kind, in blocks."""
        width = np.dtype(kind).itemsize
        for first in range(0, count, ROWS):
            yield np.frombuffer(self.read(width * min(ROWS, count - first)), kind)


def _check_stream(stream: _Unpacked, version: int) -> None:
    flags = int.from_bytes(stream.read(4), "little")
    for _ in range(256 if version == 4 else 0):  # its name
        if stream.read(1) == b"\0":
            break
    else:
        if version == 4:
            raise ValueError("a mesh with a name of more than 255 bytes, expected a shorter one.")
    vertices, triangles = struct.unpack("<QQ", stream.read(16))
    kind = "<f8" if flags & _DOUBLE else "<f4"
    others = 3 * bool(flags & _NORMALS) + 2 * bool(flags & _TEXTURE) + 3 * bool(flags & _COLOURS)
    needed = vertices * (3 + others) * np.dtype(kind).itemsize + 12 * triangles
    if not 0 < vertices <= MOST or not 0 < triangles <= MOST or needed > max(_ALWAYS, _RATIO * stream.packed):
        raise ValueError(
            f"{vertices:,} vertices and {triangles:,} triangles in {stream.packed:,} bytes, expected a mesh that fits."
        )
    for positions in stream.tables(kind, 3 * vertices):
        check_finite(positions)
    for _ in stream.tables(kind, others * vertices):
        pass
    for indices in stream.tables("<u4", 3 * triangles):
        check_indices(indices, vertices)
