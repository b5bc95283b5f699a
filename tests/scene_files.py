"""Data files that scenes refer to, meshes and volumes, whole or with wrong counts and values."""

import struct
import zlib
from typing import Any

import numpy as np

CORNERS = ((-0.5, 0.9, -0.5), (0.5, 0.9, -0.5), (0.5, 0.9, 0.5), (-0.5, 0.9, 0.5))
FACES = ((0, 1, 2), (0, 2, 3))
NAN_CORNER = (float("nan"), 0.0, 0.0)
OBJ = "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS) + "f 1 2 3\nf 1 3 4\n"
_BYTE_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
PLY_FORMATS = tuple(_BYTE_ORDERS)


def ply_file(order: str, *, corners: Any = CORNERS, faces: Any = FACES, **counts: int) -> bytes:
    """Return a PLY file; `counts` replace the numbers of vertices and faces that its header states."""
    lines = ["ply", f"format {order} 1.0"]
    lines += [f"element vertex {counts.get('vertex', len(corners))}", *(f"property float {axis}" for axis in "xyz")]
    lines += [f"element face {counts.get('face', len(faces))}", "property list uchar int vertex_indices"]
    lines += ["end_header", ""]
    if order == "ascii":
        rows = [*corners, *((len(face), *face) for face in faces)]
        body = "".join(" ".join(map(str, row)) + "\n" for row in rows).encode()
    else:
        byte_order = _BYTE_ORDERS[order]
        body = np.array(corners, f"{byte_order}f4").tobytes()
        for face in faces:
            body += bytes([len(face)]) + np.array(face).astype(f"{byte_order}i4").tobytes()
    return "\n".join(lines).encode() + body


def serialized_file(*, corners: Any = CORNERS, faces: Any = FACES, flags: int = 0x1000, **counts: int) -> bytes:
    """Return a file of Mitsuba's format `serialized` with one mesh; `counts` replace the numbers that it states."""
    sizes = struct.pack("<QQ", counts.get("vertex", len(corners)), counts.get("face", len(faces)))
    numbers = np.array(corners, "<f8" if flags & 0x2000 else "<f4").tobytes()
    content = struct.pack("<I", flags) + b"lamp\0" + sizes + numbers + np.array(faces).astype("<u4").tobytes()
    return struct.pack("<HH", 0x041C, 4) + zlib.compress(content) + struct.pack("<QI", 0, 1)


def volume_file(grid: tuple[int, int, int], channels: int = 1, *, values: Any = None) -> bytes:
    """Return a volume file of Mitsuba; without `values` the header alone."""
    header = struct.pack("<3sB5i6f", b"VOL", 3, 1, *grid, channels, 0, 0, 0, 1, 1, 1)
    return header + (b"" if values is None else np.asarray(values, "<f4").tobytes())
