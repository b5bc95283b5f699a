"""What a scene may hold: plugins that Mitsuba ships, names without paths, and files where they may lie."""

from __future__ import annotations

import functools
import importlib.util
import math
from pathlib import Path

from metapp.rendering.scene_files import Places
from metapp.rendering.scene_text import Json, SceneDict

DEPTH = 64  # of elements or objects within each other
PARTS = 200_000  # elements, or values
TEXT = 2**20  # characters of one value

_SAMPLES = 2**20
_MEDIA = {"homogeneous", "heterogeneous"}
_MEMORY = {"blender"}  # reads addresses in memory that a scene gives as numbers
_REQUIRED = {"bitmap": "filename", "blendbsdf": "weight"}  # Mitsuba 3.9 ends the process without these


def own_folder() -> Path:
    """Mitsuba's own folder, without importing it."""
    spec = importlib.util.find_spec("mitsuba")
    if spec is None or spec.origin is None:
        raise ValueError("mitsuba: not installed, expected a package that can be imported; pip install mitsuba.")
    return Path(spec.origin).resolve().parent


@functools.cache
def _plugins() -> frozenset[str]:
    return frozenset(path.stem for path in (own_folder() / "plugins").iterdir())


@functools.cache
def _materials() -> frozenset[str]:
    return frozenset(path.name.removesuffix(".eta.spd") for path in (own_folder() / "data/ior").glob("*.eta.spd"))


def check_plugin(kind: str, given: set[str]) -> None:
    """Refuse all but plugins that Mitsuba ships and that paths can be traced with.

    Args:
        kind: name of the plugin.
        given: names of the parameters that the scene gives it.
    """
    if kind in _MEDIA:
        raise ValueError(f"a participating medium, '{kind}', expected surfaces alone; leave it out.")
    if kind not in _plugins() or kind in _MEMORY:
        raise ValueError(f"a plugin {kind[:60]!r}, expected one of Mitsuba's own; leave it out.")
    required = _REQUIRED.get(kind)
    if required and required not in given:
        raise ValueError(f"a plugin '{kind}' without '{required}', expected one; add it.")


def checked_string(name: str, value: str, places: Places) -> str:
    """A parameter's text; file names come out absolute.

    Mitsuba builds file names from other parameters too, such as a conductor's material.
    """
    if name.endswith("filename"):
        return str(places.file(value))
    if len(value) > TEXT or not value.isascii() or not value.isprintable() or set("/\\$") & set(value) or ".." in value:
        raise ValueError(f"a parameter {name[:40]!r} of {value[:60]!r}, expected plain text, no path; change it.")
    if name == "material" and value != "none" and value not in _materials():
        raise ValueError(f"a material {value[:60]!r}, expected one of Mitsuba's own; change it.")
    return value


def check_samples(name: str, value: float) -> None:
    """Refuse a count of samples that some of Mitsuba's samplers never come to an end with; paths here need none."""
    if name == "sample_count" and value > _SAMPLES:
        raise ValueError(f"a 'sample_count' of {value:.0f}, expected {_SAMPLES:,} at most; lower it.")


class CheckedDict:
    """Checks a scene dictionary as JSON holds it: kinds of all values, plugins, file names.

    Args:
        places: where its files may lie.
    """

    def __init__(self, places: Places) -> None:
        self.places, self.parts = places, 0

    def object(self, scene: SceneDict, depth: int = 0) -> SceneDict:
        """The same with file names absolute.

        Raises:
            ValueError: something that a scene may not hold.
        """
        kind = scene.get("type")
        if not isinstance(kind, str):
            raise ValueError(f"an object of type {_shown(kind)}, expected each to name a plugin as 'type'; add it.")
        if depth >= DEPTH:
            raise ValueError(f"objects within each other, {DEPTH} deep, expected fewer.")
        for key in scene:
            if not isinstance(key, str) or not key.isprintable() or not 0 < len(key) < 256 or "." in key:
                raise ValueError(f"a key {str(key)[:60]!r}, expected 1 to 255 characters, none of them a point.")
        if kind in ("rgb", "spectrum", "ref") and depth:
            self._check_plain(kind, scene)
        elif (kind == "scene") != (depth == 0):
            raise ValueError("a scene within a scene, or none at all, expected one around all else.")
        elif depth:
            check_plugin(kind, set(scene))
        return {key: self._value(key, value, depth, kind) for key, value in scene.items()}

    def _value(self, key: str, value: Json, depth: int, kind: str) -> Json:
        self.parts += 1
        if self.parts > PARTS:
            raise ValueError(f"more than {PARTS:,} values, expected fewer; put meshes in files.")
        if isinstance(value, dict):
            return self.object(value, depth + 1)
        if isinstance(value, str):
            if key in ("type", "id"):
                return _identifier(value)
            return checked_string(key, value, self.places)
        if key in ("type", "id") or not (_is_number(value) or isinstance(value, bool) or _is_list(value, kind)):
            raise ValueError(
                f"a value of {key[:40]!r}, {_shown(value)}, expected a finite number, text, true, false, three "
                "numbers, a matrix or an object; change it."
            )
        if _is_number(value):
            check_samples(key, value)
        return value

    def _check_plain(self, kind: str, scene: SceneDict) -> None:
        """Refuse a colour, spectrum or reference that holds something else than it should."""
        expected = {"rgb": ({"value"},), "ref": ({"id"},), "spectrum": ({"value"}, {"filename"})}[kind]
        found = set(scene) - {"type"}
        value = scene.get("value", 0.0)
        fits = _is_number(value) or (isinstance(value, list) and _is_list(value, kind))
        if found not in expected or not fits:
            names = " or ".join(next(iter(keys)) for keys in expected)
            raise ValueError(f"a '{kind}' with {sorted(found)!s:.60}, expected '{names}' of numbers or text.")


def _identifier(value: str) -> str:
    if not value.isprintable() or len(value) > 256:
        raise ValueError(f"a name {value[:40]!r}, expected up to 256 printable characters.")
    return value


def _shown(value: Json) -> str:
    """A value in a message; text of a deeply nested list would need a deep stack."""
    plain = value is None or isinstance(value, str | int | float)
    return repr(value if plain else type(value).__name__)[:40]


def _is_number(value: Json) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) < 2**63 if isinstance(value, int) else math.isfinite(value)


def _is_list(value: Json, kind: str) -> bool:
    """Whether a value is three numbers, a matrix of nine or sixteen, or pairs of a spectrum."""
    if not isinstance(value, list) or not value or len(value) > PARTS:
        return False
    if kind == "spectrum":
        return all(isinstance(pair, list) and len(pair) == 2 and all(map(_is_number, pair)) for pair in value)
    if all(map(_is_number, value)):
        return len(value) == 3
    square = len(value) in (3, 4) and all(isinstance(row, list) and len(row) == len(value) for row in value)
    return square and kind != "rgb" and all(_is_number(number) for row in value for number in row)
