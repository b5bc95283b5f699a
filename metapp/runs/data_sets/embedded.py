"""The embedded data sets: synthetic data that metapp draws on first use into the user's cache.

A set in the cache is drawn once and found again by the notes in its manifest, which say how it was drawn. What its
tasks look like is decided by the application's own module of synthetic data.
"""

from __future__ import annotations

import inspect
import os
import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from metapp.application import Application
from metapp.learning.task import Task
from metapp.registry import registry
from metapp.runs.environment import torch_defaults
from metapp.runs.reporter import progress, say
from metapp.storage import Document
from metapp.storage.cache_folders import cache_folder
from metapp.storage.files import partial_path, remove_partial
from metapp.storage.folders import is_data_set
from metapp.storage.shards import read_manifest, write_data_set

if TYPE_CHECKING:
    from metapp.application import EmbeddedSet

# The version of a set whose module states none. A module raises its version when it draws other tasks, so that an older
# set in the cache is not taken for a new one.
DEFAULT_SET_VERSION = 1

_MAKER = "metapp data synth"  # what manifests of embedded sets state as `made_by`
_SPLIT_NOTE = "part"  # the note of a folder that holds one split only, whose value names the split


def embedded_module(application: Application) -> EmbeddedSet:
    """Import and return the module that draws an application's embedded set.

    Raises:
        ValueError: the application has no embedded set; the message lists the applications that have one.
    """
    if application.synthetic is None:
        raise ValueError(
            f"{application.name}: no embedded data set, expected one of {', '.join(registry().embedded_apps)}."
        )
    return application.synthetic.load()


def split_counts(application: Application, count: int | None = None) -> dict[str, int]:
    """Count the tasks of each split of an embedded set.

    Args:
        application: the application.
        count: number of tasks in both splits together, shared in the proportion of the default set (about four to
            one). If it is 2 or more, each split gets at least one task. None stands for the default set.

    Raises:
        ValueError: the application has no embedded set, or the count is below 1.
    """
    default_counts = embedded_module(application).COUNTS
    if count is None:
        return dict(default_counts)
    if count < 1:
        raise ValueError(f"{application.name}: {count} tasks, expected 1 or more.")
    test_count = round(count * default_counts["test"] / sum(default_counts.values()))
    test_count = max(test_count, min(1, count - 1))
    return {"train": count - test_count, "test": test_count}


def make_embedded_set(
    application: Application,
    seed: int = 0,
    count: int | None = None,
    out: Path | None = None,
    quiet: bool = False,
    options: Mapping[str, object] | None = None,
    *,
    overwrite: bool = False,
) -> Path:
    """Make an application's embedded data set if it is not there yet, and return its folder.

    Args:
        application: the application.
        seed: the seed of all random draws, 0 or more.
        count: number of tasks; None for the default set.
        out: the folder to write to. None for the cache, from which a finished set of equal application, seed, count and
            options is taken as it is.
        quiet: whether no progress is shown.
        options: the options of the set, by name.
        overwrite: whether a data set that is in `out` is replaced.

    Raises:
        ValueError: the application has no embedded set or not one of the options, the count is below 1, the seed is
            negative, or the folder holds other data.
    """
    counts = split_counts(application, count)
    notes = _notes(application, seed, sum(counts.values()), options or {})
    if out is not None:
        _write_set(application, out, counts, notes, overwrite=overwrite, quiet=quiet)
        return out
    return _provide_cached_set(application, counts, notes, quiet=quiet)


def make_embedded_test_set(application: Application, quiet: bool = False) -> Path:
    """Make the test tasks of an application's default embedded set if they are not there yet, and return their folder.

    Fits and tables need no training tasks, which are nine of ten and take minutes to draw. Test tasks that are drawn
    alone equal the test tasks of the whole set bit by bit, but lie in a folder of their own in the cache, which has its
    own label. Once this folder is there it is taken even if the whole set is made later, so that a training does not
    change the label of fits. If the whole set was there first, it is taken, and its label stays, too.

    Args:
        application: the application.
        quiet: whether no progress is shown.

    Returns:
        The folder of the test tasks, or of the whole set.

    Raises:
        ValueError: the application has no embedded set, or the cache cannot be written to.
    """
    counts, notes = split_counts(application), _default_notes(application)
    test_notes = notes | {_SPLIT_NOTE: "test"}
    whole_folder = _cached_set_path(application, notes)
    has_test_folder = _is_finished(_cached_set_path(application, test_notes), application, test_notes)
    if not has_test_folder and _is_finished(whole_folder, application, notes):
        return whole_folder
    return _provide_cached_set(application, {"test": counts["test"]}, test_notes, quiet=quiet)


def embedded_folders(application: Application) -> list[Path]:
    """Return the existing folders of an application's default embedded set: of its test tasks, then of all tasks."""
    if application.synthetic is None:
        return []
    notes = _default_notes(application)
    folders = [_cached_set_path(application, notes | {_SPLIT_NOTE: "test"}), _cached_set_path(application, notes)]
    return [folder for folder in folders if is_data_set(folder)]


def is_embedded(folder: Path) -> bool:
    """Test whether a data set was drawn as an embedded one, of any seed, count and options, in the cache or elsewhere.

    Raises:
        ValueError: the folder holds no data set, or its manifest cannot be read.
    """
    return read_manifest(folder).notes.get("made_by") == _MAKER


