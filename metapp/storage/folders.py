"""The kinds of folders: what a path is, decided in one place for all commands.

A folder means one thing: a data set (it holds a manifest), a fit (it holds a record), a run (it holds fits), rectified
photographs (it holds positions of cameras or flashes), pictures that show what metapp found in photographs, or else
files of a user.
"""

from __future__ import annotations

import contextlib
import enum
import functools
import json
import os
from collections.abc import Callable, Iterator
from contextvars import ContextVar
from pathlib import Path
from typing import Any, ParamSpec, TypeVar

from metapp.storage.files import PARTIAL_PREFIX, read_bytes

P = ParamSpec("P")
Result = TypeVar("Result")

MANIFEST = "manifest.json"  # the file of a data set that lists its tasks
SHARD_SUFFIX = ".safetensors"  # the suffix of the files of tasks in a data set
RECORD, PARAMS = "record.json", "params.safetensors"  # files in the folder of a fit
CAMERA_TEXT, LIGHT_TEXT = "camera_pos.txt", "light_pos.txt"  # files beside rectified photographs; one of them suffices
LIGHT_DIRECTIONS_SUFFIX = ".lp"  # of a text beside photographs by a camera that stands still
# The folder of pictures that show what was found, in a data set or beside rectified photographs
DIAGNOSTIC_FOLDER = "found"
# The end of the name of a picture that shows photographs which metapp could not use
FAILED_PICTURE_SUFFIX = ".failed.png"


class PathKind(enum.Enum):
    """The kinds of paths; each value says in words what such a path is."""

    DATA_SET = "a data set"
    FIT = "the folder of a fit"
    RUN_FOLDER = "the folder of a run"
    FOLDER_OF_RUNS = "a folder of runs"
    RECTIFIED = "a folder of rectified photos"
    DIAGNOSTIC = "made by metapp to show its results"
    FILES = "a folder"
    FILE = "a file"
    NOTHING = "no such file or folder"


# Kinds of folders that metapp writes, and that hold no files of a user
WRITTEN_KINDS = (PathKind.DATA_SET, PathKind.FIT, PathKind.RUN_FOLDER, PathKind.DIAGNOSTIC)
KINDS_WITH_FITS = (PathKind.FIT, PathKind.RUN_FOLDER, PathKind.FOLDER_OF_RUNS)

# Where a folder of runs has its fits: `runs/brdf`, `runs`, and `runs` in which `metapp evaluate` alone wrote
FITS_OF_RUNS = ("*/*/", "*/*/*/", "evaluate/*/*/*/")

# Results of functions that look at the disk, by function and arguments; None outside of `cache_lookups`
_LOOKUPS: ContextVar[dict[tuple[Any, ...], Any] | None] = ContextVar("lookups", default=None)


@contextlib.contextmanager
def cache_lookups() -> Iterator[None]:
    """Look at each folder and file once during a `with` block; files that come or go meanwhile are not seen.

    Several readers look for their files in one folder, which may hold 50,000. See :func:`cached_lookup`.
    """
    if _LOOKUPS.get() is not None:
        yield
        return
    token = _LOOKUPS.set({})
    try:
        yield
    finally:
        _LOOKUPS.reset(token)


def cached_lookup(function: Callable[P, Result]) -> Callable[P, Result]:
    """Make a function look at the disk once for each of its arguments within :func:`cache_lookups`.

    Args:
        function: a function with hashable arguments, whose result nobody changes.

    Returns:
        The function, which outside of `cache_lookups` looks at the disk at each call.
    """

    @functools.wraps(function)
    def look_once(*args: P.args, **keywords: P.kwargs) -> Result:
        lookups = _LOOKUPS.get()
        if lookups is None:
            return function(*args, **keywords)
        key = (function, args, *sorted(keywords.items()))
        if key not in lookups:
            lookups[key] = function(*args, **keywords)
        result: Result = lookups[key]
        return result

    return look_once


@cached_lookup
def list_folder(folder: str) -> list[os.DirEntry[str]]:
    """List the entries of a folder, in the order of the file system."""
    with os.scandir(folder) as entries:
        return list(entries)


