"""The data sets that metapp makes by itself: on first use, into the user's cache."""

from __future__ import annotations

import inspect
import os
import shutil
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from metapp.apps import class_of
from metapp.learning.task import Task
from metapp.names import embedded_apps
from metapp.registry import registry
from metapp.runs.environment import torch_defaults
from metapp.runs.reporter import progress, say
from metapp.storage import Document
from metapp.storage.cache_folders import cache_folder
from metapp.storage.files import PARTIAL_PREFIX, partial_path
from metapp.storage.folders import PathKind, path_kind
from metapp.storage.shards import read_manifest, write_data_set

if TYPE_CHECKING:
    from metapp.contracts import EmbeddedSet

DEFAULT_SET_VERSION = 1  # a module's own is raised when its draw changes, so that no older set is taken for the new one

_PART = "part"  # the note that names the one split of a set that its folder holds; a whole set has none
_STALE_SECONDS = 3600.0


def embedded_module(app: str) -> EmbeddedSet:
    """Import and return the module that draws an application's embedded set.

    Raises:
        ValueError: there is none; the message lists the applications that have one.
    """
    if app not in registry().synthetic:
        raise ValueError(f"{app}: no embedded data set, expected one of {', '.join(embedded_apps())}.")
    return registry().synthetic[app].load()


def split_counts(app: str, count: int | None = None) -> dict[str, int]:
    """Count the tasks of each split of an embedded set.

    Args:
        app: the application.
        count: of both splits, in the proportion of the default set (four to one); two or more give both splits one.

    Raises:
        ValueError: an unknown application; a count below 1.
    """
    default = embedded_module(app).COUNTS
    if count is None:
        return dict(default)
    if count < 1:
        raise ValueError(f"{app}: {count} tasks, expected 1 or more.")
    test = round(count * default["test"] / sum(default.values()))
    test = max(test, min(1, count - 1))
    return {"train": count - test, "test": test}


def make_embedded_set(
    app: str,
    seed: int = 0,
    count: int | None = None,
    out: Path | None = None,
    quiet: bool = False,
    options: Mapping[str, object] | None = None,
    *,
    overwrite: bool = False,
) -> Path:
    """The folder of an application's embedded data set, made now if it is not there yet.

    Args:
        app: the application.
        seed: of all draws, >= 0.
        count: how many tasks; None is the default set.
        out: the folder of the set; None is the cache, from which a finished set of the same application, seed and count
            is taken as it is.
        quiet: no progress.
        options: of the set, by name.
        overwrite: whether a data set that is in `out` is replaced.

    Raises:
        ValueError: an application without embedded set, or without one of the options; a count below 1, a negative
            seed, a folder that holds other data.
    """
    counts = split_counts(app, count)
    notes = _notes(app, seed, sum(counts.values()), options or {})
    if out is not None:
        _make(app, out, counts, notes, overwrite=overwrite, quiet=quiet)
        return out
    return _in_cache(app, counts, notes, quiet=quiet)


def make_embedded_test_set(app: str, quiet: bool = False) -> Path:
    """Return a folder that holds the test tasks of an application's default embedded set.

    Fits and tables need no training tasks, which are nine of ten and take minutes to draw. Test tasks drawn alone are
    those of the whole set, bit by bit, but lie in a folder of their own in the cache, which has its own label. Once
    that folder is there it is taken even if the whole set is made later, so that a training changes no label of fits.
    A whole set that was there first is taken as it is, and its label stays, too.

    Args:
        app: the application.
        quiet: no progress.

    Returns:
        The folder of the test tasks, made now if neither it nor the whole set is there.

    Raises:
        ValueError: an application without embedded set; a cache that cannot be written to.
    """
    counts, notes = split_counts(app), _default_notes(app)
    part = notes | {_PART: "test"}
    whole = _cached(app, notes)
    if not _is_finished(_cached(app, part), app, part) and _is_finished(whole, app, notes):
        return whole
    return _in_cache(app, {"test": counts["test"]}, part, quiet=quiet)


def embedded_folders(app: str) -> list[Path]:
    """Return the folders of an application's default embedded set that are there: of its test tasks, of all tasks."""
    if app not in embedded_apps():
        return []
    notes = _default_notes(app)
    folders = [_cached(app, notes | {_PART: "test"}), _cached(app, notes)]
    return [folder for folder in folders if path_kind(folder) is PathKind.DATA_SET]


