"""Runs that are over: their records, the tasks that were fitted, and exports of their fits."""

from __future__ import annotations

import contextlib
import functools
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from metapp.learning.app import App
from metapp.learning.task import Task
from metapp.names import did_you_mean
from metapp.runs.fit_options import check_app_name, check_export, extract_data_set, fit_options
from metapp.runs.inputs.embedded import embedded_folders
from metapp.runs.inputs.run_inputs import FILES_LABEL, Input, data_label, find_inputs, read_test_tasks, task_digest
from metapp.runs.outputs.fit_files import export_fit, export_path, file_to_open
from metapp.runs.reporter import progress, say
from metapp.runs.run import Run
from metapp.storage import Document
from metapp.storage.files import get_json_entry, path_from_json_text
from metapp.storage.fit_folders import (
    NUMBER_ENTRIES,
    PARAMS,
    RECORD,
    read_fit_record,
    read_fit_records,
    read_packed_record,
)
from metapp.storage.folders import KINDS_WITH_FITS, PathKind, find_record_files, path_kind, path_refusal
from metapp.storage.parameters import read_checked_params

# settings that plans are made of, and what they are where records lack them
TEXT_SETTINGS = {"app": None, "data": None, "recipe": None, "paradigm": "", "rule": "", "observe": ""}
# types of further settings, where records have them
SETTING_TYPES = {
    **dict.fromkeys(("steps", "batch", "seed"), int),
    **dict.fromkeys(("checkpoint", "device", "precision"), str),
    **dict.fromkeys(("adam", "guard", "versions"), dict),
}


class RunRecords(NamedTuple):
    """A run's folder, or that of one of its tasks, and records of fits, each with its own `folder`."""

    folder: Path
    records: list[Document]


def read_run_records(place: Path, task: str = "", *, by_paradigm: bool = True) -> RunRecords:
    """The records of a run.

    Args:
        place: the folder of a run or of one of its tasks, or a folder of runs, whose newest run is taken.
        task: the one to take; "" for all.
        by_paradigm: fits alone, to which a network's parameters belong; else those of methods without one, too.

    Raises:
        ValueError: there are none, none of that task, or one of other settings than metapp writes.
    """
    entries = ("settings", *(NUMBER_ENTRIES if by_paradigm else ("error",)))
    one = read_fit_record(place, entries)
    folder = place if one else _newest_run_folder(place)
    records = [one] if one else read_fit_records(folder, entries)
    if by_paradigm:
        records = [record for record in records if record["settings"].keys() >= {"paradigm", "rule"}]
    if not records:
        expected = "a run's folder, such as runs/brdf/meta"
        if path_kind(place) in (PathKind.DATA_SET, PathKind.RECTIFIED, PathKind.DIAGNOSTIC):
            raise ValueError(path_refusal(place, expected))
        state = "no folders of fits" if folder.is_dir() else "a file" if folder.is_file() else "no such folder"
        raise ValueError(f"{place}: {state}, expected {expected}.")
    names = [record["name"] for record in records]
    if task and task not in names:
        some = f"{', '.join(names[:5])}{' and so on' if len(names) > 5 else ''}"
        raise ValueError(f"{place}: no record of task '{task}', expected one of {some}.{did_you_mean(task, names)}")
    chosen = [records[names.index(task)]] if task else records
    for record in chosen:
        _check_settings(record)
    return RunRecords(folder, chosen)


def _check_settings(record: Document) -> None:
    """Refuse settings and an origin, which anybody may have written, that no run can be made of.

    Raises:
        ValueError: one is missing or of another type.
    """
    settings, origin = record["settings"], record.get("origin", {})
    place = Path(record["folder"])
    where = f"{place if place.is_file() else place / RECORD}: {record['name']}: "
    for key, absent in TEXT_SETTINGS.items():
        get_json_entry(settings, key, str, where, "fit again", absent)
    for key, kind in SETTING_TYPES.items():
        if settings.get(key) is not None:
            get_json_entry(settings, key, kind, where, "fit again")
    get_json_entry(settings, "options", dict, where, "fit again", {})
    get_json_entry(origin, "data", str, where, "fit again", "")
    if not all(isinstance(place, str) for place in get_json_entry(origin, "inputs", list, where, "fit again", [])):
        raise ValueError(f"{where}'inputs' hold more than text, expected paths; fit again.")


def read_fit_of_file(file: Path) -> Document:
    """The record of the fit in a file of `Fit.save`, or of the folder that a file of a fit lies in.

    Raises:
        ValueError: there is none, or one of other settings than metapp writes.
    """
    if file.name in (RECORD, PARAMS) and (record := read_fit_record(file.parent, ("settings", *NUMBER_ENTRIES))):
        _check_settings(record)
        return record
    record = read_packed_record(file, ("settings", *NUMBER_ENTRIES))
    _check_settings(record)
    return record


def holds_fits(path: Path) -> bool:
    """True if `read_run_records` may take a folder for one of a task, of a run or of runs."""
    return path_kind(path) in KINDS_WITH_FITS


