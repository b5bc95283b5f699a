"""Image files before they are decoded: how many pixels they may have, and what OpenImageIO says of them."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import OpenImageIO as oiio

_MAX_PIXELS = 2**28
_ALWAYS_BYTES, _MAX_RATIO = 2**26, 2000  # zlib packs 1032 to 1
_REASON = 120  # characters of a library's message


@contextlib.contextmanager
def silent() -> Iterator[None]:
    """Keep what libraries such as libpng write to standard error by themselves off the user's screen."""
    try:
        kept = os.dup(2)
    except OSError:  # there is none
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def check_pixels(width: int, height: int, path: Path | str) -> None:
    """Refuse a picture of more pixels than memory should hold.

    Raises:
        ValueError: it has more.
    """
    if width * height > _MAX_PIXELS:
        raise ValueError(f"{path}: {width}x{height} px, expected {_MAX_PIXELS:,} px or fewer; scale it down.")


def check_memory(spec: oiio.ImageSpec, path: Path) -> None:
    """Refuse a small file that would take gigabytes: its header is damaged, or made for that."""
    held = spec.image_bytes()
    if held > max(_ALWAYS_BYTES, _MAX_RATIO * path.stat().st_size):
        raise ValueError(
            f"{path}: {spec.width}x{spec.height} px of {spec.nchannels} channels in {path.stat().st_size:,} bytes, "
            "expected a whole image; copy or download it again."
        )


def error_of(source: oiio.ImageInput | ModuleType) -> str:
    """The error message of OpenImageIO, or of an open file of its; "" for none."""
    try:
        return str(source.geterror())
    except UnicodeDecodeError as error:  # it repeats bytes of the file
        return error.object.decode("ascii", "replace")


def reason_of(message: str, path: Path) -> str:
    """The first sentence of OpenImageIO's message, without the path, which the line has already."""
    without = re.sub(rf'( for( file)?)? ?["(]?{re.escape(str(path))}[")]?( is\b)?', "", message)
    first = next(iter(without.splitlines()), "").partition(". ")[0]
    return "".join(c if c.isprintable() else "?" for c in first)[:_REASON].strip(" :.") or "unknown reason"
