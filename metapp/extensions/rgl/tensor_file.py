"""Tensor files, the container of the RGL database: named arrays.

"tensor_file" and a zero byte, the version 1.0, the number of fields; of each field its name, number of axes, type,
offset in the file and shape; then the values. All little-endian, in C order.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from metapp.storage.files import read_bytes, write_atomically

MAGIC = b"tensor_file\0"
VERSION = (1, 0)
TYPES = {1: "<u1", 2: "<i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4", 7: "<u8", 8: "<i8", 9: "<f2", 10: "<f4", 11: "<f8"}
ALIGNMENT = 8
MOST_FIELDS, MOST_AXES = 64, 8


def read_tensor_file(path: str | Path) -> dict[str, NDArray[np.number]]:
    """Read all arrays of a file.

    Raises:
        ValueError: it is none, is of another version, or is damaged.
    """
    content = read_bytes(path)
    if content[:12] != MAGIC:
        raise ValueError(f"{path}: no tensor file, expected one that begins with tensor_file; not an RGL measurement.")
    try:
        *version, count = struct.unpack_from("<BBI", content, 12)
        if tuple(version) != VERSION:
            raise ValueError(f"{path}: version {version[0]}.{version[1]}, expected 1.0; download it again.")
        if count > MOST_FIELDS:
            raise _Damaged(f"{count} fields")
        fields, start = {}, 18
        for _ in range(count):
            name, array, start = _field(content, start)
            fields[name] = array
    except (struct.error, UnicodeDecodeError, _Damaged) as error:
        reason = str(error) if isinstance(error, _Damaged) else "a header that is cut off or no text"
        raise ValueError(f"{path}: {reason}, expected a whole tensor file; download it again.") from None
    return fields


class _Damaged(Exception):
    """A header that the file does not fit."""


def _field(content: bytes, at: int) -> tuple[str, NDArray[np.number], int]:
    """A field's name and values, and where the next one is."""
    (length,) = struct.unpack_from("<H", content, at)
    name = content[at + 2 : at + 2 + length].decode()
    at += 2 + length
    axes, kind, offset = struct.unpack_from("<HBQ", content, at)
    if axes > MOST_AXES or kind not in TYPES or not name.isprintable():
        raise _Damaged(f"a field of {axes} axes and type {kind}")
    shape = struct.unpack_from(f"<{axes}Q", content, at + 11)
    if 0 in shape:  # numpy refuses some of these, in words of its own
        raise _Damaged(f"a field {name[:20]} without values")
    dtype, count = np.dtype(TYPES[kind]), math.prod(shape)
    if offset + count * dtype.itemsize > len(content):
        raise _Damaged(f"{len(content):,} bytes, too few for the field {name[:20]}")
    return name, np.frombuffer(content, dtype, count, offset).reshape(shape), at + 11 + 8 * axes


def write_tensor_file(path: str | Path, fields: Mapping[str, NDArray[np.number]]) -> None:
    """Write arrays, whole or not at all."""
    kinds = {np.dtype(word): kind for kind, word in TYPES.items()}
    headers = {name: struct.pack("<H", len(name)) + name.encode() for name in fields}
    offset = 18 + sum(len(headers[name]) + 11 + 8 * array.ndim for name, array in fields.items())
    head, body = [MAGIC, struct.pack("<BBI", *VERSION, len(fields))], []
    for name, array in fields.items():
        pad = -offset % ALIGNMENT
        head.append(headers[name] + struct.pack("<HBQ", array.ndim, kinds[array.dtype], offset + pad))
        head.append(struct.pack(f"<{array.ndim}Q", *array.shape))
        body.append(bytes(pad) + np.ascontiguousarray(array).tobytes())
        offset += pad + array.nbytes
    write_atomically(path, lambda target: target.write_bytes(b"".join((*head, *body))))
