"""Files of one suffix, and folders of them."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable
from pathlib import Path


def find_by_suffix(paths: Iterable[str | Path], suffix: str, what: str) -> tuple[list[Path], list[str]]:
    """Find files by their suffix; they are not opened.

    Args:
        paths: files, and folders that are searched with all below them (hidden ones left out).
        suffix: with its dot.
        what: they are, for errors.

    Returns:
        The files, each once, those of a folder sorted; and no lines, as nothing else is looked at.

    Raises:
        ValueError: a path that does not exist or has another suffix, a folder without any such file.
    """
    files: dict[Path, Path] = {}
    for path in map(Path, paths):
        if not path.is_dir():
            if not path.is_file() or path.suffix != suffix:
                found = f"a file {path.suffix}" if path.is_file() else "no such file"
                raise ValueError(f"{path}: {found}, expected {what}; check the path.")
            files.setdefault(path.resolve(), path)
            continue
        below = files_below(path, suffix)
        if not below:
            raise ValueError(f"{path}: no {suffix} file, expected {what}; name its folder.")
        for file in below:
            files.setdefault(file.resolve(), file)
    return list(files.values()), []


def has_suffix(path: str | Path, suffix: str) -> bool:
    """Test whether a path has a suffix, with its dot, or is a folder with a file of it below."""
    path = Path(path)
    return path.suffix == suffix or (path.is_dir() and any(path.rglob(f"*{suffix}")))


def any_passes(path: Path, suffix: str, test: Callable[[Path], bool]) -> bool:
    """Test whether a file, or one in a folder at any depth, passes a test; one that cannot be read does not."""
    for file in files_below(path, suffix) if path.is_dir() else [path]:
        with contextlib.suppress(ValueError, OSError):
            if test(file):
                return True
    return False


def files_below(folder: Path, suffix: str = "") -> list[Path]:
    """The files of a folder and of those below it, sorted, hidden ones left out."""
    return [
        file
        for file in sorted(folder.rglob(f"*{suffix}"))
        if file.is_file() and not any(part.startswith(".") for part in file.relative_to(folder).parts)
    ]
