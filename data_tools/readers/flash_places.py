"""Folders that say where camera and flash were for several photos of one flat material, by text files beside them."""

from __future__ import annotations

from pathlib import Path

CAMERA, LIGHT, SIZE = "camera_pos.txt", "light_pos.txt", "image_size.txt"
TEXTS = (CAMERA, LIGHT, SIZE, "light_power.txt")  # no fit reads the last one


def placed_in(folder: Path) -> list[Path]:
    """A folder and those below it that say so, sorted, hidden ones left out."""
    below = sorted(path for path in folder.rglob("*") if path.is_dir())
    shown = [path for path in below if not any(part.startswith(".") for part in path.relative_to(folder).parts)]
    return [path for path in (folder, *shown) if any((path / name).is_file() for name in (CAMERA, LIGHT))]
