"""The plugins of Mitsuba that a scene may name, and their parameters."""

from __future__ import annotations

import functools
import importlib.util
import re
from collections.abc import Mapping
from pathlib import Path

MEDIA = {"homogeneous", "heterogeneous"}
_MEMORY = {"blender"}  # reads addresses in memory that a scene gives as numbers
_REQUIRED = {"bitmap": "filename", "blendbsdf": "weight"}  # Mitsuba 3.9 ends the process without these
_SAMPLES = 2**20  # some samplers never come to an end with more; paths here need none
_SIDE = 2**15  # px of a film: pictures of it are made


class Unsupported(ValueError):
    """Something of other versions of Mitsuba, or of other people's plugins."""


def own_folder() -> Path:
    """Mitsuba's own folder, without importing it."""
    spec = importlib.util.find_spec("mitsuba")
    if spec is None or spec.origin is None:
        raise ValueError("mitsuba: not installed, expected a package that can be imported; pip install mitsuba.")
    return Path(spec.origin).resolve().parent


@functools.cache
def plugins() -> frozenset[str]:
    """Names of the plugins that Mitsuba ships."""
    return frozenset(path.stem for path in (own_folder() / "plugins").iterdir())


@functools.cache
def materials() -> frozenset[str]:
    """Names of the metals that Mitsuba knows."""
    return frozenset(path.name.removesuffix(".eta.spd") for path in (own_folder() / "data/ior").glob("*.eta.spd"))


def snake_case(name: str) -> str:
    """A parameter's name as Mitsuba changes those of scenes of version 1 and older: sampleCount to sample_count."""
    return re.sub("(?<=[a-z])(?=[A-Z])", "_", name).lower()


def check_plugin(kind: str) -> None:
    """Refuse all but plugins that Mitsuba ships and that paths can be traced with.

    Args:
        kind: name of the plugin.
    """
    if kind in MEDIA:
        raise ValueError(
            f"a participating medium, '{kind}', expected surfaces alone: paths do not scatter in fog here; leave it "
            "out of the shape or sensor that has it (as 'interior' or 'exterior'), or render by Mitsuba's 'volpath'."
        )
    if kind in _MEMORY:
        raise ValueError(f"a plugin {kind[:60]!r}, expected one that reads files; leave it out.")
    if kind not in plugins():
        raise Unsupported(f"a plugin {kind[:60]!r}, expected one of Mitsuba's own; leave it out.")


def check_parameters(kind: str, given: Mapping[str, object]) -> None:
    """Refuse a plugin with parameters, or without some, that Mitsuba ends the process or never ends with.

    Args:
        kind: name of the plugin.
        given: its parameters and what is within it, by name; numbers may be text.

    Raises:
        ValueError: a count, size or temperature that is out of range.
    """
    if len({snake_case(name) for name in given}) < len(given):  # Mitsuba would take one of them
        raise ValueError(f"a '{kind}' with a parameter under two names, {sorted(given)!s:.100}; leave one out.")
    given = {snake_case(name): value for name, value in given.items()}
    required = _REQUIRED.get(kind)
    if required and required not in given:
        raise ValueError(f"a plugin '{kind}' without '{required}', expected one; add it.")
    for name, (least, most) in _RANGES.items():
        number = number_of(given.get(name))
        if number is not None and not least <= number <= most:
            raise ValueError(f"a '{name}' of {number:.12g}, expected {least:,} to {most:,}; change it.")
    if kind in _HOLDERS and not any(isinstance(value, Mapping) or value is PLUGIN for value in given.values()):
        raise ValueError(f"a '{kind}' without {_HOLDERS[kind]}, expected one or more; leave it out.")


PLUGIN = object()  # in the place of what is within another one, where a number or text is no parameter
_HOLDERS = {"merge": "shapes", "shapegroup": "shapes", "volume": "a volume"}
_RANGES = {
    "sample_count": (1, _SAMPLES),
    "width": (1, _SIDE),
    "height": (1, _SIDE),
    "temperature": (1, 10**6),  # K
    "shape_index": (0, 2**31 - 1),
}


def number_of(value: object) -> float | None:
    """A number, or text that is one; None for all else."""
    try:
        return float(value) if isinstance(value, str | int | float) else None
    except (ValueError, OverflowError):
        return None
