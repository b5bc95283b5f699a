"""The kinds of folders that metapp writes, which no command takes as files of a user.

Each is told by a file in it: a data set by its manifest, a fit by its record, the folders of runs and of pictures of
results by a marker. Any other folder is a user's.
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

from metapp.storage.files import PARTIAL_PREFIX, read_bytes, write_bytes

P = ParamSpec("P")
Result = TypeVar("Result")

MANIFEST = "manifest.json"  # the file of a data set that lists its tasks
SHARD_SUFFIX = ".safetensors"  # the suffix of the files of tasks in a data set
RECORD, PARAMS = "record.json", "params.safetensors"  # files in the folder of a fit
MARKER = ".metapp"  # the file in the folder of a run, or of results, that says so
# The folder of pictures that show what was found, in a data set or beside rectified photographs
FOUND_FOLDER = "found"
# The end of the name of a picture that shows photographs which metapp could not use
FAILED_PICTURE_SUFFIX = ".failed.png"


class FolderKind(enum.Enum):
    """The kinds of folders that metapp writes; each value says in words what such a folder is."""

    DATA_SET = "a data set"
    FIT = "the folder of a fit"
    RUN = "the folder of a run"
    RESULTS = "made by metapp to show its results"


# Where a folder of runs has its fits: `runs/brdf`, `runs`, and `runs` in which `metapp evaluate` alone wrote
_FITS_OF_RUNS = ("*/*/", "*/*/*/", "evaluate/*/*/*/")

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


def path_kind(path: str | Path) -> FolderKind | None:
    """Return the kind of a folder that metapp wrote, or RESULTS for a picture of results; None for a user's path.

    A picture of results lies directly in the folder of a run or in a folder of results, or its name ends with
    FAILED_PICTURE_SUFFIX.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     mark_folder(Path(folder, "found"), FolderKind.RESULTS)
    ...     path_kind(folder), path_kind(Path(folder, "found")).value
    (None, 'made by metapp to show its results')
    """
    place = os.path.abspath(path)
    if os.path.isdir(place):
        return _folder_kind(place)
    if not os.path.isfile(place):
        return None
    is_result = _folder_kind(os.path.dirname(place)) in (FolderKind.RUN, FolderKind.RESULTS)
    return FolderKind.RESULTS if is_result or place.endswith(FAILED_PICTURE_SUFFIX) else None


@cached_lookup
def _folder_kind(folder: str) -> FolderKind | None:
    """Return the kind of a folder by its absolute path; None for a folder of a user.

    Photographs may lie beside a manifest or a record of another program, whose entries differ.
    """
    for name, entries, kind in (
        (MANIFEST, {"app", "tasks"}, FolderKind.DATA_SET),
        (RECORD, {"name", "settings"}, FolderKind.FIT),
    ):
        document = read_json(os.path.join(folder, name))
        if isinstance(document, dict) and document.keys() >= entries:
            return kind
    with contextlib.suppress(OSError, ValueError):  # there is no marker, or it is another program's
        return FolderKind(read_bytes(os.path.join(folder, MARKER)).decode().strip())
    return None


def mark_folder(folder: Path, kind: FolderKind) -> None:
    """Make a folder if it is missing, and write into it of which kind it is.

    Args:
        folder: the folder.
        kind: RUN or RESULTS; data sets and fits are marked by their manifest and record.

    Raises:
        OSError: the folder cannot be made or written to.
    """
    if not (folder / MARKER).exists():
        write_bytes(folder / MARKER, f"{kind.value}\n".encode())


def is_data_set(path: str | Path) -> bool:
    """Test whether a path is the folder of a data set."""
    return path_kind(path) is FolderKind.DATA_SET


def find_record_files(folder: Path) -> list[Path]:
    """Find the records of fits in a folder of runs, such as `runs` or `runs/brdf`, without those behind links."""
    files = [file for place in _FITS_OF_RUNS for file in folder.glob(f"{place}{RECORD}")]
    files = [file for file in files if file.resolve() == folder.resolve() / file.relative_to(folder)]
    return [
        file
        for file in files
        if not file.parent.name.startswith(PARTIAL_PREFIX) and path_kind(file.parent) is FolderKind.FIT
    ]


def read_json(file: str) -> object:
    """Read a JSON file; return None if it cannot be read or is no JSON."""
    try:
        return json.loads(read_bytes(file))
    except (ValueError, RecursionError, OSError):
        return None
