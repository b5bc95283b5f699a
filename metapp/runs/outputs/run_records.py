"""Runs that have ended: their records, the tasks that they fitted, and exports of their fits.

Anybody may have written a record that is read here: its settings are checked before a run is made of them.
"""

from __future__ import annotations

import contextlib
import functools
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from msgspec.structs import replace

from metapp.entries import did_you_mean
from metapp.learning.task import Task
from metapp.runs.choice import choose_as_recorded
from metapp.runs.data_sets.embedded import embedded_folders
from metapp.runs.fit_options import application_named, check_export, extract_data_set, fit_options
from metapp.runs.inputs.refusals import path_refusal
from metapp.runs.inputs.run_inputs import FILES_LABEL, Input, data_label, find_inputs, read_test_tasks, task_digest
from metapp.runs.outputs.fit_files import export_fit, export_path, file_to_open
from metapp.runs.reporter import progress, say
from metapp.storage import Document
from metapp.storage.fit_records import FitRecord, Settings
from metapp.storage.fit_store import PARAMS, RECORD, read_fit_record, read_fit_records, read_packed_record
from metapp.storage.folders import FolderKind, find_record_files, path_kind
from metapp.storage.parameters import read_checked_params


class RunRecords(NamedTuple):
    """Records of fits, and the folder that they were read from.

    Attributes:
        folder: the folder of a run, or of one of its tasks.
        records: the records, each with the `folder` of its fit.
    """

    folder: Path
    records: list[FitRecord]


def read_run_records(place: Path, task: str = "", *, by_paradigm: bool = True) -> RunRecords:
    """Read the records of a run.

    Args:
        place: the folder of a run or of one of its tasks, or a folder of runs, whose newest run is taken.
        task: the name of the one task whose record is wanted; "" for all tasks.
        by_paradigm: whether to read fits by paradigms alone, which have parameters of a network; else results of
            methods without a network are read, too.

    Raises:
        ValueError: there is no record or none of that task, or the one of a task's folder has other settings than
            metapp writes; in the folder of a run such records are passed over with a warning.
    """
    folder, records = place, list[FitRecord]()
    if not (task_record := read_fit_record(place, timed=by_paradigm)):
        folder, records = _read_newest_run(place, by_paradigm=by_paradigm)
    elif task_record.settings.paradigm or not by_paradigm:
        _require_known_settings(task_record)
        records = [task_record]
    if not records:
        expected = "a run's folder, such as runs/brdf/meta"
        if (kind := path_kind(place)) in (FolderKind.DATA_SET, FolderKind.RESULTS):
            raise ValueError(path_refusal(place, kind, expected))
        state = "no folders of fits" if folder.is_dir() else "a file" if folder.is_file() else "no such folder"
        raise ValueError(f"{place}: {state}, expected {expected}.")
    names = [record.name for record in records]
    if task and task not in names:
        first_names = f"{', '.join(names[:5])}{' and so on' if len(names) > 5 else ''}"
        hint = did_you_mean(task, names)
        raise ValueError(f"{place}: no record of task '{task}', expected one of {first_names}.{hint}")
    return RunRecords(folder, [records[names.index(task)]] if task else records)


def _require_known_settings(record: FitRecord) -> None:
    """Refuse a record by whose settings no fit can be shown again, as of another program or another version.

    Raises:
        ValueError: a setting is missing or not known; the message names the file.
    """
    try:
        for name in ("app", "data", "recipe"):
            if not getattr(record.settings, name):
                raise ValueError(f"'{name}' is missing, expected text")
        choose_as_recorded(record.settings)
    except ValueError as error:
        place = Path(record.folder)
        file = place if place.is_file() else place / RECORD
        raise ValueError(f"{file}: {record.name}: {str(error).rstrip('.')}; fit again.") from None


def read_fit_of_file(file: Path) -> FitRecord:
    """Read the record of a fit by one of its files.

    Args:
        file: a file that `Fit.save` wrote, or the parameters or the record in a fit's folder.

    Raises:
        ValueError: the file belongs to no fit, or the record has other settings than metapp writes.
    """
    record = read_fit_record(file.parent, timed=True) if file.name in (RECORD, PARAMS) else None
    record = record or read_packed_record(file)
    _require_known_settings(record)
    return record


def holds_fits(path: Path) -> bool:
    """Test whether a path is the folder of a fit, of a run or of runs, which :func:`read_run_records` reads."""
    return path_kind(path) in (FolderKind.FIT, FolderKind.RUN) or bool(find_record_files(path))


def _read_newest_run(folder: Path, *, by_paradigm: bool) -> tuple[Path, list[FitRecord]]:
    """Read the records of the run with the latest record in a folder of runs, such as `runs` or `runs/brdf`.

    Records that are none of a fit are passed over, and so are runs without others.

    Args:
        folder: the folder of runs; of any other one the records right in it are read.
        by_paradigm: whether records must be of fits by paradigms; see :func:`read_run_records`.

    Returns:
        The folder of the run and its records; the folder as it is and [] if there are none.
    """
    known_settings: list[Settings] = []

    def check_once(record: FitRecord) -> None:  # a run may hold thousands of fits by few settings
        if (record.settings.paradigm or not by_paradigm) and record.settings not in known_settings:
            _require_known_settings(record)
            known_settings.append(record.settings)

    def read_run(run_folder: Path) -> list[FitRecord]:
        records = read_fit_records(run_folder, timed=by_paradigm, check=check_once)
        return [record for record in records if record.settings.paradigm or not by_paradigm]

    record_files = sorted(find_record_files(folder), key=lambda file: file.stat().st_mtime_ns, reverse=True)
    for run_folder in dict.fromkeys(file.parent.parent for file in record_files):
        if records := read_run(run_folder):
            say(f"{folder}: the newest run is {run_folder}")
            return run_folder, records
    return folder, read_run(folder)


