"""Scenes of Mitsuba 3 that show a fitted BRDF."""

from __future__ import annotations

from data_tools.formats import Format

FORMAT = Format("mitsuba", "brdf", "data_tools.readers.mitsuba_material", exports=True)
