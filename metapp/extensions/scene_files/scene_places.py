"""The files that a scene may name: regular files of a bounded size in folders that the user named.

A scene comes from anywhere, so a name in it gives no right to read the file. What files take in memory, by their
headers, is in :mod:`metapp.extensions.scene_files.data_files`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from typing_extensions import override

from metapp.extensions.scene_files.data_files import data_file_bytes
from metapp.rendering.scenes.rules import SceneFiles, is_file_name
from metapp.storage.files import open_text, placeholder_line

MAX_TEXT_CHARACTERS = 2**24  # of a scene file, an include, and of a scene file with all of its includes
MAX_DATA_BYTES = 2**31  # of a mesh, bitmap or spectrum
_WINDOWS_DRIVE = re.compile(r"[A-Za-z]:[\\/]")  # begins an absolute name of Windows

# Data files that scenes read in this process have named. A scene is kept as text beside its samples, and may be loaded
# from this text again, but text from elsewhere gives no right to read files.
_files_read_before: set[Path] = set()


@dataclass(frozen=True)
class ScenePlaces(SceneFiles):
    """The places where the files of a scene may lie.

    Attributes:
        search_folders: folders in which relative names are looked for, in this order.
        allowed_folders: resolved folders outside of which no file may be read; none for a stored scene, which may read
            files that were read in this process before.
        most_bytes: size of a mesh, bitmap or spectrum at most.
    """

    search_folders: tuple[Path, ...] = ()
    allowed_folders: tuple[Path, ...] = ()
    most_bytes: int = MAX_DATA_BYTES

    @classmethod
    def from_scene_file(cls, path: Path, others: Iterable[Path] = ()) -> ScenePlaces:
        """Return the places of a scene file.

        Args:
            path: the scene file, whose folder is searched first.
            others: further folders that are searched, and in which files may lie as well.
        """
        folders = tuple(folder.resolve() for folder in (path.resolve().parent, *others))
        return cls(folders, folders)

    @override
    def search_first(self, folder: str | Path) -> ScenePlaces:
        """Return the places with a folder that is searched first: a path, or the value of a <path> element."""
        path = folder if isinstance(folder, Path) else self.find_folder(folder)
        return replace(self, search_folders=(path, *self.search_folders))

    @override
    def resolve_file(self, name: str) -> Path:
        """Find the data file of a name; stored scenes may then name it in this process.

        Raises:
            ValueError: the file is missing, too large, no regular file, outside of the allowed folders, or a
                placeholder for another file.
        """
        path = self._find(name, "file")
        if not path.is_file():
            raise ValueError(f"names {path!s:.200}, which is no regular file; give a mesh, bitmap or spectrum.")
        size = path.stat().st_size
        if size > self.most_bytes:
            raise ValueError(f"names {path!s:.200}, of {size:,} bytes, expected {self.most_bytes:,} at most.")
        if line := placeholder_line(path):
            raise ValueError(f"names {line}")
        _files_read_before.add(path)
        return path

    @override
    def memory_bytes(self, kind: str, parameters: Mapping[str, object]) -> int:
        names = [value for name, value in parameters.items() if is_file_name(name) and isinstance(value, str)]
        index = parameters.get("shape_index", 0)
        shape_index = index if isinstance(index, int) else 0
        return sum(data_file_bytes(kind, Path(name), shape_index) for name in names)

    def read_included_text(self, name: str) -> tuple[Path, str]:
        """Read a document that a scene includes, and return its resolved path and its text.

        Raises:
            ValueError: the document is missing, too large, no text, or outside of the allowed folders.
        """
        path = self._find(name, "include")
        return path, read_scene_text(path)

    def find_folder(self, name: str) -> Path:
        """Find the folder that a <path> element names.

        Raises:
            ValueError: the folder is missing, no folder, or outside of the allowed folders.
        """
        path = self._find(name, "<path>")
        if not path.is_dir():
            raise ValueError(f"a <path> {path!s:.200}, which is no folder; give one.")
        return path

    def _find(self, name: str, what: str) -> Path:
        """Find a file or folder by its name; `what` says in messages what the scene names."""
        if "\0" in name or len(name) > 1024:
            raise ValueError(f"a name of a {what}, {name[:40]!r}, expected one of up to 1024 characters, without NUL.")
        folders = (Path("/"),) if os.path.isabs(name) else self.search_folders
        candidate = next((path for path in (folder / name for folder in folders) if os.path.lexists(path)), None)
        candidate = candidate or next(filter(None, (_find_windows_name(folder, name) for folder in folders)), None)
        try:
            path = candidate.resolve(strict=True) if candidate else None
        except (OSError, RuntimeError):  # a link to nowhere or to itself
            path = None
        if path is None:
            drive_remedy = ", and name it without its drive" if _WINDOWS_DRIVE.match(name) else ""
            raise ValueError(
                f"names the {what} {name[:100]!r}: file not found; put it in the scene's folder{drive_remedy}."
            )
        if not str(path).isprintable() or "$" in str(path):
            raise ValueError(f"names {str(path)[:150]!r}, expected a path that is printable and without '$'.")
        if not self.allowed_folders and path not in _files_read_before:
            raise ValueError(f"names the {what} {name[:100]!r}, expected none in a stored scene; give the scene file.")
        if self.allowed_folders and not any(path.is_relative_to(folder) for folder in self.allowed_folders):
            raise ValueError(
                f"names the {what} {name[:60]!r} outside the scene's folder; if you trust it, name a folder that holds "
                f"it: --scene-root {str(path if what == '<path>' else path.parent)[:120]}"
            )
        return path


def _find_windows_name(folder: Path, name: str) -> Path | None:
    """Find the file that a name means on Windows, where backslashes divide folders and case does not count.

    Returns:
        The file; None if no file, or more than one, has such a name.
    """
    path = folder
    for part in name.replace("\\", "/").split("/"):
        if part in ("", ".", "..") or os.path.lexists(path / part):
            path = path / part
            continue
        try:
            matches = [entry for entry in os.listdir(path) if entry.casefold() == part.casefold()]
        except OSError:
            return None
        if len(matches) != 1:
            return None
        path = path / matches[0]
    return path


def read_scene_text(path: Path, most_characters: int = MAX_TEXT_CHARACTERS) -> str:
    """Read the text of a scene file; a FIFO or a device is refused at once, and not waited for.

    Args:
        path: the file.
        most_characters: length of the text at most.

    Raises:
        ValueError: the file is no regular file, too large, not readable, or no text.
    """
    try:
        with open_text(path) as file:
            content = file.read(most_characters + 1)
    except UnicodeDecodeError:
        raise ValueError("not text in UTF-8 or UTF-16, expected a scene of Mitsuba 3.") from None
    except (IsADirectoryError, ValueError) as error:
        reason = placeholder_line(path).removeprefix(f"{path}: ") if isinstance(error, ValueError) else ""
        raise ValueError(reason or "no regular file, expected a scene of Mitsuba 3.") from None
    except OSError as error:
        raise ValueError(f"{error.strerror}, expected a scene of Mitsuba 3 that can be read.") from None
    if len(content) > most_characters:
        raise ValueError(
            f"more than {most_characters:,} characters, expected a scene of Mitsuba 3; put meshes in files."
        )
    return content
