"""Tensor files, the container of the RGL database: named arrays.

A file begins with "tensor_file" and a zero byte, the version 1.0 and the number of fields. For each field follow its
name, number of axes, type, offset in the file and shape; then the values. All numbers are little-endian, all arrays in
C order. This module does not know what the fields mean.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from metapp.storage.files import check_readable, open_regular, read_bytes, write_bytes

TENSOR_FILE_MAGIC = b"tensor_file\0\1\0"  # the first bytes of a file, with the version
TENSOR_TYPES = {  # types of numpy by their numbers in files
    1: "<u1",
    2: "<i1",
    3: "<u2",
    4: "<i2",
    5: "<u4",
    6: "<i4",
    7: "<u8",
    8: "<i8",
    9: "<f2",
    10: "<f4",
    11: "<f8",
}
ALIGNMENT_BYTES = 8  # offsets of arrays are multiples of it
HEAD_BYTES = 1 << 16  # bytes at the beginning of a file, among which all names and shapes are

TensorFields = Mapping[str, NDArray[np.number]]


def read_tensor_file(path: str | Path) -> dict[str, NDArray[np.number]]:
    """Read all arrays of a tensor file, by name.

    Raises:
        ValueError: the file is no tensor file, is of another version, or is damaged.
    """
    check_readable(Path(path))
    content = read_bytes(path)
    if not content.startswith(TENSOR_FILE_MAGIC):
        raise ValueError(f"{path}: no tensor file of version 1.0, expected one; not an RGL measurement.")
    fields: dict[str, NDArray[np.number]] = {}
    try:
        for name, dtype, shape, offset in _parse_heads(content):
            size = math.prod(shape)
            if not 0 < size * dtype.itemsize <= len(content) - offset:  # numpy accepts some of these
                raise ValueError(name)
            fields[name] = np.frombuffer(content, dtype, size, offset).reshape(shape)
    except (struct.error, ValueError, KeyError):
        found = f"{len(content):,} bytes, cut off or damaged"
        raise ValueError(f"{path}: {found}, expected a whole tensor file; download it again.") from None
    return fields


def read_shapes(path: str | Path) -> dict[str, tuple[int, ...]]:
    """Read the shapes of all arrays of a tensor file, by name, from the beginning of the file alone.

    Raises:
        ValueError: the file is no tensor file, is of another version, or is damaged.
    """
    check_readable(Path(path))
    with open_regular(path) as file:
        content = file.read(HEAD_BYTES)
    try:
        if content.startswith(TENSOR_FILE_MAGIC):
            return {name: shape for name, _, shape, _ in _parse_heads(content)}
    except (struct.error, ValueError, KeyError):
        pass
    raise ValueError(f"{path}: damaged or of another version, expected a tensor file; download it again.")


def _parse_heads(content: bytes) -> Iterator[tuple[str, np.dtype[Any], tuple[int, ...], int]]:
    """Yield name, type, shape and offset of each array of a file.

    Raises:
        struct.error, ValueError, KeyError: the beginning of the file is damaged.
    """
    (count,) = struct.unpack_from("<I", content, len(TENSOR_FILE_MAGIC))
    position = len(TENSOR_FILE_MAGIC) + 4
    for _ in range(count):
        (length,) = struct.unpack_from("<H", content, position)
        name = content[position + 2 : position + 2 + length].decode()
        position += 2 + length
        axes, type_number, offset = struct.unpack_from("<HBQ", content, position)
        shape = struct.unpack_from(f"<{axes}Q", content, position + 11)
        position += 11 + 8 * axes
        yield name, np.dtype(TENSOR_TYPES[type_number]), shape, offset


def write_tensor_file(path: str | Path, fields: TensorFields) -> None:
    """Write arrays as a tensor file, whole or not at all."""
    type_numbers = {np.dtype(type_name): number for number, type_name in TENSOR_TYPES.items()}
    offset = len(TENSOR_FILE_MAGIC) + 4 + sum(13 + len(name) + 8 * array.ndim for name, array in fields.items())
    head, body = [TENSOR_FILE_MAGIC, struct.pack("<I", len(fields))], []
    for name, array in fields.items():
        padding = -offset % ALIGNMENT_BYTES
        head.append(struct.pack("<H", len(name)) + name.encode())
        head.append(
            struct.pack(f"<HBQ{array.ndim}Q", array.ndim, type_numbers[array.dtype], offset + padding, *array.shape)
        )
        body.append(bytes(padding) + np.ascontiguousarray(array).tobytes())
        offset += padding + array.nbytes
    write_bytes(path, b"".join((*head, *body)))
