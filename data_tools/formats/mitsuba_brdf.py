"""Mitsuba 3 scenes of a fitted BRDF."""

from __future__ import annotations

from data_tools.formats import Format, Writer


def _writer() -> Writer:
    from data_tools.readers import mitsuba_material

    return mitsuba_material


FORMAT = Format("mitsuba", "brdf", "", None, _writer)
