"""The cache folder: files that can be had again, by a download or by computing; code is kept where it is one's own."""

from __future__ import annotations

import atexit
import contextlib
import functools
import os
import shutil
import stat
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

SECONDS, BLOCK = 30.0, 1 << 20  # until a silent server is given up; bytes that are read at a time


def cache_folder() -> Path:
    """METAPP_CACHE if set, else the user's cache folder of this system."""
    import platformdirs

    return Path(os.environ.get("METAPP_CACHE") or platformdirs.user_cache_dir("metapp", appauthor=False))


def download(url: str, report: Callable[[int, int | None], None]) -> bytes:
    """The content of a file of the web; `report` gets bytes that are there and those expected, None where unknown.

    Raises:
        ValueError: no answer, or the connection breaks.
    """
    import http.client
    import urllib.request

    content = bytearray()
    try:
        with urllib.request.urlopen(url, timeout=SECONDS) as response:
            total = int(response.headers.get("Content-Length") or 0) or None
            while block := response.read(BLOCK):
                content += block
                report(len(content), total)
    except (OSError, http.client.HTTPException) as error:
        raise ValueError(f"{url}: {getattr(error, 'reason', None) or error or type(error).__name__}") from None
    return bytes(content)


def code_folder(folder: Path, variable: str) -> Path:
    """A folder for compiled code, made if missing, where nobody but its user, and root, can have written.

    Args:
        folder: where to keep it.
        variable: of the environment, that names it.

    Returns:
        `folder`, or, with a warning, one of this process, removed at its end, where others can write to `folder`.

    Raises:
        OSError: it cannot be made.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    with contextlib.suppress(FileExistsError):
        folder.mkdir(mode=0o700)
    problem = _shared(folder)
    if problem:
        warnings.warn(
            f"{folder}: {problem}, expected a folder that its user alone can write to; code is compiled for this run "
            f"alone. Remove it, or let {variable} name another place.",
            stacklevel=2,
        )
        return _folder_of_process()
    state = folder.stat()
    if state.st_uid == os.getuid() and state.st_mode & 0o077:
        folder.chmod(0o700)
    return folder


def _shared(folder: Path) -> str:
    """The reason why others can have written to a folder, or can put another in its place; else ""."""
    state = folder.lstat()
    if not stat.S_ISDIR(state.st_mode):
        return "a link or file"
    if state.st_uid not in (os.getuid(), 0):
        return "another user's"
    if any(_others_write(state) or path.lstat().st_uid not in (os.getuid(), 0) for path in folder.iterdir()):
        return "others could write to it"
    for parent in map(Path.stat, folder.absolute().parents):
        if parent.st_uid not in (os.getuid(), 0) or (_others_write(parent) and not parent.st_mode & stat.S_ISVTX):
            return "in a folder of others"
    return ""


def _others_write(state: os.stat_result) -> bool:
    """Test for a folder that others than its user, the group of its user alone, and root can write to."""
    by_group = state.st_mode & stat.S_IWGRP and state.st_gid not in (0, os.getuid())
    return bool(by_group or state.st_mode & stat.S_IWOTH)


@functools.cache
def _folder_of_process() -> Path:
    folder = tempfile.mkdtemp(prefix="metapp-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)