def path_kind(path: str | Path) -> PathKind:
    """Return the kind of a path.

    A file is diagnostic if it lies directly in the folder of a run, such as `pictures.png`, or in a folder of
    pictures that show what was found, or if its name ends with FAILED_PICTURE_SUFFIX. A JSON file of another program is
    neither a manifest nor a record.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = Path(folder, CAMERA_TEXT).write_text("0,0,16")
    ...     path_kind(folder), path_kind(Path(folder, "none"))
    (<PathKind.RECTIFIED: 'a folder of rectified photos'>, <PathKind.NOTHING: 'no such file or folder'>)
    """
    place = os.path.abspath(path)
    if not os.path.isdir(place):
        if not os.path.lexists(place):
            return PathKind.NOTHING
        if place.endswith(FAILED_PICTURE_SUFFIX):
            return PathKind.DIAGNOSTIC
        folder_kind = quick_folder_kind(os.path.dirname(place))
        return PathKind.DIAGNOSTIC if folder_kind in (PathKind.RUN_FOLDER, PathKind.DIAGNOSTIC) else PathKind.FILE
    kind = quick_folder_kind(place)
    return PathKind.FOLDER_OF_RUNS if kind is PathKind.FILES and find_record_files(Path(path), *FITS_OF_RUNS) else kind


def holds_files_of_users(folder: str) -> tuple[bool, bool]:
    """Tell a walk through folders where files of a user may lie.

    Returns:
        Whether the files in a folder are a user's, and whether the folders below it are to be searched.
    """
    kind = quick_folder_kind(os.path.abspath(folder))
    return kind not in WRITTEN_KINDS, kind not in WRITTEN_KINDS or kind is PathKind.RUN_FOLDER


def find_record_files(folder: Path, *places: str) -> list[Path]:
    """Find the records of fits in a folder, without those that lie behind links.

    Args:
        folder: the folder.
        places: patterns of the folders of fits relative to the folder, such as "*/*/".
    """
    files = [file for place in places for file in folder.glob(f"{place}{RECORD}")]
    files = [file for file in files if file.resolve() == folder.resolve() / file.relative_to(folder)]
    return [file for file in files if not file.parent.name.startswith(PARTIAL_PREFIX) and _is_fit(str(file.parent))]


def is_data_set(path: Path) -> bool:
    """Test whether a path is the folder of a data set, by its manifest alone."""
    return _is_data_set(os.path.abspath(path))


@cached_lookup
def quick_folder_kind(folder: str) -> PathKind:
    """Return the kind of a folder by its absolute path, without a search: a folder of runs counts as FILES."""
    if _is_data_set(folder):
        return PathKind.DATA_SET
    if _is_fit(folder):
        return PathKind.FIT
    parent = os.path.dirname(folder)
    if os.path.basename(folder) == DIAGNOSTIC_FOLDER and (_is_data_set(parent) or _is_rectified(parent)):
        return PathKind.DIAGNOSTIC
    if _is_run(folder):
        return PathKind.RUN_FOLDER
    return PathKind.RECTIFIED if _is_rectified(folder) else PathKind.FILES


def _is_data_set(folder: str) -> bool:
    """Test whether a folder has a manifest; a damaged one counts if files of tasks lie beside it."""
    file = os.path.join(folder, MANIFEST)
    if not os.path.isfile(file):
        return False
    manifest = read_json(file)
    if isinstance(manifest, dict) and manifest.keys() >= {"app", "tasks"}:
        return True
    return any(name.endswith(SHARD_SUFFIX) for name in os.listdir(folder))


def _is_fit(folder: str) -> bool:
    """Test whether a folder has a record of a fit; a damaged one counts if parameters lie beside it."""
    file = os.path.join(folder, RECORD)
    if not os.path.isfile(file):
        return False
    record = read_json(file)
    is_record = isinstance(record, dict) and "name" in record
    return is_record or os.path.isfile(os.path.join(folder, PARAMS))


def _is_run(folder: str) -> bool:
    try:
        return any(
            entry.is_dir(follow_symlinks=False) and not entry.name.startswith(".") and _is_fit(entry.path)
            for entry in list_folder(folder)
        )
    except OSError:  # whoever reads the folder will say that it cannot be read
        return False


def _is_rectified(folder: str) -> bool:
    with contextlib.suppress(OSError):  # whoever reads the folder will say that it cannot be read
        names = [entry.name for entry in list_folder(folder)]
        return any(
            name in (CAMERA_TEXT, LIGHT_TEXT) or name.lower().endswith(LIGHT_DIRECTIONS_SUFFIX) for name in names
        )
    return False


def read_json(file: str) -> object:
    """Read a JSON file; return None if it cannot be read or is no JSON."""
    try:
        return json.loads(read_bytes(file))
    except (ValueError, RecursionError, OSError):
        return None
