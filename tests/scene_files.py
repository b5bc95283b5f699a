"""Data files of scenes, well made and hostile: meshes, volumes."""

from __future__ import annotations

import struct
import zlib
from typing import Any

import numpy as np

CORNERS = ((-0.5, 0.9, -0.5), (0.5, 0.9, -0.5), (0.5, 0.9, 0.5), (-0.5, 0.9, 0.5))
FACES = ((0, 1, 2), (0, 2, 3))
NAN = (float("nan"), 0.0, 0.0)
OBJ = "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS) + "f 1 2 3\nf 1 3 4\n"
_KINDS = {"uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4", "double": "f8"}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
ORDERS = tuple(_ORDERS)


def ply(
    order: str,
    *,
    corners: Any = CORNERS,
    faces: Any = FACES,
    index: str = "int",
    kind: str = "float",
    end: str = "\n",
    header: str = "",
    tail: bytes = b"",
    **counts: int,
) -> bytes:
    """A PLY file; `counts` are those of its header, `header` a line of it."""
    lines = ["ply", f"format {order} 1.0", *filter(None, [header])]
    lines += [f"element vertex {counts.get('vertex', len(corners))}", *(f"property {kind} {axis}" for axis in "xyz")]
    lines += [f"element face {counts.get('face', len(faces))}", f"property list uchar {index} vertex_indices"]
    lines += ["end_header", ""]
    if order == "ascii":
        rows = [*corners, *((len(face), *face) for face in faces)]
        body = "".join(" ".join(map(str, row)) + end for row in rows).encode()
    else:
        sign = _ORDERS[order]
        body = np.array(corners, sign + _KINDS[kind]).tobytes()
        for face in faces:
            body += bytes([len(face)]) + np.array(face).astype(sign + _KINDS[index]).tobytes()
    return end.join(lines).encode() + body + tail


def serialized(
    *, corners: Any = CORNERS, faces: Any = FACES, version: int = 4, flags: int = 0x1000, meshes: int = 1, **counts: int
) -> bytes:
    """A file of Mitsuba's own format, with the same mesh so many times."""
    sizes = struct.pack("<QQ", counts.get("vertex", len(corners)), counts.get("face", len(faces)))
    numbers = np.array(corners, "<f8" if flags & 0x2000 else "<f4").tobytes()
    name = b"lamp\0" if version == 4 else b""
    content = struct.pack("<I", flags) + name + sizes + numbers + np.array(faces).astype("<u4").tobytes()
    mesh = struct.pack("<HH", 0x041C, version) + zlib.compress(content)
    offsets = b"".join(struct.pack("<Q" if version == 4 else "<I", len(mesh) * i) for i in range(meshes))
    return mesh * meshes + offsets + struct.pack("<I", meshes)


def volume(grid: tuple[int, int, int], channels: int = 1, *, kind: int = 1, values: Any = None) -> bytes:
    """A volume file; without `values`, its header alone."""
    header = struct.pack("<3sB5i6f", b"VOL", 3, kind, *grid, channels, 0, 0, 0, 1, 1, 1)
    return header + (b"" if values is None else np.asarray(values, "<f4").tobytes())
