"""Scene dictionaries: their text, their checks, and Mitsuba's object of a checked one; imports no torch.

A scene may name plugins that Mitsuba or metapp ships, names without paths, and files that were let in alone.
"""

from __future__ import annotations

import functools
import importlib.util
import json
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from metapp.registry import registry
from metapp.rendering.types import Mitsuba, Scene
from metapp.storage import Document

SceneValue = Any  # a value of a scene

SceneDict = Document  # as Mitsuba's `load_dict` takes it, as far as JSON holds it
SCENE_FILE_READER = "the extension scene_files"
_LONGEST = 200  # characters of Mitsuba's messages


def box_film(width: int, height: int) -> SceneDict:
    """A film of so many pixels, each by itself."""
    return {"type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgb", "rfilter": {"type": "box"}}


RESOURCES_TYPE = (
    "resources"  # the type of an object that declares a folder of files; Mitsuba takes it at the root alone
)
_MEDIA = {"homogeneous", "heterogeneous"}
_MEMORY = {"blender"}  # reads addresses in memory that a scene gives as numbers
_REQUIRED = {"bitmap": "filename", "blendbsdf": "weight"}  # Mitsuba 3.9 ends the process without these
_SAMPLES = 2**20  # some samplers never come to an end with more; paths here need none
_SIDE = 2**15  # px of a film: pictures of it are made


class UnsupportedPluginError(ValueError):
    """Something of other versions of Mitsuba, or of other people's plugins."""


def mitsuba_folder() -> Path:
    """Mitsuba's own folder, without importing it."""
    spec = importlib.util.find_spec("mitsuba")
    if spec is None or spec.origin is None:
        raise ValueError("mitsuba: not installed, expected a package that can be imported; pip install mitsuba.")
    return Path(spec.origin).resolve().parent


@functools.cache
def mitsuba_plugins() -> frozenset[str]:
    """Names of the plugins that Mitsuba ships."""
    return frozenset(path.stem for path in (mitsuba_folder() / "plugins").iterdir())


def extension_bsdfs() -> list[str]:
    """Names of the BSDFs that extensions add to Mitsuba; integrators alone have help."""
    return [name for name, entry in registry().plugins.items() if not entry.help]


@functools.cache
def mitsuba_metals() -> frozenset[str]:
    """Names of the metals that Mitsuba knows."""
    return frozenset(path.name.removesuffix(".eta.spd") for path in (mitsuba_folder() / "data/ior").glob("*.eta.spd"))


def to_snake_case(name: str) -> str:
    """A parameter's name as Mitsuba changes those of scenes of version 1 and older: sampleCount to sample_count."""
    return re.sub("(?<=[a-z])(?=[A-Z])", "_", name).lower()


def check_plugin(kind: str) -> None:
    """Refuse all but plugins that Mitsuba ships and that paths can be traced with, and BSDFs of extensions.

    Args:
        kind: name of the plugin.
    """
    if kind in _MEDIA:
        raise ValueError(
            f"a participating medium, '{kind}', expected surfaces alone: paths do not scatter in fog here; leave it "
            "out of the shape or sensor that has it (as 'interior' or 'exterior'), or render by Mitsuba's 'volpath'."
        )
    if kind in _MEMORY:
        raise ValueError(f"a plugin {kind[:60]!r}, expected one that reads files; leave it out.")
    if kind == RESOURCES_TYPE:
        raise ValueError(f"a '{RESOURCES_TYPE}' within another object, expected it beside the sensor; move it there.")
    if kind not in mitsuba_plugins() and kind not in extension_bsdfs():
        raise UnsupportedPluginError(f"a plugin {kind[:60]!r}, expected one of Mitsuba's own; leave it out.")


def check_parameters(kind: str, given: Mapping[str, object]) -> None:
    """Refuse a plugin with parameters, or without some, that Mitsuba ends the process or never ends with.

    Args:
        kind: name of the plugin.
        given: its parameters and nested objects, by name; numbers may be text.

    Raises:
        ValueError: a count, size or temperature that is out of range.
    """
    if len({to_snake_case(name) for name in given}) < len(given):  # Mitsuba would take one of them
        raise ValueError(f"a '{kind}' with a parameter under two names, {sorted(given)!s:.100}; leave one out.")
    given = {to_snake_case(name): value for name, value in given.items()}
    required = _REQUIRED.get(kind)
    if required and required not in given:
        raise ValueError(f"a plugin '{kind}' without '{required}', expected one; add it.")
    for name, (least, most) in _RANGES.items():
        number = parse_number(given.get(name))
        if number is not None and not least <= number <= most:
            raise ValueError(f"a '{name}' of {number:.12g}, expected {least:,} to {most:,}; change it.")
    if kind in _HOLDERS and not any(isinstance(value, Mapping) or value is NESTED_OBJECT for value in given.values()):
        raise ValueError(f"a '{kind}' without {_HOLDERS[kind]}, expected one or more; leave it out.")


