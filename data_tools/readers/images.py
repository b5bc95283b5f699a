"""Photographs of textures as tasks."""

from __future__ import annotations

from pathlib import Path

from data_tools.readers.photos import SIZE, find_photos, holds_photos, read_photo
from metapp.learning.task import Task

UNITS = {"image": "sRGB, uint8 0..255 [3, height, width], rows from the top"}

find = find_photos  # the names that every reader has
recognises = holds_photos


def read_task(path: Path, size: int = SIZE) -> Task:
    """Turn an image file into a texture task of so many px a side, named by the file's stem.

    Raises:
        ValueError: as `data_tools.readers.photos.read_photo`.
    """
    return Task(path.stem, {"image": read_photo(path, size)})
