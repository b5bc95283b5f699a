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

from metapp.storage.files import make_writable_folder

CACHE_VARIABLE = "METAPP_CACHE"  # environment variable: the cache folder
# folders of compiled code in the cache folder: of C sources, of torch, and of Dr.Jit where there is no home folder
CODE_FOLDERS = NATIVE_FOLDER, TORCH_FOLDER, KERNELS_FOLDER = "native", "torch", "drjit"


def cache_folder() -> Path:
    """Return the cache folder, made if missing, see :func:`make_cache_folder`.

    If it cannot be made or written to, a warning says so, and a temporary folder takes its place, which is removed when
    the process ends. It has links to the files that the cache folder holds, except to compiled code.
    """
    return _usable_cache_folder(_cache_path())


def make_cache_folder() -> Path:
    """Make the cache folder if it is missing: METAPP_CACHE if that is set, else the system's for the user's caches.

    Returns:
        The folder, which files can be written to.

    Raises:
        ValueError: the folder cannot be made or written to, or there is neither METAPP_CACHE nor a home folder.
    """
    folder = _cache_path()
    remedy = f"expected a cache folder that can be written to; set {CACHE_VARIABLE} to one"
    if str(folder).startswith("~"):  # expanduser leaves it where the user has no home folder
        raise ValueError(f"{folder}: the user has no home folder, {remedy}.")
    try:
        make_writable_folder(folder)
    except OSError as error:
        raise ValueError(f"{folder}: {error.strerror}, {remedy}.") from None
    return folder


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
    return _make_temporary_folder()


def _cache_path() -> Path:
    """Return the path of the cache folder; it begins with ~ if the user has no home folder."""
    try:
        folder = os.environ.get(CACHE_VARIABLE) or platformdirs.user_cache_dir("metapp", appauthor=False)
    except RuntimeError:  # by newer versions of platformdirs; older ones leave ~ in the path
        folder = "~"
    return Path(os.path.expanduser(folder))


@functools.cache
def _usable_cache_folder(folder: Path) -> Path:
    """Return a cache folder that can be written to, or a temporary one in its place, with a warning."""
    try:
        return make_cache_folder()
    except ValueError as error:
        warnings.warn(f"{str(error).rstrip('.')}. Until then a temporary folder is used.", stacklevel=3)
    temporary_folder = _make_temporary_folder()
    for parent, _, names in os.walk(folder.absolute()):
        below = Path(parent).relative_to(folder.absolute())
        if not below.parts or below.parts[0] not in CODE_FOLDERS:
            (temporary_folder / below).mkdir(exist_ok=True)
            for name in names:
                (temporary_folder / below / name).symlink_to(Path(parent) / name)
    return temporary_folder


def _make_temporary_folder() -> Path:
    """Make a folder that is removed when the process ends."""
    folder = tempfile.mkdtemp(prefix="metapp-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)