def _newest_run_folder(folder: Path) -> Path:
    """The run of the latest record in a folder of runs, such as `runs` or `runs/brdf`; else the folder itself."""
    found = find_record_files(folder, "*/*/", "*/*/*/") if path_kind(folder) is PathKind.RUN_FOLDERS else []
    newest = max(found, key=lambda file: file.stat().st_mtime_ns).parent.parent if found else folder
    if found:
        say(f"{folder}: the newest run is {newest}")
    return newest


def find_fitted_tasks(records: list[Document], app: App, inputs: list[Path], data: Path | None) -> dict[str, Task]:
    """The tasks that were fitted in a run, by name: of given inputs, else from places in its records, else embedded.

    Returns:
        Without those that are not there, or not as they were fitted.
    """
    return {
        key: task for some in group_by_settings(records) for key, task in _tasks_as(some, app, inputs, data).items()
    }


def group_by_settings(records: Iterable[Document]) -> list[list[Document]]:
    """Groups of records of the same settings: a run's folder holds fits of several commands."""
    groups: dict[str, list[Document]] = {}
    for record in records:
        groups.setdefault(json.dumps(record["settings"], sort_keys=True), []).append(record)
    return list(groups.values())


def _tasks_as(records: list[Document], app: App, inputs: Sequence[Path], data: Path | None) -> dict[str, Task]:
    """The same of records of the same settings."""
    settings, origins = records[-1]["settings"], [record.get("origin", {}) for record in records]
    inputs, data = extract_data_set(inputs, data)
    label, places = settings["data"], [place for origin in origins for place in origin.get("inputs", [])]
    if not (inputs or data):
        places += [record.get("source", "") for record in records] if label == FILES_LABEL else []
        inputs = [path for path in map(path_from_json_text, dict.fromkeys(places)) if path.exists()]
        sets = (path_from_json_text(origin["data"]) for origin in origins if "data" in origin)
        data = next((path for path in sets if path.is_dir()), None)
    # which of the embedded set's folders: that of test tasks alone, or of all tasks
    embedded = next((folder for folder in embedded_folders(app.name) if data_label(folder) == label), None)
    if not (inputs or data or embedded):
        return {}
    run = Run.of_settings(settings, inputs=inputs, data=data)
    if inputs:
        return _of_sources(records, find_inputs(run)[0])
    tasks, now = read_test_tasks(app, data or embedded, quiet=True)
    return {task.name: task for task in tasks} if now == label else {}


def _of_sources(records: list[Document], sources: list[Input]) -> dict[str, Task]:
    """Tasks of files that have not changed since, wherever these are now; those of other names are not read."""
    names, read = {Path(record.get("source", "")).name for record in records}, {}
    for source in sources:
        if Path(source.place).name in names:
            with contextlib.suppress(ValueError, OSError):  # one that was damaged meanwhile
                task = source.task()
                read[task_digest(task)] = task
    pairs = [(record["name"], read.get(record.get("content", ""))) for record in records]
    return {name: task._replace(name=name) for name, task in pairs if task}


def export_fits(
    place: Path, form: str, inputs: list[Path], *, data: Path | None, out: Path | None, options: Document, quiet: bool
) -> tuple[Path, list[str], list[Path]]:
    """Write every fit of a run.

    Args:
        place: the folder of a run, or of one of its tasks.
        form: as of --export.
        inputs: the fitted files, for forms that are made of these, too.
        data: the data set whose test tasks were fitted, for the same.
        out: folder to write to; None: a folder of the form's name in each task's.
        options: that are fields of the application, by name.
        quiet: no progress.

    Returns:
        The folder that holds all of it, the names of the fits, and the file that a user opens of each.

    Raises:
        BadOption: fits of the application cannot be written so, or not by these options.
        ValueError: no run, damaged records or parameters, or inputs that a form needs and that are not given.
    """
    folder, records = read_run_records(place)
    apps = {record["settings"]["app"] for record in records}
    if len(apps) > 1:
        of = ", ".join(sorted(apps))
        raise ValueError(f"{place}: fits of {of}, expected one application; take one run's folder.")
    (name,) = apps
    check_app_name(name)
    check_export(form, name)
    fit_options(name, **options)
    files = []
    with progress(form, len(records), quiet=quiet) as bar:
        tasks: dict[str, Task] | None = None
        for record in records:
            settings, name = record["settings"], record["name"]
            of_fit = Run.of_settings(settings, options=options)
            theta = read_checked_params(record, Run.of_settings(settings).app if options else of_fit.app)
            if options:
                settings = settings | {"options": settings.get("options", {}) | options}
            write = functools.partial(export_fit, of_fit, theta=theta, path=export_path(record, form, out), name=form)
            try:
                write(task=Task(name, {}), settings=settings)
            except KeyError as missing:  # of a form that is made of the input, too, which takes time to read
                tasks = find_fitted_tasks(records, of_fit.app, inputs, data) if tasks is None else tasks
                if name not in tasks:
                    raise ValueError(
                        f"{name}: {form} is made of the fit and its input ({missing}), expected both; "
                        "give what was fitted after the form, or --data."
                    ) from None
                write(task=tasks[name], settings=settings)
            files.append(file_to_open(export_path(record, form, out)))
            bar.advance(name)
    target = out or (folder if len(records) > 1 else export_path(records[0], form).parent)
    return target, [record["name"] for record in records], files
