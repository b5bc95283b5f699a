"""Sizes of the pictures and volumes of scenes, checked before Mitsuba reads them."""

from __future__ import annotations

import contextlib
import math
import struct
from pathlib import Path

from metapp.storage.files import open_regular
from metapp.storage.images import check_memory, check_pixels, error_of, reason_of, silent

_VOLUME = struct.Struct("<4s5i")  # VOL and a version, type, width, height, depth, channels
_BOX_BYTES = 24


def check_file(kind: str, path: Path) -> None:
    """Refuse a file that would take the memory of a much larger one, or whose grid is empty; values are not looked at.

    Args:
        kind: name of the plugin that reads it; of others than pictures and volumes nothing is checked.
        path: of the file.

    Raises:
        ValueError: no image or volume, or one of another size than it may have, naming the file.
    """
    check = {"bitmap": _check_picture, "envmap": _check_picture, "gridvolume": _check_volume, "sdfgrid": _check_volume}
    if kind not in check:
        return
    try:
        check[kind](path)
    except ValueError as error:
        reason = str(error).removeprefix(f"{path}: ")
        raise ValueError(f"names the file {path.name[:60]!r}, which Mitsuba cannot take: {reason}") from None


def _check_picture(path: Path) -> None:
    """The rule of photographs."""
    import OpenImageIO as oiio

    with silent():
        source = oiio.ImageInput.open(str(path))
        if source is None:
            raise ValueError(f"no image ({reason_of(error_of(oiio), path)}), expected one; export it again.")
        with contextlib.closing(source):
            spec = source.spec()
            check_pixels(spec.width, spec.height, path)
            check_memory(spec, path)


def _check_volume(path: Path) -> None:
    """A grid of 32-bit floats; Mitsuba ends the process at one without samples."""
    with open_regular(path) as file:
        header = file.read(_VOLUME.size).ljust(_VOLUME.size, b"\0")
        size = file.seek(0, 2)
    _, _, *grid, channels = _VOLUME.unpack(header)
    needed = _VOLUME.size + _BOX_BYTES + 4 * math.prod(grid) * channels
    if min(*grid, channels) < 1 or size < needed:
        shape = " x ".join(map(str, grid))
        raise ValueError(
            f"a grid of {shape}, {channels} channels and {size:,} bytes, expected 1 or more along each axis and "
            f"{needed:,} bytes; export it again."
        )
