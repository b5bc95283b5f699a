"""Files that are there whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

PARTIAL = ".partial-"  # what the name of an unfinished file begins with


def cache_folder() -> Path:
    """Where files are kept that can be had again: METAPP_CACHE if set, else the user's cache folder of this system."""
    import platformdirs

    return Path(os.environ.get("METAPP_CACHE") or platformdirs.user_cache_dir("metapp", appauthor=False))


def write_atomically(path: str | Path, write: Callable[[Path], object]) -> None:
    """Write a file so that it is there whole or not at all, even if the program is interrupted.

    Args:
        path: the file; an existing one is replaced at the end, missing folders are made.
        write: writes everything to the path it is given: a name in the same folder, with the same suffix.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = partial_path(path)
    try:
        write(partial)
        os.replace(partial, path)
    except BaseException:
        partial.unlink(missing_ok=True)
        raise


def partial_path(path: Path) -> Path:
    """Where to write a file until it is whole: in the same folder, with the same suffix."""
    # The suffix stays, since image writers choose the format by it; the process id keeps two programs apart.
    return path.with_name(f"{PARTIAL}{os.getpid()}-{path.name}")


def check_readable(path: Path) -> None:
    """Refuse what a user names as input but has no end, such as a pipe or a device.

    Raises:
        ValueError: neither a file nor a folder, though it is there.
    """
    if path.exists() and not path.is_file() and not path.is_dir():
        raise ValueError(f"{path}: a pipe or device, expected a file or folder; copy what it gives to a file.")
