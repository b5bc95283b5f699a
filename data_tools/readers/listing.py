"""Files in folders: which of them a reader takes."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection
from pathlib import Path

Found = tuple[list[Path], list[str]]  # the sources of a path, and the line of each skipped file of a folder


def find_files(
    path: Path,
    check: Callable[[Path], None],
    fault: Callable[[Path], str | None],
    nothing: str,
    likely: Collection[str] = (),
) -> Found:
    """Find files of a format: a named one, or those in a folder at any depth (hidden ones left out), sorted.

    Args:
        path: a file or folder.
        check: raises ValueError for a named path that cannot be a file of the format.
        fault: of a file in a folder, the line why it is skipped; "" for a file of the format, None to say nothing.
        nothing: said of a folder without such a file.
        likely: suffixes of the format; if a folder has only bad files of these, the error names the fault of the first.

    Raises:
        ValueError: as `check`; a folder without such a file.
    """
    if not path.is_dir():
        check(path)
        return [path], []
    faults = {file: fault(file) for file in files_below(path)}
    if "" not in faults.values():
        bad = [line for file, line in faults.items() if line and file.suffix.lower() in likely]
        raise ValueError(bad[0] if bad else f"{path}: {nothing}")
    return [file for file, line in faults.items() if line == ""], [line for line in faults.values() if line]


def find_by_suffix(path: Path, suffix: str, what: str) -> Found:
    """As `find_files`, by suffix (with its dot) alone; `what` is their noun in errors."""

    def check(file: Path) -> None:
        if not file.is_file() or file.suffix != suffix:
            found = f"a file {file.suffix}" if file.is_file() else "no such file"
            raise ValueError(f"{file}: {found}, expected {what}; check the path.")

    nothing = f"no {suffix} file, expected {what}; name its folder."
    return find_files(path, check, lambda file: "" if file.suffix == suffix else None, nothing)


def has_suffix(path: str | Path, suffix: str) -> bool:
    """True for a file of a suffix, with its dot, and for a folder with one below it."""
    return any(file.suffix == suffix for file in files_of(path))


def any_passes(path: Path, suffix: str, test: Callable[[Path], bool]) -> bool:
    """True if a file, or one in a folder at any depth, passes a test; one that cannot be read does not."""
    for file in files_of(path, suffix):
        with contextlib.suppress(ValueError, OSError):
            if test(file):
                return True
    return False


def files_of(path: str | Path, suffix: str = "") -> list[Path]:
    """A file itself; the `files_below` a folder; [] if there is nothing."""
    path = Path(path)
    return files_below(path, suffix) if path.is_dir() else [path] if path.is_file() else []


def files_below(folder: Path, suffix: str = "") -> list[Path]:
    """The files of a folder and of those below it, sorted, hidden ones left out."""
    return [
        file
        for file in sorted(folder.rglob(f"*{suffix}"))
        if file.is_file() and not any(part.startswith(".") for part in file.relative_to(folder).parts)
    ]
