"""Scene files of Mitsuba as inputs of light transport."""

from __future__ import annotations

from metapp.door import Format, InMemory, SceneCheck

_HERE = "metapp.extensions.scene_files"


OFFERS = (
    Format(
        "mitsuba",
        "transport",
        f"{_HERE}.reading",
        "Mitsuba scenes (.xml, .json) with a perspective camera",
        takes=("roots",),
    ),
    InMemory("transport", f"{_HERE}.reading:from_object"),
    SceneCheck(f"{_HERE}.checking:stored"),
)
