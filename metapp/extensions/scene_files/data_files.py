"""The memory that data files of scenes take once Mitsuba has read them, by what their headers state.

Mitsuba allocates what a header asks for, however small the file is, and decompresses without a bound. So headers are
read first; of compressed meshes no more than the header is decompressed.
"""

from __future__ import annotations

import contextlib
import math
import re
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import OpenImageIO as oiio

from data_tools.readers.image_files import check_size
from data_tools.readers.opened_images import check_memory, last_oiio_error, shorten_oiio_error, silence_libraries
from metapp.rendering.scenes.spectra import check_spectrum_file
from metapp.storage.files import open_regular

_VOLUME_HEADER = struct.Struct("<4s5i")  # VOL and a version, type, width, height, depth, channels
_BOUNDING_BOX_BYTES = 24  # six floats, which follow the header of a volume
_PIXEL_CHANNELS, _FLOAT_BYTES, _FACE_BYTES = 4, 4, 12  # a picture in memory has four channels, a face three indices
_ENVMAP_COPIES = 4  # of an environment map in memory: with its sampling densities 64 bytes a px, a texture takes 13
_MESH_COPIES = 2  # of a volume or of faces in memory while they are loaded
_TEXT_BYTES_PER_BYTE = 4  # memory for each byte of text of a mesh: "f 1 2 3", of 8 bytes, becomes a face and vertices

_SERIALIZED_MARK, _SERIALIZED_VERSIONS = 0x041C, (3, 4)
_NORMALS_FLAG, _PLACES_FLAG, _COLOURS_FLAG, _DOUBLE_FLAG = 1, 2, 8, 0x2000  # of a mesh in Mitsuba's own format
_MAX_DEFLATE_RATIO = 1_040  # zlib packs at most 1032 bytes into one
_MAX_NAME_BYTES = 2**16  # of a mesh's name, which lies before its counts

_PLY_HEADER_BYTES = 2**16
_PLY_NUMBER_BYTES = {
    "char": 1, "uchar": 1, "int8": 1, "uint8": 1, "short": 2, "ushort": 2, "int16": 2, "uint16": 2, "int": 4, "uint": 4,
    "int32": 4, "uint32": 4, "float": 4, "float16": 2, "float32": 4, "double": 8, "float64": 8,
}  # fmt: skip
_VERTEX_BYTES = 32  # position, normal and texture coordinates, which Mitsuba may add


def data_file_bytes(kind: str, path: Path, shape_index: int = 0) -> int:
    """Return the memory that a file takes while Mitsuba reads it; values in it, but those of spectra, are not checked.

    Args:
        kind: type of the plugin that reads the file.
        path: the file.
        shape_index: number of the mesh in a file of Mitsuba's format `serialized` that holds several.

    Raises:
        ValueError: the file is no image, volume or spectrum that Mitsuba can take, or smaller than its header states.
    """
    try:
        if kind == "serialized":
            return _serialized_bytes(path, shape_index)
        measure = _MEASURES.get(kind)
        return measure(path) if measure else path.stat().st_size
    except ValueError as error:
        reason = str(error).removeprefix(f"{path}: ")
        raise ValueError(f"names the file {path.name[:60]!r}, which Mitsuba cannot take: {reason}") from None


def _picture_bytes(path: Path) -> int:
    """Return the memory of a picture as floats; refuse a file that is no image, or larger than photographs may be."""
    with silence_libraries():
        source = oiio.ImageInput.open(str(path))
        if source is None:
            raise ValueError(
                f"no image ({shorten_oiio_error(last_oiio_error(oiio), path)}), expected one; export it again."
            )
        with contextlib.closing(source):
            spec = source.spec()
            check_size(spec.width, spec.height, path, low=1)
            check_memory(spec, path)
            channels = max(_PIXEL_CHANNELS, spec.nchannels)
            return int(_FLOAT_BYTES * spec.width * spec.height * channels)


def _envmap_bytes(path: Path) -> int:
    return _ENVMAP_COPIES * _picture_bytes(path)


def _volume_bytes(path: Path) -> int:
    """Return the memory of a volume; refuse one whose grid of floats is empty, or larger than the file."""
    with open_regular(path) as file:
        header = file.read(_VOLUME_HEADER.size).ljust(_VOLUME_HEADER.size, b"\0")
        size = file.seek(0, 2)
    _, _, *grid, channels = _VOLUME_HEADER.unpack(header)
    grid_bytes = int(_FLOAT_BYTES * math.prod(grid) * channels)
    needed_bytes = _VOLUME_HEADER.size + _BOUNDING_BOX_BYTES + grid_bytes
    if min(*grid, channels) < 1 or size < needed_bytes:
        shape = " x ".join(map(str, grid))
        raise ValueError(
            f"a grid of {shape}, {channels} channels and {size:,} bytes, expected 1 or more along each axis and "
            f"{needed_bytes:,} bytes; export it again."
        )
    return _MESH_COPIES * grid_bytes


