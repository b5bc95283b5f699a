"""Files in folders: which of them a reader takes, and which it skips with a line for the user.

Readers say what a file of their format is; hidden files and files that metapp wrote are left out here.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Collection
from pathlib import Path

from metapp.storage.files import placeholder_line
from metapp.storage.folders import FAILED_PICTURE_SUFFIX, cached_lookup, list_folder, path_kind

FoundFiles = tuple[list[Path], list[str]]  # the files of a path, and the line of each skipped file of a folder


def find_files(
    path: Path,
    check: Callable[[Path], None],
    fault: Callable[[Path], str | None],
    nothing: str,
    likely: Collection[str] = (),
) -> FoundFiles:
    """Find the files of a format: a named one, or those in a folder at any depth, sorted, without hidden ones.

    Args:
        path: a file or folder.
        check: a function that raises ValueError for a named path that cannot be a file of the format.
        fault: a function from a file in a folder to the line why it is skipped; "" for a file of the format, None for
            another file that is skipped without a line.
        nothing: the error of a folder without such a file.
        likely: suffixes of the format; if a folder has only bad files of these, the error is the fault of the first.
            One that stands for another file, such as a Git LFS pointer, is skipped with a line that says so.

    Raises:
        ValueError: `check` raises it; a folder has no such file.
    """
    if not path.is_dir():
        check(path)
        return [path], []
    faults = {file: fault(file) for file in files_below(path)}
    for file, line in faults.items():
        if line and file.suffix.lower() in likely:
            faults[file] = placeholder_line(file) or line
    if "" not in faults.values():
        bad_lines = [line for file, line in faults.items() if line and file.suffix.lower() in likely]
        raise ValueError(bad_lines[0] if bad_lines else f"{path}: {nothing}")
    return [file for file, line in faults.items() if line == ""], [line for line in faults.values() if line]


def find_by_suffix(path: Path, suffix: str, what: str) -> FoundFiles:
    """Find the files of a format that is told by its suffix alone; see :func:`find_files`.

    Args:
        path: a file or folder.
        suffix: the suffix, with its dot, in small letters.
        what: a noun for such a file in errors.

    Raises:
        ValueError: a named file has another suffix or does not exist; a folder has no such file.
    """

    def check(file: Path) -> None:
        if not file.is_file() or file.suffix.lower() != suffix:
            found = f"a file {file.suffix}" if file.is_file() else "no such file"
            raise ValueError(f"{file}: {found}, expected {what}; check the path.")

    nothing = f"no {suffix} file, expected {what}; name its folder."
    return find_files(path, check, lambda file: "" if file.suffix.lower() == suffix else None, nothing)


def has_suffix(path: str | Path, suffix: str) -> bool:
    """Tell whether a path is a file of a suffix, with its dot, or a folder with one at any depth."""
    return any(file.suffix.lower() == suffix for file in files_of(path, suffix))


def files_of(path: str | Path, endings: str | tuple[str, ...] = "") -> list[Path]:
    """Return a file itself, or the files below a folder (see :func:`files_below`); [] if nothing is there."""
    path = Path(path)
    return files_below(path, endings) if path.is_dir() else [path] if path.is_file() else []


def files_below(folder: Path, endings: str | tuple[str, ...] = "") -> list[Path]:
    """Return the user's files in a folder at any depth, sorted; hidden ones and linked folders are left out.

    Files that metapp wrote are left out, too: data sets, fits, the pictures of runs, and pictures that show what metapp
    found in photos or failed to find.

    Args:
        folder: the folder.
        endings: the endings that files' names may have, in small letters; capitals count as these.
    """
    return [Path(file) for file in _list_all_below(str(folder)) if file.lower().endswith(endings)]


@cached_lookup
def _list_all_below(folder: str) -> list[str]:
    """Return the paths of all files that :func:`files_below` chooses from, sorted."""
    files, folders = [], [folder]
    while folders:  # not recursive, since folders may be nested deeper than Python's stack
        current_folder = folders.pop()
        if path_kind(current_folder):
            continue
        for entry in list_folder(current_folder):
            if entry.name.startswith("."):
                continue
            if entry.is_dir(follow_symlinks=False):
                folders.append(entry.path)
            elif entry.is_file() and not entry.name.endswith(FAILED_PICTURE_SUFFIX):
                files.append(entry.path)
    return sorted(files, key=lambda file: file.split(os.sep))
