"""Checked scenes as Mitsuba's objects; imports no torch."""

from __future__ import annotations

from typing import Any

from metapp.rendering.types import Mitsuba, Scene

Json = Any  # a value of a scene


def instantiate(mi: Mitsuba, scene: dict[str, Json]) -> Scene:
    """A checked scene in Mitsuba, in this thread: others would write what they have to say to the screen."""
    if "xml" in scene:
        return mi.load_string(scene["xml"], parallel=False)
    return mi.load_dict(_matrices(mi, scene), parallel=False)


def _matrices(mi: Mitsuba, value: Json) -> Json:
    """The same with its matrices as Mitsuba wants them."""
    if isinstance(value, dict):
        plain = value.get("type") in ("rgb", "spectrum")
        return {key: part if plain else _matrices(mi, part) for key, part in value.items()}
    if isinstance(value, list) and isinstance(value[0], list):
        return mi.ScalarTransform4f(value) if len(value) == 4 else mi.ScalarTransform3f(value)
    return value
