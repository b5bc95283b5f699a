"""Data files of scenes, checked before Mitsuba reads them: meshes, volumes, pictures."""

from __future__ import annotations

import contextlib
import functools
import math
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np

from metapp.extensions.scene_files.meshes import BLOCK, check_obj, check_ply
from metapp.extensions.scene_files.serialized import check_serialized
from metapp.storage.image_limits import check_memory, check_pixels, error_of, reason_of, silent


def check_file(kind: str, path: Path, index: int = 0) -> None:
    """Refuse a file that Mitsuba would read past its end, or that would take the memory of a much larger one.

    A file that was checked before, and is still the same by its time and size, costs nothing.

    Args:
        kind: name of the plugin that reads it.
        path: of the file.
        index: of the mesh, where the file holds several.

    Raises:
        ValueError: as the check of its kind, naming the file.
    """
    if kind not in _CHECKS:
        return
    stat = path.stat()
    try:
        _checked(kind, path, index, stat.st_mtime_ns, stat.st_size, stat.st_ino)
    except (ValueError, struct.error, OSError) as error:
        reason = str(error).removeprefix(f"{path}: ")
        raise ValueError(f"names the file {path.name[:60]!r}, which Mitsuba cannot take: {reason}") from None


@functools.lru_cache(maxsize=4096)
def _checked(kind: str, path: Path, index: int, *_: int) -> None:
    _CHECKS[kind](path, index)


_VOLUME = struct.Struct("<3sB5i6f")  # VOL, version, type, width, height, depth, channels, box
_CHANNELS = {"sdfgrid": (1,), "gridvolume": (1, 3, 6)}
_FLOAT32 = 1


def _check_volume(kind: str, path: Path, _: int) -> None:
    """Of 32-bit floats on a grid; a signed distance needs two samples along each axis."""
    with path.open("rb") as file:
        size = file.seek(0, 2)
        file.seek(0)
        if size < _VOLUME.size:
            raise ValueError(f"{size} bytes, expected a header of {_VOLUME.size} and a grid.")
        magic, version, encoding, *grid, channels = _VOLUME.unpack(file.read(_VOLUME.size))[:7]
        if magic != b"VOL" or version != 3 or encoding != _FLOAT32:
            raise ValueError(
                f"{magic!r}, version {version}, encoding {encoding}, expected VOL, 3 and 1 (32-bit floats)."
            )
        least = 2 if kind == "sdfgrid" else 1
        if min(grid) < least or channels not in _CHANNELS[kind]:
            shape = " x ".join(map(str, grid))
            raise ValueError(
                f"a grid of {shape} and {channels} channels, expected {least} or more along each axis and "
                f"{' or '.join(map(str, _CHANNELS[kind]))} channels."
            )
        needed = _VOLUME.size + 4 * math.prod(grid) * channels
        if size < needed:
            raise ValueError(f"{size:,} bytes, expected {needed:,} by its header; copy it again.")
        while block := file.read(BLOCK):
            if not np.isfinite(np.frombuffer(block[: len(block) // 4 * 4], "<f4")).all():
                raise ValueError("NaN or infinite values, expected finite ones; export it again.")


_COLOURS = {"R", "G", "B", "Y"}


def _check_picture(path: Path, _: int) -> None:
    """Its size as that of photographs, and, of floats, its values."""
    import OpenImageIO as oiio

    with silent():
        source = oiio.ImageInput.open(str(path))
        if source is None:
            raise ValueError(f"no image ({reason_of(error_of(oiio), path)}), expected one; export it again.")
        with contextlib.closing(source):
            spec = source.spec()
            if min(spec.width, spec.height) < 1:
                raise ValueError(f"{spec.width}x{spec.height} px, expected 1 or more on each side; export it again.")
            check_pixels(spec.width, spec.height, path)
            check_memory(spec, path)
            if not str(spec.format).startswith(("half", "float", "double")):
                return
            names = [name.rpartition(".")[2].upper() for name in spec.channelnames]
            colours = [index for index, name in enumerate(names) if name in _COLOURS] or list(range(spec.nchannels))
            values = source.read_image(0, 0, min(colours), max(colours) + 1, "float")
            if values is None:
                raise ValueError(
                    f"damaged ({reason_of(error_of(source), path)}), expected a whole image; copy it again."
                )
    bad = int(np.count_nonzero(~np.isfinite(values[..., [index - min(colours) for index in colours]])))
    if bad:
        raise ValueError(f"{bad:,} values are NaN or infinite, expected finite ones; clamp them and export it again.")


_CHECKS: dict[str, Callable[[Path, int], None]] = {
    "bitmap": _check_picture,
    "ellipsoids": lambda path, _: check_ply(path, faces=False),
    "ellipsoidsmesh": lambda path, _: check_ply(path, faces=False),
    "envmap": _check_picture,
    "gridvolume": functools.partial(_check_volume, "gridvolume"),
    "obj": lambda path, _: check_obj(path),
    "ply": lambda path, _: check_ply(path),
    "sdfgrid": functools.partial(_check_volume, "sdfgrid"),
    "serialized": check_serialized,
}
