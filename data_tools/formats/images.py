"""Photographs, such as those of textures: any format of OpenImageIO."""

from __future__ import annotations

from data_tools.formats import Format, Setting

HELP = """Convert photographs of textures.

Any format of OpenImageIO: JPEG, PNG, TIFF, EXR and more. Of each the central square is taken, upright, scaled in
linear light to --size, and kept as 8-bit sRGB. A bad file that was named ends the conversion and nothing is
written; one found in a folder is skipped with a warning.

Examples:
  metapp data images photographs --out textures
  metapp data images bark.jpg sand.png --split test --size 512 --out textures
"""
SIZE = Setting("size", 256, "Side of the pictures.", "PX", low=32, high=4096)

FORMAT = Format(
    "images",
    "texture",
    "data_tools.readers.images",
    "images",
    noun="image",
    help=HELP,
    paths=("FILES...", "Image files, and folders searched at any depth."),
    settings=(SIZE,),
)
