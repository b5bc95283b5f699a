"""Scene dictionaries: their text, their checks, and Mitsuba's object of a checked one.

A scene may name plugins that Mitsuba or metapp ships, by names without paths, and files that the user let in, alone:
Mitsuba would run libraries and read any file that a stranger's scene names. Imports no torch, so that workers which
check scenes start quickly.
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
from metapp.rendering.scenes.expansion import check_expansion
from metapp.rendering.scenes.spectra import check_spectrum, check_spectrum_plugin
from metapp.rendering.types import Mitsuba, Scene
from metapp.storage import Document

SceneValue = Any  # a value in a scene's dictionary

SceneDict = Document  # an argument of Mitsuba's `load_dict`, of values that JSON can hold
SCENE_FILE_READER = "the extension scene_files"
_MESSAGE_CHARACTERS = 200  # characters of Mitsuba's messages that are shown


def box_film(width: int, height: int) -> SceneDict:
    """Return the dictionary of a film of so many pixels whose filter does not reach into neighbouring pixels."""
    return {"type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgb", "rfilter": {"type": "box"}}


# the type of an object that declares a folder of files; Mitsuba takes it at the root alone
RESOURCES_TYPE = "resources"
_MEDIUM_PLUGINS = {"homogeneous", "heterogeneous"}
_MEMORY_PLUGINS = {"blender"}  # these read addresses in memory that a scene gives as numbers
_REQUIRED_PARAMETERS = {"bitmap": "filename", "blendbsdf": "weight"}  # Mitsuba 3.9 ends the process without these
_MAX_SAMPLE_COUNT = 2**20  # some samplers never come to an end with more; paths here need no sampler
_MAX_FILM_PX = 2**15  # greatest side of a film, px: pictures of this size are made
MAX_FILE_MEMORY_BYTES = 3 * 2**30  # memory that the files of a scene take in Mitsuba, decoded, as their headers state


class UnsupportedPluginError(ValueError):
    """The error of a scene that names something of other versions of Mitsuba, or a plugin by other people."""


def mitsuba_folder() -> Path:
    """Return Mitsuba's own folder, without importing it.

    Raises:
        ValueError: Mitsuba is not installed.
    """
    spec = importlib.util.find_spec("mitsuba")
    if spec is None or spec.origin is None:
        raise ValueError("mitsuba: not installed, expected a package that can be imported; pip install mitsuba.")
    return Path(spec.origin).resolve().parent


@functools.cache
def mitsuba_plugins() -> frozenset[str]:
    """Return the names of the plugins that Mitsuba ships."""
    return frozenset(path.stem for path in (mitsuba_folder() / "plugins").iterdir())


def extension_bsdfs() -> list[str]:
    """Return the names of the BSDFs that extensions add to Mitsuba; of plugins, integrators alone have help."""
    return [name for name, entry in registry().plugins.items() if not entry.integrator]


@functools.cache
def mitsuba_metals() -> frozenset[str]:
    """Return the names of the metals that Mitsuba knows."""
    return frozenset(path.name.removesuffix(".eta.spd") for path in (mitsuba_folder() / "data/ior").glob("*.eta.spd"))


def is_file_name(name: str) -> bool:
    """Return whether a parameter of a name is the name of a file; scenes of version 0.6 have `normalFilename`, too."""
    return name.lower().endswith("filename")


def check_plugin(kind: str) -> None:
    """Refuse all plugins but BSDFs of extensions and plugins by Mitsuba that paths can be traced with.

    Args:
        kind: name of the plugin.

    Raises:
        ValueError: a participating medium, a plugin that reads memory, or a declaration of a folder in the wrong place.
        UnsupportedPluginError: another plugin.
    """
    if kind in _MEDIUM_PLUGINS:
        raise ValueError(
            f"a participating medium, '{kind}', expected surfaces alone: paths do not scatter in fog here; leave it "
            "out of the shape or sensor that has it (as 'interior' or 'exterior'), or render by Mitsuba's 'volpath'."
        )
    if kind in _MEMORY_PLUGINS:
        raise ValueError(f"a plugin {kind[:60]!r}, expected one that reads files; leave it out.")
    if kind == RESOURCES_TYPE:
        raise ValueError(f"a '{RESOURCES_TYPE}' within another object, expected it beside the sensor; move it there.")
    if kind not in mitsuba_plugins() and kind not in extension_bsdfs():
        raise UnsupportedPluginError(f"a plugin {kind[:60]!r}, expected one of Mitsuba's own; leave it out.")


def check_parameters(kind: str, given: Mapping[str, object]) -> None:
    """Refuse a plugin whose parameters, or lack of them, would end Mitsuba's process or never let it end.

    Args:
        kind: name of the plugin.
        given: its parameters and nested objects, by name.

    Raises:
        ValueError: a count, size or temperature that is out of range; a parameter or an object that is missing; a
            spectrum of no use.
    """
    check_spectrum_plugin(kind, given)
    required = _REQUIRED_PARAMETERS.get(kind)
    if required and required not in given:
        raise ValueError(f"a plugin '{kind}' without '{required}', expected one; add it.")
    for name, (low, high) in _NUMBER_RANGES.items():
        number = given.get(name)
        if isinstance(number, int | float) and not low <= number <= high:
            raise ValueError(f"a '{name}' of {number:.12g}, expected {low:,} to {high:,}; change it.")
    if kind in _REQUIRED_CHILDREN and not any(isinstance(value, Mapping) for value in given.values()):
        raise ValueError(f"a '{kind}' without {_REQUIRED_CHILDREN[kind]}, expected one or more; leave it out.")


_REQUIRED_CHILDREN = {"merge": "shapes", "shapegroup": "shapes", "volume": "a volume"}
_NUMBER_RANGES = {
    "sample_count": (1, _MAX_SAMPLE_COUNT),
    "width": (1, _MAX_FILM_PX),
    "height": (1, _MAX_FILM_PX),
    "temperature": (1, 10**6),  # K
    "shape_index": (0, 2**31 - 1),
}


class SceneFiles:
    """The data files that a scene may name: none in this class, as is right for scenes of data sets."""

    def resolve_file(self, name: str) -> Path:
        """Return the data file of a name, as an absolute path without links.

        Raises:
            ValueError: it may not be read.
        """
        raise ValueError(f"names the file {name[:100]!r}, expected none; scenes with files need {SCENE_FILE_READER}.")

    def search_first(self, folder: str) -> SceneFiles:
        """Return the files of a scene that declares a folder, in which relative names are looked for before all others.

        Raises:
            ValueError: it may not be read.
        """
        raise ValueError(
            f"names the folder {folder[:100]!r}, expected none; scenes with files need {SCENE_FILE_READER}."
        )

    def memory_bytes(self, kind: str, parameters: Mapping[str, object]) -> int:
        """Return the memory that Mitsuba needs for the files which a plugin's parameters name, by absolute names.

        Raises:
            ValueError: Mitsuba cannot take a file.
        """
        return 0


MAX_NESTED_LEVELS = 64  # levels of elements or objects within each other
MAX_SCENE_VALUES = 200_000  # elements of an XML document, or values of a dictionary
MAX_VALUE_CHARACTERS = 2**20  # characters of one value


def check_string(name: str, value: str, files: SceneFiles) -> str:
    """Check a parameter's text, and return it; file names come out absolute.

    Mitsuba builds file names from other parameters too, such as a conductor's material.

    Args:
        name: name of the parameter.
        value: its text.
        files: the files that the scene may name.

    Raises:
        ValueError: a file that may not be read, a path where none is expected, or an unknown material.
    """
    if is_file_name(name):
        return str(files.resolve_file(value))
    plain = value.isascii() and value.isprintable()
    if len(value) > MAX_VALUE_CHARACTERS or not plain or set("/\\$") & set(value) or ".." in value:
        raise ValueError(f"a parameter {name[:40]!r} of {value[:60]!r}, expected plain text, no path; change it.")
    if name == "material" and value != "none" and value not in mitsuba_metals():
        raise ValueError(f"a material {value[:60]!r}, expected one of Mitsuba's own; change it.")
    return value


class SceneChecker:
    """A check of one scene dictionary as JSON holds it: kinds of all values, plugins, file names.

    Args:
        files: the files that it may name.
        most_values: greatest number of values in the whole scene.

    Attributes:
        value_count: the number of values that were checked so far.
        file_bytes: the memory that the files take which were checked so far, each as often as it is named.
    """

    def __init__(self, files: SceneFiles, most_values: int = MAX_SCENE_VALUES) -> None:
        self.files, self.value_count, self.file_bytes, self.most_values = files, 0, 0, most_values

    def check_object(self, scene: SceneDict, path: tuple[str, ...] = ()) -> SceneDict:
        """Check an object of a scene, and return it with file names absolute.

        Args:
            scene: the object, or the whole scene.
            path: keys by which the object is found in the scene.

        Raises:
            ValueError: something that a scene may not hold.
        """
        depth = len(path)
        kind = scene.get("type")
        if not isinstance(kind, str):
            raise ValueError(
                f"an object of type {_describe_value(kind)}, expected each to name a plugin as 'type'; add it."
            )
        if depth >= MAX_NESTED_LEVELS:
            raise ValueError(f"objects within each other, {MAX_NESTED_LEVELS} deep, expected fewer.")
        for key in scene:
            if not isinstance(key, str) or not key.isprintable() or not 0 < len(key) < 256 or "." in key:
                raise ValueError(f"a key {str(key)[:60]!r}, expected 1 to 255 characters, none of them a point.")
        if kind in ("rgb", "spectrum", "ref") and depth:
            self._check_plain(kind, scene, path)
        elif (kind == "scene") != (depth == 0):
            raise ValueError("a scene within a scene, or none at all, expected one around all else.")
        elif depth:
            try:
                check_plugin(kind)
            except UnsupportedPluginError as error:  # as Mitsuba says where
                raise UnsupportedPluginError(f'dictionary node "{".".join(path)[:100]}": {error}') from None
        media = {} if depth else _declared_media(scene)
        scene = scene if depth else self._take_folders(scene)
        checked = {
            key: self._check_value(value, (*path, key), kind) for key, value in scene.items() if key not in media
        }
        if depth:
            check_parameters(kind, checked)
            self._check_memory(kind, checked)
        else:
            check_expansion(checked)
        referenced_names = set(_referenced_names(checked)) if media else set()
        for key, medium in media.items():
            if not referenced_names.isdisjoint((key, str(medium.get("id")))):
                check_plugin(medium["type"])
        return checked

    def _check_memory(self, kind: str, parameters: Mapping[str, object]) -> None:
        """Refuse a plugin whose files, with all files before, need more memory than a scene may take."""
        self.file_bytes += self.files.memory_bytes(kind, parameters)
        if self.file_bytes > MAX_FILE_MEMORY_BYTES:
            name = Path(str(parameters.get("filename"))).name
            raise ValueError(
                f"names the file {name[:60]!r}, with which all files decoded take {self.file_bytes:,} bytes, expected "
                f"{MAX_FILE_MEMORY_BYTES:,} at most; make pictures smaller, and meshes and volumes coarser."
            )

    def _take_folders(self, scene: SceneDict) -> SceneDict:
        """Return the scene without its declarations of folders, of type `resources`.

        From then on, all its files are looked for in these folders first.
        """
        remaining = {}
        for key, value in scene.items():
            if not (isinstance(value, dict) and value.get("type") == RESOURCES_TYPE):
                remaining[key] = value
                continue
            path = value.get("path")
            if not isinstance(path, str) or value.keys() - {"type", "id", "path"}:
                raise ValueError(
                    f"a '{RESOURCES_TYPE}' {key[:40]!r}, expected a 'path' alone, the name of a folder; change it."
                )
            self.files = self.files.search_first(path)
        return remaining

    def _check_value(self, value: SceneValue, path: tuple[str, ...], kind: str) -> SceneValue:
        """Check a value of an object of a kind, and return it with file names absolute."""
        key = path[-1]
        self.value_count += 1
        if self.value_count > self.most_values:
            raise ValueError(f"more than {self.most_values:,} values, expected fewer; put meshes in files.")
        if isinstance(value, dict):
            return self.check_object(value, path)
        if isinstance(value, str):
            if key in ("type", "id"):
                return _check_identifier(value)
            return check_string(key, value, self.files)
        if key in ("type", "id") or not (_is_number(value) or isinstance(value, bool) or _is_number_list(value, kind)):
            raise ValueError(
                f"a value of {key[:40]!r}, {_describe_value(value)}, expected a finite number, text, true, false, "
                "three numbers, a matrix or an object; change it."
            )
        return value

    def _check_plain(self, kind: str, scene: SceneDict, path: tuple[str, ...]) -> None:
        """Refuse a colour, spectrum or reference that holds anything but its value."""
        expected = {"rgb": ({"value"},), "ref": ({"id"},), "spectrum": ({"value"}, {"filename"})}[kind]
        found = set(scene) - {"type"}
        value = scene.get("value", 0.0)
        fits = _is_number(value) or (isinstance(value, list) and _is_number_list(value, kind))
        if found not in expected or not fits:
            names = " or ".join(next(iter(keys)) for keys in expected)
            raise ValueError(f"a '{kind}' with {sorted(found)!s:.60}, expected '{names}' of finite numbers or text.")
        if kind == "spectrum" and "value" in scene:
            rows = value if isinstance(value, list) else [[wavelength, value] for wavelength in (360, 830)]
            try:
                check_spectrum((f"pair {index}", row) for index, row in enumerate(rows, 1))
            except ValueError as error:
                raise ValueError(f'dictionary node "{".".join(path[:-1])[:100]}": {error}') from None


def _declared_media(scene: SceneDict) -> dict[str, SceneDict]:
    """Return the participating media that a scene declares, by key; without a shape or sensor they do nothing."""
    objects = {key: value for key, value in scene.items() if isinstance(value, dict)}
    return {key: value for key, value in objects.items() if value.get("type") in tuple(_MEDIUM_PLUGINS)}


def _referenced_names(value: SceneValue) -> Iterator[str]:
    """Yield the names that an object refers to."""
    if isinstance(value, dict):
        if value.get("type") == "ref":
            yield value["id"]
        for part in value.values():
            yield from _referenced_names(part)


def _check_identifier(value: str) -> str:
    """Check the name of a plugin or object, and return it."""
    if not value.isprintable() or len(value) > 256:
        raise ValueError(f"a name {value[:40]!r}, expected up to 256 printable characters.")
    return value


def _describe_value(value: SceneValue) -> str:
    """Return a value as a message shows it, or its type if it is a list or an object.

    The text of a deeply nested list would need a deep stack.
    """
    plain = value is None or isinstance(value, str | int | float)
    return repr(value if plain else type(value).__name__)[:40]


def _is_number(value: SceneValue) -> bool:
    """Return whether a value is a finite number that Mitsuba can hold."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return abs(value) < 2**63 if isinstance(value, int) else math.isfinite(value)


