"""The cache folder, for files that can be downloaded or computed again, and folders for compiled code.

Compiled code is run without a look at it, so that nobody but the user may be able to write to its folder.
"""

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
    """Return the cache folder: METAPP_CACHE if that is set, else the system's folder for the user's caches."""
    return Path(os.environ.get("METAPP_CACHE") or platformdirs.user_cache_dir("metapp", appauthor=False))


@functools.cache
def code_folder(folder: Path, variable: str) -> Path:
    """Make a folder for compiled code that its user alone can write to.

    Args:
        folder: the folder to make, or to take if it is there.
        variable: the environment variable that names the folder, for the warning.

    Returns:
        The folder, with mode 0700. If it is a link, belongs to another user or can be written to by others, a warning
        is given, and a temporary folder is returned that is removed when the process ends.

    Raises:
        OSError: the folder cannot be made.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    with contextlib.suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    state = folder.lstat()
    is_private = not hasattr(os, "getuid") or (state.st_uid == os.getuid() and not state.st_mode & 0o022)
    if stat.S_ISDIR(state.st_mode) and is_private:
        folder.chmod(0o700)
        return folder
    warnings.warn(
        f"{folder}: a link, another user's or open to others, expected a folder that its user alone can write to; code "
        f"is compiled for this run alone. Remove it, or let {variable} name another place.",
        stacklevel=2,
    )
    temporary_folder = tempfile.mkdtemp(prefix="metapp-")
    atexit.register(shutil.rmtree, temporary_folder, ignore_errors=True)
    return Path(temporary_folder)
