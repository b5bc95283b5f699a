"""Mitsuba 3 scenes of a material."""

from __future__ import annotations

from data_tools.formats import MATERIALS, AssetWriter, Export


def _writer() -> AssetWriter:
    from data_tools.assets import mitsuba

    return mitsuba


EXPORT = Export("mitsuba", MATERIALS, _writer)