def _is_number_list(value: SceneValue, kind: str) -> bool:
    """Return whether a value is three numbers, a matrix of nine or sixteen, or pairs of numbers of a spectrum."""
    if not isinstance(value, list) or not value or len(value) > MAX_SCENE_VALUES:
        return False
    if kind == "spectrum":
        return all(isinstance(pair, list) and len(pair) == 2 and all(map(_is_number, pair)) for pair in value)
    if all(map(_is_number, value)):
        return len(value) == 3
    square = len(value) in (3, 4) and all(isinstance(row, list) and len(row) == len(value) for row in value)
    return square and kind != "rgb" and all(_is_number(number) for row in value for number in row)


def instantiate_scene(mi: Mitsuba, scene: dict[str, SceneValue]) -> Scene:
    """Make Mitsuba's object of a checked scene, in this thread: others would write their messages to the screen.

    Args:
        mi: Mitsuba, in its variant.
        scene: the scene's dictionary.
    """
    text = json.dumps(scene)
    for name in extension_bsdfs():
        if name in text:
            registry().plugins[name].load()()
    return mi.load_dict(_to_mitsuba_matrices(mi, scene), parallel=False)


def _to_mitsuba_matrices(mi: Mitsuba, value: SceneValue) -> SceneValue:
    """Return a value with nested lists turned into Mitsuba's matrices."""
    if isinstance(value, dict):
        plain = value.get("type") in ("rgb", "spectrum")
        return {key: child if plain else _to_mitsuba_matrices(mi, child) for key, child in value.items()}
    if isinstance(value, list) and isinstance(value[0], list):
        return mi.ScalarTransform4d(value) if len(value) == 4 else mi.ScalarTransform3f(value)
    return value


def shorten_mitsuba_message(reason: str) -> str:
    """Shorten a message of Mitsuba to one line.

    If an extension's BSDF raised the error, its message alone remains.
    """
    reason = reason.rpartition("ValueError: ")[2]
    reason = re.sub(r"\[\w+\.(?:cpp|h):\d+\] |\s+", lambda match: " " if match[0].isspace() else "", reason).strip()
    return (
        reason
        if len(reason) <= _MESSAGE_CHARACTERS
        else f"{reason[: _MESSAGE_CHARACTERS // 2]} ... {reason[5 - _MESSAGE_CHARACTERS // 2 :]}"
    )
