"""Folders with the places of camera and flash for several photos of one flat material, by text files beside them."""

from __future__ import annotations

from pathlib import Path

from data_tools.readers.listing import files_below

CAMERA, LIGHT, SIZE = "camera_pos.txt", "light_pos.txt", "image_size.txt"
TEXTS = (CAMERA, LIGHT, SIZE, "light_power.txt")  # no fit reads the last one


def placed_in(folder: Path) -> list[Path]:
    """A folder and those below it that say so, sorted, hidden ones left out."""
    return sorted({file.parent for file in files_below(folder) if file.name in (CAMERA, LIGHT)})
