"""Scenes of Mitsuba 3: XML, or a scene dictionary as JSON."""

from __future__ import annotations

from data_tools.formats import Files, Format


def _files() -> Files:
    from data_tools.readers import mitsuba_scenes

    return mitsuba_scenes


FORMAT = Format(
    "mitsuba",
    "transport",
    "Mitsuba scenes (.xml, .json) with a perspective camera",
    _files,
    takes_roots=True,
)
