"""Photographs, such as those of textures: any format of OpenImageIO."""

from __future__ import annotations

import functools
from pathlib import Path

from data_tools.formats import Conversion, Files, Format, Reader, Setting

HELP = """Convert photographs of textures.

Any format of OpenImageIO: JPEG, PNG, TIFF, EXR and more. Of each the central square is taken, upright, scaled in
linear light to --size, and kept as 8-bit sRGB. A bad file that was named ends the conversion and nothing is
written; one found in a folder is skipped with a warning.

Examples:
  metapp data images photographs --out textures
  metapp data images bark.jpg sand.png --split test --size 512 --out textures
"""
SIZE = Setting("size", 256, "Side of the pictures.", "PX", low=32, high=4096)


def _files() -> Files:
    from data_tools.readers import images

    return images


def _reader(paths: list[Path], split: str, *, size: int) -> Reader:
    from data_tools.readers import images

    read = functools.partial(images.read_task, size=size)
    notes = {"made_by": "metapp data images", "size": size}
    return Reader("texture", "image", images.UNITS, images.find, lambda source: source.stem, read, notes)


FORMAT = Format(
    "images",
    "texture",
    "images",
    _files,
    conversion=Conversion(HELP, _reader, ("FILES...", "Image files, and folders searched at any depth."), (SIZE,)),
)
