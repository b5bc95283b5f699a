"""The cache folder: files that can be had again, by a download or by computing; code only in a folder of one's own."""

from __future__ import annotations

import atexit
import contextlib
import functools
import os
import shutil
import stat
import tempfile
import warnings
from pathlib import Path

import platformdirs


def cache_folder() -> Path:
    """METAPP_CACHE if set, else the user's cache folder of this system."""
    return Path(os.environ.get("METAPP_CACHE") or platformdirs.user_cache_dir("metapp", appauthor=False))


@functools.cache
def code_folder(folder: Path, variable: str) -> Path:
    """A folder for compiled code that its user alone can write to, made if missing.

    Args:
        folder: its place.
        variable: of the environment, that names it.

    Returns:
        `folder`, with mode 0700, or, with a warning, one of this process, removed at its end, if `folder` is a link,
        another user's or can be written to by others.

    Raises:
        OSError: it cannot be made.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    with contextlib.suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    state = folder.lstat()
    mine = not hasattr(os, "getuid") or (state.st_uid == os.getuid() and not state.st_mode & 0o022)
    if stat.S_ISDIR(state.st_mode) and mine:
        folder.chmod(0o700)
        return folder
    warnings.warn(
        f"{folder}: a link, another user's or open to others, expected a folder that its user alone can write to; code "
        f"is compiled for this run alone. Remove it, or let {variable} name another place.",
        stacklevel=2,
    )
    alone = tempfile.mkdtemp(prefix="metapp-")
    atexit.register(shutil.rmtree, alone, ignore_errors=True)
    return Path(alone)
