"""Files in folders: which of them a reader takes."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection
from pathlib import Path

from metapp.storage.files import placeholder_line
from metapp.storage.folders import FAILED_PICTURE_SUFFIX, cached_lookup, holds_files_of_users, list_folder

FoundFiles = tuple[list[Path], list[str]]  # the files of a path, and the line of each skipped file of a folder


def find_files(
    path: Path,
    check: Callable[[Path], None],
    fault: Callable[[Path], str | None],
    nothing: str,
    likely: Collection[str] = (),
) -> FoundFiles:
    """Find files of a format: a named one, or those in a folder at any depth (hidden ones left out), sorted.

    Args:
        path: a file or folder.
        check: raises ValueError for a named path that cannot be a file of the format.
        fault: of a file in a folder, the line why it is skipped; "" for a file of the format, None to say nothing.
        nothing: said of a folder without such a file.
        likely: suffixes of the format; if a folder has only bad files of these, the error names the fault of the first.
            One that stands for another file, such as a Git LFS pointer, is skipped as that.

    Raises:
        ValueError: as `check`; a folder without such a file.
    """
    if not path.is_dir():
        check(path)
        return [path], []
    faults = {file: fault(file) for file in files_below(path)}
    for file, line in faults.items():
        if line and file.suffix.lower() in likely:
            faults[file] = placeholder_line(file) or line
    if "" not in faults.values():
        bad = [line for file, line in faults.items() if line and file.suffix.lower() in likely]
        raise ValueError(bad[0] if bad else f"{path}: {nothing}")
    return [file for file, line in faults.items() if line == ""], [line for line in faults.values() if line]


def find_by_suffix(path: Path, suffix: str, what: str) -> FoundFiles:
    """As `find_files`, by suffix (with its dot) alone; `what` is their noun in errors."""

    def check(file: Path) -> None:
        if not file.is_file() or file.suffix.lower() != suffix:
            found = f"a file {file.suffix}" if file.is_file() else "no such file"
            raise ValueError(f"{file}: {found}, expected {what}; check the path.")

    nothing = f"no {suffix} file, expected {what}; name its folder."
    return find_files(path, check, lambda file: "" if file.suffix.lower() == suffix else None, nothing)


def has_suffix(path: str | Path, suffix: str) -> bool:
    """True for a file of a suffix, with its dot, and for a folder with one below it."""
    return any(file.suffix.lower() == suffix for file in files_of(path, suffix))


def files_of(path: str | Path, endings: str | tuple[str, ...] = "") -> list[Path]:
    """A file itself; the `files_below` a folder; [] if there is nothing."""
    path = Path(path)
    return files_below(path, endings) if path.is_dir() else [path] if path.is_file() else []


def files_below(folder: Path, endings: str | tuple[str, ...] = "") -> list[Path]:
    """The files of a user in a folder and in those below it, sorted, hidden ones and linked folders left out.

    What metapp wrote is left out, too: data sets, fits, the pictures of runs, and those of what was found in photos
    or looked for in vain.
    Names end in one of `endings`, in capitals or not.
    """
    return [Path(file) for file in _all_below(str(folder)) if file.lower().endswith(endings)]


@cached_lookup
def _all_below(folder: str) -> list[str]:
    """Return the paths of all files that `files_below` chooses from, sorted."""
    found, folders = [], [folder]
    while folders:  # of any depth, which recursion has not
        place = folders.pop()
        takes_files, takes_folders = holds_files_of_users(place)
        for entry in list_folder(place):
            if entry.name.startswith(".") or (entry.name.endswith(FAILED_PICTURE_SUFFIX) and entry.is_file()):
                continue
            if entry.is_dir(follow_symlinks=False):
                folders += [entry.path] * takes_folders
            elif takes_files and entry.is_file():
                found.append(entry.path)
    return sorted(found, key=lambda file: file.split(os.sep))