NESTED_OBJECT = object()  # in the place of what is within another one, where a number or text is no parameter
_HOLDERS = {"merge": "shapes", "shapegroup": "shapes", "volume": "a volume"}
_RANGES = {
    "sample_count": (1, _SAMPLES),
    "width": (1, _SIDE),
    "height": (1, _SIDE),
    "temperature": (1, 10**6),  # K
    "shape_index": (0, 2**31 - 1),
}


def parse_number(value: object) -> float | None:
    """A number, or text that is one; None for all else."""
    try:
        return float(value) if isinstance(value, str | int | float) else None
    except (ValueError, OverflowError):
        return None


class SceneFiles:
    """The data files that a scene may name: none, which holds of scenes of data sets."""

    def file(self, name: str) -> Path:
        """The data file of a name.

        Returns:
            Its absolute path without links.

        Raises:
            ValueError: it may not be read.
        """
        raise ValueError(f"names the file {name[:100]!r}, expected none; scenes with files need {SCENE_FILE_READER}.")

    def first(self, folder: str) -> SceneFiles:
        """The files of a scene that declares a folder, in which relative names are looked for before all others.

        Raises:
            ValueError: it may not be read.
        """
        raise ValueError(
            f"names the folder {folder[:100]!r}, expected none; scenes with files need {SCENE_FILE_READER}."
        )

    def check(self, kind: str, parameters: Mapping[str, object]) -> None:
        """Refuse parameters of a plugin that name a file which Mitsuba cannot take; file names are absolute."""


MAX_NESTED_LEVELS = 64  # of elements or objects within each other
MAX_SCENE_VALUES = 200_000  # elements, or values
MAX_VALUE_CHARACTERS = 2**20  # characters of one value


def check_string(name: str, value: str, files: SceneFiles) -> str:
    """A parameter's text; file names come out absolute.

    Mitsuba builds file names from other parameters too, such as a conductor's material.
    """
    if to_snake_case(name).endswith("filename"):
        return str(files.file(value))
    plain = value.isascii() and value.isprintable()
    if len(value) > MAX_VALUE_CHARACTERS or not plain or set("/\\$") & set(value) or ".." in value:
        raise ValueError(f"a parameter {name[:40]!r} of {value[:60]!r}, expected plain text, no path; change it.")
    if name == "material" and value != "none" and value not in mitsuba_metals():
        raise ValueError(f"a material {value[:60]!r}, expected one of Mitsuba's own; change it.")
    return value


class SceneChecker:
    """Checks a scene dictionary as JSON holds it: kinds of all values, plugins, file names.

    Args:
        files: that it may name.
        most_values: of the whole scene.
    """

    def __init__(self, files: SceneFiles, most_values: int = MAX_SCENE_VALUES) -> None:
        self.files, self.parts, self.most_values = files, 0, most_values

    def object(self, scene: SceneDict, depth: int = 0) -> SceneDict:
        """The same with file names absolute.

        Raises:
            ValueError: something that a scene may not hold.
        """
        kind = scene.get("type")
        if not isinstance(kind, str):
            raise ValueError(f"an object of type {_shown(kind)}, expected each to name a plugin as 'type'; add it.")
        if depth >= MAX_NESTED_LEVELS:
            raise ValueError(f"objects within each other, {MAX_NESTED_LEVELS} deep, expected fewer.")
        for key in scene:
            if not isinstance(key, str) or not key.isprintable() or not 0 < len(key) < 256 or "." in key:
                raise ValueError(f"a key {str(key)[:60]!r}, expected 1 to 255 characters, none of them a point.")
        if kind in ("rgb", "spectrum", "ref") and depth:
            self._check_plain(kind, scene)
        elif (kind == "scene") != (depth == 0):
            raise ValueError("a scene within a scene, or none at all, expected one around all else.")
        elif depth:
            check_plugin(kind)
        media = {} if depth else _media(scene)
        scene = scene if depth else self._without_folders(scene)
        made = {key: self._value(key, value, depth, kind) for key, value in scene.items() if key not in media}
        if depth:
            check_parameters(kind, made)
            self.files.check(kind, made)
        for key, medium in media.items():
            if any(name in (key, medium.get("id")) for name in _references(made)):
                check_plugin(medium["type"])
        return made

    def _without_folders(self, scene: SceneDict) -> SceneDict:
        """The scene without its declarations of folders, of type `resources`, in which all its files are looked for."""
        left = {}
        for key, value in scene.items():
            if not (isinstance(value, dict) and value.get("type") == RESOURCES_TYPE):
                left[key] = value
                continue
            path = value.get("path")
            if not isinstance(path, str) or value.keys() - {"type", "id", "path"}:
                raise ValueError(
                    f"a '{RESOURCES_TYPE}' {key[:40]!r}, expected a 'path' alone, the name of a folder; change it."
                )
            self.files = self.files.first(path)
        return left

    def _value(self, key: str, value: SceneValue, depth: int, kind: str) -> SceneValue:
        self.parts += 1
        if self.parts > self.most_values:
            raise ValueError(f"more than {self.most_values:,} values, expected fewer; put meshes in files.")
        if isinstance(value, dict):
            return self.object(value, depth + 1)
        if isinstance(value, str):
            if key in ("type", "id"):
                return _identifier(value)
            return check_string(key, value, self.files)
        if key in ("type", "id") or not (_is_number(value) or isinstance(value, bool) or _is_list(value, kind)):
            raise ValueError(
                f"a value of {key[:40]!r}, {_shown(value)}, expected a finite number, text, true, false, three "
                "numbers, a matrix or an object; change it."
            )
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