def _serialized_bytes(path: Path, shape_index: int) -> int:
    """Return the memory of one mesh of a file of Mitsuba's format `serialized`, by its decompressed header.

    A file that breaks off before its counts has the memory of its own size: Mitsuba refuses it in the trial.
    """
    with open_regular(path) as file:
        size = file.seek(0, 2)
        try:
            flags, vertices, faces = _read_serialized_header(file, size, shape_index)
        except (struct.error, zlib.error, OSError):
            return size
    places = 3 + 3 * bool(flags & _NORMALS_FLAG) + 2 * bool(flags & _PLACES_FLAG) + 3 * bool(flags & _COLOURS_FLAG)
    vertex_bytes = places * _FLOAT_BYTES * (2 if flags & _DOUBLE_FLAG else 1)
    _check_counts(vertices, faces, size * _MAX_DEFLATE_RATIO // max(vertex_bytes, _FACE_BYTES))
    return vertices * (vertex_bytes + _VERTEX_BYTES) + _MESH_COPIES * faces * _FACE_BYTES


def _read_serialized_header(file: BinaryIO, size: int, shape_index: int) -> tuple[int, int, int]:
    """Return the flags of a mesh and its numbers of vertices and faces.

    Raises:
        struct.error: the file ends too early, or is none of this format.
        zlib.error: it is not compressed as it should be.
        OSError: it states a place before its begin.
    """
    file.seek(0)
    mark, version = struct.unpack("<HH", file.read(4))
    if mark != _SERIALIZED_MARK or version not in _SERIALIZED_VERSIONS:
        raise struct.error
    if shape_index:  # places of all meshes are at the end of the file, and their number after them
        form, width = ("<Q", 8) if version == 4 else ("<I", 4)
        file.seek(size - 4)
        (count,) = struct.unpack("<I", file.read(4))
        file.seek(size - 4 - width * (count - shape_index))
        (place,) = struct.unpack(form, file.read(width))
        if place >= size:
            raise struct.error
        file.seek(place + 4)
    inflater, packed = zlib.decompressobj(), file.read(_MAX_NAME_BYTES)
    content = inflater.decompress(packed, _MAX_NAME_BYTES)
    begin = content.find(b"\0", 4) + 1 if version == 4 else 4
    if not begin:
        raise ValueError(f"a mesh whose name has more bytes than {_MAX_NAME_BYTES:,}, expected fewer; rename it.")
    (flags,) = struct.unpack_from("<I", content)
    vertices, faces = struct.unpack_from("<QQ", content, begin)
    return flags, vertices, faces


def _ply_bytes(path: Path) -> int:
    """Return the memory of a PLY file; refuse one with more vertices or faces than fit into it."""
    with open_regular(path) as file:
        header, end, _ = file.read(_PLY_HEADER_BYTES).partition(b"end_header")
        size = file.seek(0, 2)
    if not header.startswith(b"ply") or not end:
        return size  # Mitsuba refuses it in the trial
    is_text, total = b"format ascii" in header, 0
    for element in re.split(rb"(?m)^\s*element\s+", header)[1:]:
        name, _, rest = element.partition(b" ")
        count = int(match[0]) if (match := re.match(rb"\s*\d{1,18}(?!\d)", rest)) else 2**63
        properties = re.findall(rb"(?m)^\s*property\s+(\w+)", rest)
        widths = [_PLY_NUMBER_BYTES.get(kind.decode(), 1) for kind in properties]
        least_bytes = 2 * len(widths) if is_text else sum(widths)
        _check_counts(*((0, count) if name == b"face" else (count, 0)), size // max(1, least_bytes))
        total += count * (_FACE_BYTES * _MESH_COPIES if name == b"face" else _VERTEX_BYTES + 4 * len(widths))
    return total + size


def _text_mesh_bytes(path: Path) -> int:
    return _TEXT_BYTES_PER_BYTE * path.stat().st_size


def _check_counts(vertices: int, faces: int, most: int) -> None:
    """Refuse more vertices or faces than a file can hold."""
    if max(vertices, faces) > most:
        raise ValueError(
            f"{vertices:,} vertices and {faces:,} faces, expected {most:,} at most in a file of its size; "
            "export it again."
        )


def _spectrum_bytes(path: Path) -> int:
    check_spectrum_file(path)
    return path.stat().st_size


_MEASURES: dict[str, Callable[[Path], int]] = {
    "bitmap": _picture_bytes,
    "envmap": _envmap_bytes,
    "gridvolume": _volume_bytes,
    "sdfgrid": _volume_bytes,
    "ply": _ply_bytes,
    "ellipsoids": _ply_bytes,
    "ellipsoidsmesh": _ply_bytes,
    "obj": _text_mesh_bytes,
    "bsplinecurve": _text_mesh_bytes,
    "linearcurve": _text_mesh_bytes,
    "spectrum": _spectrum_bytes,
    "regular": _spectrum_bytes,
    "irregular": _spectrum_bytes,
}
