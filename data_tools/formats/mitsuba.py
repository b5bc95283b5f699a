"""Scenes of Mitsuba 3: XML, or a scene dictionary as JSON."""

from __future__ import annotations

from data_tools.formats import Format

FORMAT = Format(
    "mitsuba",
    "transport",
    "data_tools.readers.mitsuba_scenes",
    "Mitsuba scenes (.xml, .json) with a perspective camera",
    takes=("roots",),
)
