"""What a scene may hold: plugins that Mitsuba ships, names without paths, and files where the user said they lie.

Files are regular ones of a bounded size, in folders that the user named, and nowhere else.
"""

from __future__ import annotations

import json
import math
import os
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Tensor

from metapp.rendering.scenes.plugins import MEDIA, check_parameters, check_plugin, materials, snake_case

Json = Any  # a value of a scene
SceneDict = dict[str, Any]  # as Mitsuba's `load_dict` takes it, as far as JSON holds it
BYTES = 8192  # of a scene as text: one size, so that sets of tasks can be joined


def box_film(width: int, height: int) -> SceneDict:
    """A film of so many pixels, each by itself."""
    return {"type": "hdrfilm", "width": width, "height": height, "pixel_format": "rgb", "rfilter": {"type": "box"}}


def scene_bytes(scene: SceneDict) -> Tensor:
    """A scene as its JSON text, uint8 [L], with blanks at its end up to a multiple of 8192 bytes."""
    text = json.dumps(scene, allow_nan=False).encode()
    padded = text.ljust(math.ceil(len(text) / BYTES) * BYTES)
    return torch.frombuffer(bytearray(padded), dtype=torch.uint8)


def scene_of(text: Tensor) -> SceneDict:
    """The scene whose JSON text this is, as `scene_bytes` makes it.

    Raises:
        ValueError: it is no JSON.
    """
    try:
        result: SceneDict = json.loads(text.cpu().numpy().tobytes())
        return result
    except (ValueError, RecursionError) as error:
        raise ValueError(f"a stored scene is no JSON ({error}), expected a dictionary; make the data anew.") from None


TEXT_BYTES = 2**24  # of a scene file or an include
_DATA_BYTES = 2**31  # of a mesh, bitmap or spectrum

# Data files of scenes that were read in this process. A scene is kept as text beside its samples, and may be loaded
# from it again, but text from elsewhere gives no right to read files.
_read_before: set[Path] = set()


class Places(NamedTuple):
    """Where the files of a scene may lie.

    Attributes:
        search: folders in which relative names are looked for, in this order.
        roots: resolved folders that hold all files that may be read; none: of a stored scene.
    """

    search: tuple[Path, ...] = ()
    roots: tuple[Path, ...] = ()

    @classmethod
    def beside(cls, path: Path, others: Iterable[Path] = ()) -> Places:
        """The folder of a scene file, then further folders; files may lie in each."""
        folders = tuple(folder.resolve() for folder in (path.resolve().parent, *others))
        return cls(folders, folders)

    def first(self, folder: Path) -> Places:
        """The same, with this folder searched first."""
        return self._replace(search=(folder, *self.search))

    def file(self, name: str) -> Path:
        """The data file of a name.

        Returns:
            Its absolute path without links.

        Raises:
            ValueError: it is missing, too large, no regular file, or elsewhere.
        """
        path = self._find(name, "file")
        if not path.is_file():
            raise ValueError(f"names {path!s:.200}, which is no regular file; give a mesh, bitmap or spectrum.")
        size = path.stat().st_size
        if size > _DATA_BYTES:
            raise ValueError(f"names {path!s:.200}, of {size:,} bytes, expected {_DATA_BYTES:,} at most.")
        _read_before.add(path)
        return path

    def text(self, name: str) -> tuple[Path, str]:
        """The resolved path and the content of a document that is included."""
        path = self._find(name, "include")
        return path, read_text(path)

    def folder(self, name: str) -> Path:
        """The folder of a <path>."""
        path = self._find(name, "<path>")
        if not path.is_dir():
            raise ValueError(f"a <path> {path!s:.200}, which is no folder; give one.")
        return path

    def _find(self, name: str, what: str) -> Path:
        if "\0" in name or len(name) > 1024:
            raise ValueError(f"a name of a {what}, {name[:40]!r}, expected one of up to 1024 characters, without NUL.")
        folders = (Path("/"),) if os.path.isabs(name) else self.search
        first = next((path for path in (folder / name for folder in folders) if os.path.lexists(path)), None)
        try:
            path = first.resolve(strict=True) if first else None
        except (OSError, RuntimeError):  # a link to nowhere or to itself
            path = None
        if path is None:
            raise ValueError(f"names the {what} {name[:100]!r}: file not found; put it in the scene's folder.")
        if not str(path).isprintable() or "$" in str(path):
            raise ValueError(f"names {str(path)[:150]!r}, expected a path that is printable and without '$'.")
        if not self.roots and path not in _read_before:
            raise ValueError(f"names the {what} {name[:100]!r}, expected none in a stored scene; give the scene file.")
        if self.roots and not any(path.is_relative_to(root) for root in self.roots):
            raise ValueError(
                f"names the {what} {name[:60]!r} outside the scene's folder; if you trust it, name a folder that holds "
                f"it: --scene-root {str(path if what == '<path>' else path.parent)[:120]}"
            )
        return path


def read_text(path: Path) -> str:
    """The text of a regular file; a FIFO or a device is refused at once, not waited for.

    Raises:
        ValueError: no regular file, too large, not readable, no UTF-8.
    """
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | getattr(os, "O_BINARY", 0))
    except OSError as error:
        raise ValueError(f"{error.strerror}, expected a scene of Mitsuba 3 that can be read.") from None
    try:
        if not stat.S_ISREG(os.fstat(handle).st_mode):
            raise ValueError("no regular file, expected a scene of Mitsuba 3.")
        with os.fdopen(handle, "rb", closefd=False) as file:
            content = file.read(TEXT_BYTES + 1)
    finally:
        os.close(handle)
    if len(content) > TEXT_BYTES:
        raise ValueError(f"more than {TEXT_BYTES:,} bytes, expected a scene of Mitsuba 3; put meshes in files.")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError("not text in UTF-8, expected a scene of Mitsuba 3.") from None


DEPTH = 64  # of elements or objects within each other
PARTS = 200_000  # elements, or values
TEXT = 2**20  # characters of one value


def checked_string(name: str, value: str, places: Places) -> str:
    """A parameter's text; file names come out absolute.

    Mitsuba builds file names from other parameters too, such as a conductor's material.
    """
    if snake_case(name).endswith("filename"):
        return str(places.file(value))
    if len(value) > TEXT or not value.isascii() or not value.isprintable() or set("/\\$") & set(value) or ".." in value:
        raise ValueError(f"a parameter {name[:40]!r} of {value[:60]!r}, expected plain text, no path; change it.")
    if name == "material" and value != "none" and value not in materials():
        raise ValueError(f"a material {value[:60]!r}, expected one of Mitsuba's own; change it.")
    return value


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
            check_plugin(kind)
        media = {} if depth else _media(scene)
        made = {key: self._value(key, value, depth, kind) for key, value in scene.items() if key not in media}
        if depth:
            check_parameters(kind, made)
        for key, medium in media.items():
            if any(name in (key, medium.get("id")) for name in _references(made)):
                check_plugin(medium["type"])
        return made

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


def _media(scene: SceneDict) -> dict[str, Any]:
    """The participating media that a scene declares, by key; they do nothing where no shape and no sensor has them."""
    objects = {key: value for key, value in scene.items() if isinstance(value, dict)}
    return {key: value for key, value in objects.items() if value.get("type") in tuple(MEDIA)}


def _references(value: Json) -> Iterator[str]:
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
