"""Places of files of scenes: regular files of a bounded size, in folders that the user named alone.

Pictures and volumes are of a size that Mitsuba can take.
"""

from __future__ import annotations

import contextlib
import math
import os
import re
import struct
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import OpenImageIO as oiio

from data_tools.readers.image_files import (
    check_memory,
    check_size,
    last_oiio_error,
    shorten_oiio_error,
    silence_libraries,
)
from metapp.rendering.scenes.rules import SceneFiles, to_snake_case
from metapp.storage.files import open_regular, open_text, placeholder_line

MAX_TEXT_CHARACTERS = 2**24  # characters of a scene file or an include
MAX_DATA_BYTES = 2**31  # of a mesh, bitmap or spectrum
_VOLUME = struct.Struct("<4s5i")  # VOL and a version, type, width, height, depth, channels
_BOX_BYTES = 24
_DRIVE = re.compile(r"[A-Za-z]:[\\/]")  # begins an absolute name of Windows

# Data files of scenes that were read in this process. A scene is kept as text beside its samples, and may be loaded
# from it again, but text from elsewhere gives no right to read files.
_read_before: set[Path] = set()


@dataclass(frozen=True)
class ScenePlaces(SceneFiles):
    """Places of the files of a scene.

    Attributes:
        search: folders in which relative names are looked for, in this order.
        roots: resolved folders that hold all files that may be read; none: of a stored scene.
        most_bytes: of a mesh, bitmap or spectrum.
    """

    search: tuple[Path, ...] = ()
    roots: tuple[Path, ...] = ()
    most_bytes: int = MAX_DATA_BYTES

    @classmethod
    def beside(cls, path: Path, others: Iterable[Path] = ()) -> ScenePlaces:
        """The folder of a scene file, then further folders; files may lie in each."""
        folders = tuple(folder.resolve() for folder in (path.resolve().parent, *others))
        return cls(folders, folders)

    def first(self, folder: str | Path) -> ScenePlaces:
        """The places with a folder searched first: a path, or the name of one, as of <path>."""
        path = folder if isinstance(folder, Path) else self.folder(folder)
        return replace(self, search=(path, *self.search))

    def file(self, name: str) -> Path:
        """The data file of a name.

        Returns:
            Its absolute path without links.

        Raises:
            ValueError: it is missing, too large, no regular file, elsewhere, or stands for another file.
        """
        path = self._find(name, "file")
        if not path.is_file():
            raise ValueError(f"names {path!s:.200}, which is no regular file; give a mesh, bitmap or spectrum.")
        size = path.stat().st_size
        if size > self.most_bytes:
            raise ValueError(f"names {path!s:.200}, of {size:,} bytes, expected {self.most_bytes:,} at most.")
        if line := placeholder_line(path):
            raise ValueError(f"names {line}")
        _read_before.add(path)
        return path

    def check(self, kind: str, parameters: Mapping[str, object]) -> None:
        """Refuse a picture or volume that takes too much memory."""
        for name, value in parameters.items():
            if to_snake_case(name) == "filename" and isinstance(value, str):
                check_data_file(kind, Path(value))

    def text(self, name: str) -> tuple[Path, str]:
        """The resolved path and the content of a document that is included."""
        path = self._find(name, "include")
        return path, read_scene_text(path)

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
        first = first or next(filter(None, (_spelled_otherwise(folder, name) for folder in folders)), None)
        try:
            path = first.resolve(strict=True) if first else None
        except (OSError, RuntimeError):  # a link to nowhere or to itself
            path = None
        if path is None:
            elsewhere = ", and name it without its drive" if _DRIVE.match(name) else ""
            raise ValueError(
                f"names the {what} {name[:100]!r}: file not found; put it in the scene's folder{elsewhere}."
            )
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


def _spelled_otherwise(folder: Path, name: str) -> Path | None:
    """The file that a name means on Windows, where backslashes divide and case does not count; None if not just one."""
    path = folder
    for part in name.replace("\\", "/").split("/"):
        if part in ("", ".", "..") or os.path.lexists(path / part):
            path = path / part
            continue
        try:
            alike = [each for each in os.listdir(path) if each.casefold() == part.casefold()]
        except OSError:
            return None
        if len(alike) != 1:
            return None
        path = path / alike[0]
    return path


def read_scene_text(path: Path, most_characters: int = MAX_TEXT_CHARACTERS) -> str:
    """Read the text of a regular file; a FIFO or a device is refused at once, not waited for.

    Args:
        path: of the file.
        most_characters: of the text.

    Raises:
        ValueError: no regular file, too large, not readable, no text.
    """
    try:
        with open_text(path) as file:
            content = file.read(most_characters + 1)
    except UnicodeDecodeError:
        raise ValueError("not text in UTF-8 or UTF-16, expected a scene of Mitsuba 3.") from None
    except (IsADirectoryError, ValueError) as error:
        found = placeholder_line(path).removeprefix(f"{path}: ") if isinstance(error, ValueError) else ""
        raise ValueError(found or "no regular file, expected a scene of Mitsuba 3.") from None
    except OSError as error:
        raise ValueError(f"{error.strerror}, expected a scene of Mitsuba 3 that can be read.") from None
    if len(content) > most_characters:
        raise ValueError(
            f"more than {most_characters:,} characters, expected a scene of Mitsuba 3; put meshes in files."
        )
    return content


def check_data_file(kind: str, path: Path) -> None:
    """Refuse a file that would take the memory of a much larger one, or whose grid is empty; values are not looked at.

    Args:
        kind: name of the plugin that reads it; of others than pictures and volumes nothing is checked.
        path: of the file.

    Raises:
        ValueError: no image or volume, or one of another size than it may have, naming the file.
    """
    check = {"bitmap": _check_picture, "envmap": _check_picture, "gridvolume": _check_volume, "sdfgrid": _check_volume}
    if kind not in check:
        return
    try:
        check[kind](path)
    except ValueError as error:
        reason = str(error).removeprefix(f"{path}: ")
        raise ValueError(f"names the file {path.name[:60]!r}, which Mitsuba cannot take: {reason}") from None


def _check_picture(path: Path) -> None:
    """The rule of photographs."""
    with silence_libraries():
        source = oiio.ImageInput.open(str(path))
        if source is None:
            raise ValueError(
                f"no image ({shorten_oiio_error(last_oiio_error(oiio), path)}), expected one; export it again."
            )
        with contextlib.closing(source):
            spec = source.spec()
            check_size(spec.width, spec.height, path, low=1)
            check_memory(spec, path)


def _check_volume(path: Path) -> None:
    """A grid of 32-bit floats; Mitsuba ends the process at one without samples."""
    with open_regular(path) as file:
        header = file.read(_VOLUME.size).ljust(_VOLUME.size, b"\0")
        size = file.seek(0, 2)
    _, _, *grid, channels = _VOLUME.unpack(header)
    needed = _VOLUME.size + _BOX_BYTES + 4 * math.prod(grid) * channels
    if min(*grid, channels) < 1 or size < needed:
        shape = " x ".join(map(str, grid))
        raise ValueError(
            f"a grid of {shape}, {channels} channels and {size:,} bytes, expected 1 or more along each axis and "
            f"{needed:,} bytes; export it again."
        )