def _media(scene: SceneDict) -> dict[str, SceneDict]:
    """The participating media that a scene declares, by key; they do nothing if no shape and no sensor has them."""
    objects = {key: value for key, value in scene.items() if isinstance(value, dict)}
    return {key: value for key, value in objects.items() if value.get("type") in tuple(_MEDIA)}


def _references(value: SceneValue) -> Iterator[str]:
    """The names that an object refers to."""
    if isinstance(value, dict):
        if value.get("type") == "ref":
            yield value["id"]
        for part in value.values():
            yield from _references(part)


def _identifier(value: str) -> str:
    if not value.isprintable() or len(value) > 256:
        raise ValueError(f"a name {value[:40]!r}, expected up to 256 printable characters.")
    return value


def _shown(value: SceneValue) -> str:
    """A value in a message; text of a deeply nested list would need a deep stack."""
    plain = value is None or isinstance(value, str | int | float)
    return repr(value if plain else type(value).__name__)[:40]


def _is_number(value: SceneValue) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) < 2**63 if isinstance(value, int) else math.isfinite(value)


def _is_list(value: SceneValue, kind: str) -> bool:
    """True if a value is three numbers, a matrix of nine or sixteen, or pairs of a spectrum."""
    if not isinstance(value, list) or not value or len(value) > MAX_SCENE_VALUES:
        return False
    if kind == "spectrum":
        return all(isinstance(pair, list) and len(pair) == 2 and all(map(_is_number, pair)) for pair in value)
    if all(map(_is_number, value)):
        return len(value) == 3
    square = len(value) in (3, 4) and all(isinstance(row, list) and len(row) == len(value) for row in value)
    return square and kind != "rgb" and all(_is_number(number) for row in value for number in row)


def instantiate_scene(mi: Mitsuba, scene: dict[str, SceneValue]) -> Scene:
    """A checked scene in Mitsuba, in this thread: others would write their messages to the screen."""
    text = json.dumps(scene)
    for name in extension_bsdfs():
        if name in text:
            registry().plugins[name].load()()
    if "xml" in scene:
        return mi.load_string(scene["xml"], parallel=False)
    return mi.load_dict(_matrices(mi, scene), parallel=False)


def _matrices(mi: Mitsuba, value: SceneValue) -> SceneValue:
    """The same with its matrices as Mitsuba wants them."""
    if isinstance(value, dict):
        plain = value.get("type") in ("rgb", "spectrum")
        return {key: part if plain else _matrices(mi, part) for key, part in value.items()}
    if isinstance(value, list) and isinstance(value[0], list):
        return mi.ScalarTransform4f(value) if len(value) == 4 else mi.ScalarTransform3f(value)
    return value


def shorten_mitsuba_message(reason: str) -> str:
    """Mitsuba's message of an error, or that of an extension's BSDF alone, in one line."""
    reason = reason.rpartition("ValueError: ")[2]
    reason = re.sub(r"\[\w+\.(?:cpp|h):\d+\] |\s+", lambda part: " " if part[0].isspace() else "", reason).strip()
    return reason if len(reason) <= _LONGEST else f"{reason[: _LONGEST // 2]} ... {reason[5 - _LONGEST // 2 :]}"