def has_embedded_training(app: str) -> bool:
    """True if the whole default embedded set has been made already, with its training tasks."""
    return app in embedded_apps() and _cached(app, _default_notes(app)) in embedded_folders(app)


def has_embedded_tests(app: str) -> bool:
    """True if the test tasks of the default embedded set have been made already."""
    return bool(embedded_folders(app))


def _in_cache(app: str, counts: dict[str, int], notes: Document, *, quiet: bool) -> Path:
    """Return the folder in the cache of the set that is drawn as the notes say, made now if it is not there."""
    folder = _cached(app, notes)
    if _is_finished(folder, app, notes):
        return folder
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(
            f"{folder.parent}: {error.strerror}, expected a folder that can be written; set METAPP_CACHE to one."
        ) from None
    if not quiet:
        what = f"{notes[_PART]} tasks of the embedded data set" if _PART in notes else "embedded data set"
        say(f"{app}: making the {what}, once: {folder}")
    for left in folder.parent.glob(f"{PARTIAL_PREFIX}*"):  # by programs that were killed
        if time.time() - left.stat().st_mtime > _STALE_SECONDS:
            shutil.rmtree(left, ignore_errors=True)
    work = partial_path(folder)  # another program may be making the same set
    try:
        _make(app, work, counts, notes, quiet=quiet)
        try:
            os.replace(work, folder)
        except OSError:  # there is one: of another program that was faster, or a damaged one
            if not _is_finished(folder, app, notes):
                shutil.rmtree(folder, ignore_errors=True)
                os.replace(work, folder)
    finally:
        shutil.rmtree(work, ignore_errors=True)
    return folder


def _default_notes(app: str) -> Document:
    """Return the manifest's notes of the default set."""
    return _notes(app, 0, sum(split_counts(app).values()), {})


def _notes(app: str, seed: int, count: int, options: Mapping[str, object]) -> Document:
    """The manifest's notes of how a set is drawn; ValueError if it has not such an option."""
    module, offered = embedded_module(app), _options(app)
    notes = {"made_by": "metapp data synth", "version": getattr(module, "VERSION", DEFAULT_SET_VERSION), "seed": seed}
    for name, value in options.items():
        if name not in offered:
            raise ValueError(f"{app}: {name} {value}, but its embedded set has no such option; leave --{name} out.")
    own = {name: value for name, value in options.items() if value != getattr(module, name.upper(), None)}
    return notes | {"count": count} | own


def _options(app: str) -> list[str]:
    return [*inspect.signature(embedded_module(app).synthetic_tasks).parameters][3:]


def _drawn(app: str, notes: Document) -> dict[str, object]:
    """The options that a set was drawn by."""
    return {name: notes[name] for name in _options(app) if name in notes}


def _cached(app: str, notes: Document) -> Path:
    """The folder in the cache of a set that is drawn so."""
    ways = "".join(f"-{name}" if value is True else f"-{name}{value}" for name, value in _drawn(app, notes).items())
    part = f"-{notes[_PART]}" if _PART in notes else ""
    return cache_folder() / "data" / f"{app}-{notes['count']}{ways}-seed{notes['seed']}-v{notes['version']}{part}"


def _make(
    app: str, folder: Path, counts: dict[str, int], notes: Document, *, overwrite: bool = False, quiet: bool
) -> None:
    module, drawn = embedded_module(app), _drawn(app, notes)
    units = module.units_of(**drawn) if hasattr(module, "units_of") else module.UNITS

    def draw() -> Iterator[tuple[Task, str, str]]:
        with progress(f"{app} data", sum(counts.values()), quiet=quiet) as bar:
            for split, count in counts.items():
                for task in module.synthetic_tasks(split, count, notes["seed"], **drawn):
                    yield task, split, ""
                    bar.advance(task.name)

    with torch_defaults(single=class_of(app).single_threaded):
        write_data_set(folder, app, units, draw(), notes, getattr(module, "BESIDE", None), overwrite=overwrite)


def _is_finished(folder: Path, app: str, notes: Document) -> bool:
    try:
        manifest = read_manifest(folder)
    except ValueError:
        return False
    whole = all((folder / entry.file).is_file() for entry in manifest.tasks)
    return manifest.app == app and manifest.notes == notes and whole
