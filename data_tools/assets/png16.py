"""What was fitted as PNG of 16 bits: colours as sRGB, all else linear, heights stretched."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from data_tools.assets.pictures import write_planes
from metapp.appearance.surface import Surface, fitted_planes


def write(surface: Surface, path: Path, provenance: Mapping[str, object]) -> None:
    """Write <path>/<name>_<map>.png of the fitted maps, or of a texture's colour."""
    write_planes(fitted_planes(surface), path)
