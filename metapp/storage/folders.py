"""Kinds of folders: what a path is, decided in one place for all commands, and the line that refuses it elsewhere.

A folder means one thing: a data set (it holds a manifest), a fit (a record), a run (fits), rectified photographs
(positions of cameras or flashes), pictures of what metapp found in photographs, or else files of a user.
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

MANIFEST, SHARD_SUFFIX = (
    "manifest.json",
    ".safetensors",
)  # of data sets: the list of tasks, and the suffix of a task's file
RECORD, PARAMS = "record.json", "params.safetensors"  # of fits
CAMERA_TEXT, LIGHT_TEXT = "camera_pos.txt", "light_pos.txt"  # of rectified photographs, either of them
DIAGNOSTIC_FOLDER = (
    "found"  # the folder, in a data set or beside rectified photographs, of pictures that show what was found
)
FAILED_PICTURE_SUFFIX = (
    ".failed.png"  # what the name of a picture ends with that shows photographs which metapp could not use
)


class PathKind(enum.Enum):
    """The kinds of paths; each value says in words what such a path is."""

    DATA_SET = "a data set"
    FIT = "the folder of a fit"
    RUN_FOLDER = "the folder of a run"
    RUN_FOLDERS = "a folder of runs"
    RECTIFIED = "a folder of rectified photos"
    DIAGNOSTIC = "made by metapp to show its results"
    FILES = "a folder"
    FILE = "a file"
    NOTHING = "no such file or folder"


# kinds that metapp writes and that are no user's files
WRITTEN_KINDS = (PathKind.DATA_SET, PathKind.FIT, PathKind.RUN_FOLDER, PathKind.DIAGNOSTIC)
KINDS_WITH_FITS = (PathKind.FIT, PathKind.RUN_FOLDER, PathKind.RUN_FOLDERS)

_LOOKS: ContextVar[dict[tuple[Any, ...], Any] | None] = ContextVar("looks", default=None)


@contextlib.contextmanager
def cache_lookups() -> Iterator[None]:
    """Look at each folder and file once while this is in force: what comes or goes meanwhile is not seen.

    Several readers look for their files in one folder, which may hold 50,000.
    """
    if _LOOKS.get() is not None:
        yield
        return
    token = _LOOKS.set({})
    try:
        yield
    finally:
        _LOOKS.reset(token)


def cached_lookup(function: Callable[P, Result]) -> Callable[P, Result]:
    """Make a function look at folders or files once within `cache_lookups`, and each time outside of it.

    Its arguments are hashable, and nobody changes its result.
    """

    @functools.wraps(function)
    def look(*args: P.args, **more: P.kwargs) -> Result:
        known = _LOOKS.get()
        if known is None:
            return function(*args, **more)
        key = (function, args, *sorted(more.items()))
        if key not in known:
            known[key] = function(*args, **more)
        found: Result = known[key]
        return found

    return look


@cached_lookup
def list_folder(folder: str) -> list[os.DirEntry[str]]:
    """List a folder, in the order of the file system."""
    with os.scandir(folder) as entries:
        return list(entries)


def path_kind(path: str | Path) -> PathKind:
    """Return what a path is.

    A file is diagnostic if it lies directly in the folder of a run, such as `pictures.png`, or in a folder of
    pictures that show what was found, or if its name ends with FAILED. A JSON file of another program is neither a
    manifest nor a record.

    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     _ = Path(folder, CAMERA_TEXT).write_text("0,0,16")
    ...     kind_of(folder), kind_of(Path(folder, "none"))
    (<PathKind.RECTIFIED: 'a folder of rectified photos'>, <PathKind.NOTHING: 'no such file or folder'>)
    """
    place = os.path.abspath(path)
    if not os.path.isdir(place):
        if not os.path.lexists(place):
            return PathKind.NOTHING
        if place.endswith(FAILED_PICTURE_SUFFIX):
            return PathKind.DIAGNOSTIC
        above = _kind_without_runs(os.path.dirname(place))
        return PathKind.DIAGNOSTIC if above in (PathKind.RUN_FOLDER, PathKind.DIAGNOSTIC) else PathKind.FILE
    kind = _kind_without_runs(place)
    return PathKind.RUN_FOLDERS if kind is PathKind.FILES and find_record_files(Path(path), "*/*/", "*/*/*/") else kind


def holds_files_of_users(folder: str) -> tuple[bool, bool]:
    """Tell a walk through folders whether a folder's files, and those in folders below it, are a user's."""
    kind = _kind_without_runs(os.path.abspath(folder))
    return kind not in WRITTEN_KINDS, kind not in WRITTEN_KINDS or kind is PathKind.RUN_FOLDER


def path_refusal(path: Path, expected: str) -> str:
    """Return the line that refuses a path: what it is, what was expected, and which command takes it."""
    kind = path_kind(path)
    if kind is PathKind.DATA_SET:
        app = _manifest_app(path)
        remedy = f"fit its test tasks by metapp meta {app} {path}, or check it by metapp data check {path}"
    elif kind in KINDS_WITH_FITS:
        remedy = f"metapp view, metapp export and metapp compare take it: metapp view {path}"
    elif kind is PathKind.DIAGNOSTIC:
        remedy = "give the photos or files themselves"
    elif kind is PathKind.RECTIFIED:
        remedy = f"fit it by metapp meta svbrdf_nonstationary {path}"
    else:
        remedy = "check the path"
    return f"{path}: {kind.value}, expected {expected}; {remedy}."


def check_files_of_user(path: Path, expected: str, *, data_sets: bool = False) -> None:
    """Refuse what metapp itself has written where files of a user are read.

    Args:
        path: of an input.
        expected: what is read, in words.
        data_sets: whether data sets are taken, too.

    Raises:
        ValueError: a data set, a fit, a run, or pictures that show results.
    """
    place = os.path.abspath(path)
    # whether a folder holds runs, which no kind of WRITTEN is, takes a longer look
    kind = _kind_without_runs(place) if os.path.isdir(place) else path_kind(path)
    if kind in WRITTEN_KINDS and not (data_sets and kind is PathKind.DATA_SET):
        raise ValueError(path_refusal(path, expected))


def find_record_files(folder: Path, *places: str) -> list[Path]:
    """Return the records of fits in a folder, whose folders the patterns `places` name; not those behind links."""
    found = [file for place in places for file in folder.glob(f"{place}{RECORD}")]
    found = [file for file in found if file.resolve() == folder.resolve() / file.relative_to(folder)]
    return [file for file in found if not file.parent.name.startswith(PARTIAL_PREFIX) and _is_fit(str(file.parent))]


def is_data_set(path: Path) -> bool:
    """Test whether a path is a data set, by its manifest alone."""
    return _is_data_set(os.path.abspath(path))


@cached_lookup
def _kind_without_runs(folder: str) -> PathKind:
    """Return the kind of a folder by its absolute path, FILES of a folder of runs, which takes a longer look."""
    if _is_data_set(folder):
        return PathKind.DATA_SET
    if _is_fit(folder):
        return PathKind.FIT
    above = os.path.dirname(folder)
    if os.path.basename(folder) == DIAGNOSTIC_FOLDER and (_is_data_set(above) or _is_rectified(above)):
        return PathKind.DIAGNOSTIC
    if _is_run(folder):
        return PathKind.RUN_FOLDER
    return PathKind.RECTIFIED if _is_rectified(folder) else PathKind.FILES


def _is_data_set(folder: str) -> bool:
    """Tell by the manifest; one that is damaged counts if files of tasks lie beside it."""
    file = os.path.join(folder, MANIFEST)
    if not os.path.isfile(file):
        return False
    manifest = _json_of(file)
    if isinstance(manifest, dict) and manifest.keys() >= {"app", "tasks"}:
        return True
    return any(name.endswith(SHARD_SUFFIX) for name in os.listdir(folder))


def _is_fit(folder: str) -> bool:
    """Tell by the record; one that is damaged counts if parameters lie beside it."""
    file = os.path.join(folder, RECORD)
    if not os.path.isfile(file):
        return False
    record = _json_of(file)
    is_record = isinstance(record, dict) and "name" in record
    return is_record or os.path.isfile(os.path.join(folder, PARAMS))


def _is_run(folder: str) -> bool:
    try:
        return any(
            entry.is_dir(follow_symlinks=False) and not entry.name.startswith(".") and _is_fit(entry.path)
            for entry in list_folder(folder)
        )
    except OSError:  # that cannot be read, which whoever reads it says
        return False


def _is_rectified(folder: str) -> bool:
    return any(os.path.isfile(os.path.join(folder, name)) for name in (CAMERA_TEXT, LIGHT_TEXT))


def _json_of(file: str) -> object:
    """Return the content of a JSON file; None of another one."""
    try:
        return json.loads(read_bytes(file))
    except (ValueError, RecursionError, OSError):
        return None


def _manifest_app(folder: Path) -> str:
    """Return the application that a data set's manifest names, "APP" if it names none."""
    manifest = _json_of(str(folder / MANIFEST))
    app = manifest.get("app") if isinstance(manifest, dict) else None
    return app if isinstance(app, str) and app.isidentifier() else "APP"
