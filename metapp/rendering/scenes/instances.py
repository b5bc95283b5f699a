"""Checked scenes as Mitsuba's objects; imports no torch."""

from __future__ import annotations

import re
from typing import Any

from metapp.rendering.types import Mitsuba, Scene

Json = Any  # a value of a scene

_LONGEST = 200  # characters of Mitsuba's messages


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


def one_line(reason: str) -> str:
    """Mitsuba's message of an error, in one line."""
    reason = re.sub(r"\[\w+\.(?:cpp|h):\d+\] |\s+", lambda part: " " if part[0].isspace() else "", reason).strip()
    return reason if len(reason) <= _LONGEST else f"{reason[: _LONGEST // 2]} ... {reason[5 - _LONGEST // 2 :]}"