def has_embedded_training(application: Application) -> bool:
    """Test whether the whole default embedded set has been made already, with its training tasks."""
    return application.synthetic is not None and _cached_set_path(
        application, _default_notes(application)
    ) in embedded_folders(application)


def has_embedded_tests(application: Application) -> bool:
    """Test whether the test tasks of the default embedded set have been made already."""
    return bool(embedded_folders(application))


def _provide_cached_set(application: Application, counts: dict[str, int], notes: Document, *, quiet: bool) -> Path:
    """Make a set in the cache if it is not there yet, and return its folder.

    Args:
        application: the application.
        counts: number of tasks in each split that the folder holds.
        notes: the manifest's notes, which say how the set is drawn.
        quiet: whether no progress is shown.
    """
    folder = _cached_set_path(application, notes)
    if _is_finished(folder, application, notes):
        return folder
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ValueError(
            f"{folder.parent}: {error.strerror}, expected a folder that can be written; set METAPP_CACHE to one."
        ) from None
    if not quiet:
        is_part = _SPLIT_NOTE in notes
        content = f"{notes[_SPLIT_NOTE]} tasks of the embedded data set" if is_part else "embedded data set"
        say(f"{application.name}: making the {content}, once: {folder}")
    remove_partial(folder.parent)
    partial = partial_path(folder)  # under a name of its own, since another program may be making the same set
    try:
        _write_set(application, partial, counts, notes, quiet=quiet)
        try:
            os.replace(partial, folder)
        except OSError:  # a folder is there: another program was faster, or the folder is damaged
            if not _is_finished(folder, application, notes):
                shutil.rmtree(folder, ignore_errors=True)
                os.replace(partial, folder)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return folder


def _default_notes(application: Application) -> Document:
    """Return the manifest's notes of the default set."""
    return _notes(application, 0, sum(split_counts(application).values()), {})


def _notes(application: Application, seed: int, count: int, options: Mapping[str, object]) -> Document:
    """Return the manifest's notes of how a set is drawn: seed, count and the options that are not at their default.

    Args:
        application: the application.
        seed: the seed of all random draws.
        count: number of tasks in both splits together.
        options: the options of the set, by name.

    Raises:
        ValueError: the set does not have one of the options.
    """
    module, option_names = embedded_module(application), _option_names(application)
    notes = {"made_by": _MAKER, "version": getattr(module, "VERSION", DEFAULT_SET_VERSION), "seed": seed}
    for name, value in options.items():
        if name not in option_names:
            raise ValueError(
                f"{application.name}: {name} {value}, but its embedded set has no such option; leave --{name} out."
            )
    changed_options = {name: value for name, value in options.items() if value != getattr(module, name.upper(), None)}
    return notes | {"count": count} | changed_options


def _option_names(application: Application) -> list[str]:
    """Return the names of an embedded set's options: what `synthetic_tasks` takes after split, count and seed."""
    return [*inspect.signature(embedded_module(application).synthetic_tasks).parameters][3:]


def _options_in_notes(application: Application, notes: Document) -> dict[str, object]:
    """Return the options in the notes of a set, by name."""
    return {name: notes[name] for name in _option_names(application) if name in notes}


def _cached_set_path(application: Application, notes: Document) -> Path:
    """Return the folder in the cache of the set that is drawn as its notes say."""
    options = _options_in_notes(application, notes)
    words = "".join(f"-{name}" if value is True else f"-{name}{value}" for name, value in options.items())
    split = f"-{notes[_SPLIT_NOTE]}" if _SPLIT_NOTE in notes else ""
    return (
        cache_folder()
        / "data"
        / f"{application.name}-{notes['count']}{words}-seed{notes['seed']}-v{notes['version']}{split}"
    )


def _write_set(
    application: Application,
    folder: Path,
    counts: dict[str, int],
    notes: Document,
    *,
    overwrite: bool = False,
    quiet: bool,
) -> None:
    """Draw the tasks of an embedded set as its notes say, and write them as a data set.

    Args:
        application: the application.
        folder: the folder to write to.
        counts: number of tasks in each split to draw.
        notes: the notes of the set, which become those of the manifest.
        overwrite: whether a data set that is in the folder is replaced.
        quiet: whether no progress is shown.
    """
    module, options = embedded_module(application), _options_in_notes(application, notes)
    units = module.units_of(**options) if hasattr(module, "units_of") else module.UNITS

    def draw_tasks() -> Iterator[tuple[Task, str, str]]:
        with progress(f"{application.name} data", sum(counts.values()), quiet=quiet) as bar:
            for split, count in counts.items():
                for task in module.synthetic_tasks(split, count, notes["seed"], **options):
                    yield task, split, ""
                    bar.advance(task.name)

    with torch_defaults(single=application.app.load().small_tensors):
        write_data_set(
            folder, application.name, units, draw_tasks(), notes, getattr(module, "BESIDE", None), overwrite=overwrite
        )


def _is_finished(folder: Path, application: Application, notes: Document) -> bool:
    """Test whether a folder holds all files of the set that is drawn as the notes say."""
    try:
        manifest = read_manifest(folder)
    except ValueError:
        return False
    has_all_files = all((folder / entry.file).is_file() for entry in manifest.tasks)
    return manifest.app == application.name and manifest.notes == notes and has_all_files
