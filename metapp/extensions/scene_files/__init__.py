"""Scene files of Mitsuba as inputs of light transport."""

from __future__ import annotations

from metapp.registry import Entry, Format, Registry

_HERE = "metapp.extensions.scene_files"


def register(registry: Registry) -> None:
    """Add scene files and scenes in memory, and check those of data sets."""
    registry.formats["mitsuba"] = Format(
        f"{_HERE}.reading",
        app="transport",
        inputs="Mitsuba scenes (.xml, .json) with a perspective camera",
        takes=("roots",),
    )
    registry.objects["transport"] = Entry(f"{_HERE}.reading:from_object")
    registry.scene_check = Entry(f"{_HERE}.checking:stored")
