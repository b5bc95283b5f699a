"""What was fitted as EXR: linear values, halves; normals and heights, which need more digits, as floats."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from metapp.appearance.surface import Surface, fitted_planes
from metapp.storage.images import write_exr

PRECISE = ("normal_gl", "height")


def write(surface: Surface, path: Path, provenance: Mapping[str, object]) -> None:
    """Write <path>/<name>_<map>.exr of the fitted maps, or of a texture's colour; heights in texture widths."""
    for key, plane in fitted_planes(surface).items():
        file = path / f"{path.name}_{key}.exr"
        write_exr(plane.values.movedim(0, -1), file, half=key not in PRECISE)