def find_fitted_tasks(records: list[FitRecord], inputs: list[Path], data: Path | None) -> dict[str, Task]:
    """Find the tasks that were fitted in a run, and read them.

    They are looked for in the given inputs or data set, else at the places in the records, else in the embedded set.

    Args:
        records: the records of the run.
        inputs: files and folders, or a data set, that were fitted; [] if they are not given.
        data: the data set that was fitted; None if it is not given.

    Returns:
        Tasks by name, without those that are not found, or that have changed since they were fitted.
    """
    return {
        name: task
        for group in group_by_settings(records)
        for name, task in _find_tasks_of_group(group, inputs, data).items()
    }


def group_by_settings(records: Iterable[FitRecord]) -> list[list[FitRecord]]:
    """Group records by their settings: a run's folder may hold fits of several commands."""
    groups: dict[str, list[FitRecord]] = {}
    for record in records:
        groups.setdefault(json.dumps(record.settings.document(), sort_keys=True), []).append(record)
    return list(groups.values())


def _find_tasks_of_group(records: list[FitRecord], inputs: Sequence[Path], data: Path | None) -> dict[str, Task]:
    """Find the tasks of records of equal settings; see :func:`find_fitted_tasks`."""
    settings, origins = records[-1].settings, [record.origin for record in records]
    inputs, data = extract_data_set(inputs, data)
    label, places = settings.data, [place for origin in origins for place in origin.inputs]
    if not (inputs or data):
        places += [record.source for record in records] if label == FILES_LABEL else []
        inputs = [path for path in map(Path, dict.fromkeys(places)) if path.exists()]
        data_folders = (Path(origin.data) for origin in origins if origin.data)
        data = next((folder for folder in data_folders if folder.is_dir()), None)
    # test tasks of the embedded set may lie in a folder of their own, or beside its training tasks
    application = application_named(settings.app)
    embedded = next((folder for folder in embedded_folders(application) if data_label(folder) == label), None)
    if not (inputs or data or embedded):
        return {}
    choice = choose_as_recorded(settings, inputs=inputs, data=data)
    if inputs:
        return _read_unchanged_tasks(records, find_inputs(choice)[0])
    tasks, present_label = read_test_tasks(application, choice.app, data or embedded, quiet=True)
    return {task.name: task for task in tasks} if present_label == label else {}


def _read_unchanged_tasks(records: list[FitRecord], inputs: list[Input]) -> dict[str, Task]:
    """Read the tasks of records from files that have not changed since, even if they were moved.

    Args:
        records: the records of the fits.
        inputs: the inputs to read; a file whose name no record has is not read.

    Returns:
        Tasks by the name in their record.
    """
    names, tasks_by_digest = {Path(record.source).name for record in records}, {}
    for run_input in inputs:
        if Path(run_input.place).name in names:
            with contextlib.suppress(ValueError, OSError):  # a file that was damaged since is not found
                task = run_input.read_task()
                tasks_by_digest[task_digest(task)] = task
    pairs = [(record.name, tasks_by_digest.get(record.content)) for record in records]
    return {name: task._replace(name=name) for name, task in pairs if task}


def export_fits(
    place: Path, form: str, inputs: list[Path], *, data: Path | None, out: Path | None, options: Document, quiet: bool
) -> tuple[Path, list[str], list[Path]]:
    """Write every fit of a run in another file format.

    Args:
        place: the folder of a run, or of one of its tasks.
        form: the name of the format, one value of --export.
        inputs: the fitted files, for formats that hold something of the input, too.
        data: the data set whose test tasks were fitted, for such formats.
        out: the folder to write to; None for a folder of the format's name in the folder of each fit.
        options: the application's own options by name, which are set beside those of the records.
        quiet: whether no progress is shown.

    Returns:
        The folder that holds all exports, the names of the fits, and for each the file that a user opens.

    Raises:
        BadOption: fits of the application cannot be written in this format, or not with these options.
        ValueError: there is no run, records or parameters are damaged, or a format needs inputs that are not given.
    """
    folder, records = read_run_records(place)
    app_names = {record.settings.app for record in records}
    if len(app_names) > 1:
        names = ", ".join(sorted(app_names))
        raise ValueError(f"{place}: fits of {names}, expected one application; take one run's folder.")
    (app_name,) = app_names
    check_export(form, application_named(app_name))
    fit_options(app_name, **options)
    files = []
    with progress(form, len(records), quiet=quiet) as bar:
        tasks: dict[str, Task] | None = None
        for record in records:
            settings, name = record.settings, record.name
            choice = choose_as_recorded(settings, options)
            theta = read_checked_params(record, choose_as_recorded(settings).app if options else choice.app)
            if options:
                settings = replace(settings, options=settings.options | options)
            write = functools.partial(export_fit, choice, theta=theta, path=export_path(record, form, out), name=form)
            if tasks is None and (inputs or data):  # some formats do without the input, but have more detail with it
                tasks = find_fitted_tasks(records, inputs, data)
            try:
                write(task=(tasks or {}).get(name, Task(name, {})), settings=settings)
            except KeyError as missing:  # the format holds something of the input, too, which takes time to read
                tasks = find_fitted_tasks(records, inputs, data) if tasks is None else tasks
                if name not in tasks:
                    raise ValueError(
                        f"{name}: {form} is made of the fit and its input ({missing}), expected both; "
                        "give what was fitted after the form, or --data."
                    ) from None
                write(task=tasks[name], settings=settings)
            files.append(file_to_open(export_path(record, form, out)))
            bar.advance(name)
    target = out or (folder if len(records) > 1 else export_path(records[0], form).parent)
    return target, [record.name for record in records], files
