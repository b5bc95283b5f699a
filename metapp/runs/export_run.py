"""Write the fits of a run that is over in another form."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from metapp.apps import presentation_of
from metapp.learning.app import App
from metapp.learning.task import Task
from metapp.runs.embedded import embedded_exists
from metapp.runs.export import check_export, export_fit
from metapp.runs.inputs import data_folder, data_label, tasks_to_fit
from metapp.runs.recorded import app_as, read_run
from metapp.runs.reporter import progress
from metapp.runs.run import check_size
from metapp.runs.session import check_name
from metapp.storage.records import file_name, read_theta


class Exported(NamedTuple):
    """What was written: the form, its folder, and the names of the fits."""

    form: str
    out: str
    tasks: list[str]


def export_run(
    run: Path, form: str, inputs: list[Path], *, data: Path | None, out: Path | None, size: str, quiet: bool
) -> Exported:
    """Write every fit of a run.

    Args:
        run: its folder, or the record file in it.
        form: as of --export.
        inputs: what was fitted, for forms that are made of that, too.
        data: the data set whose test tasks were fitted, for the same.
        out: folder to write to; None: a folder of the form's name in the run's.
        size: "HxW" in px, "" for the application's own.
        quiet: no progress.

    Raises:
        BadOption: fits of the application cannot be written so, or not of that size.
        ValueError: no run, damaged records or parameters, or inputs that a form needs and that are not given.
    """
    folder, records = read_run(run)
    apps = {record["settings"]["app"] for record in records}
    if len(apps) > 1:
        raise ValueError(f"{run}: fits of {', '.join(sorted(apps))}, expected one application; take one run's folder.")
    (name,) = apps
    check_name(name)
    check_export(form, name)
    target = out or folder / form
    with progress(form, len(records), quiet=quiet) as bar:
        tasks: dict[str, dict[str, Task]] = {}
        for record in records:
            app, settings, name = app_as(record["settings"]), record["settings"], record["name"]
            if settings["data"] not in tasks:
                tasks[settings["data"]] = _tasks(app, settings["data"], inputs, data)
            task = tasks[settings["data"]].get(name, Task(name, {}))
            theta, path = read_theta(folder, name), target / file_name(name)
            shown = presentation_of(app, check_size(size, app))
            try:
                export_fit(shown, task, theta, path, form, settings)
            except KeyError as missing:
                if task.data:
                    raise
                raise ValueError(
                    f"{name}: {form} is made of the fit and its input ({missing}), expected both; "
                    "give what was fitted after the form, or --data."
                ) from None
            bar.advance(name)
    return Exported(form, str(target), [record["name"] for record in records])


def _tasks(app: App, label: str, inputs: list[Path], data: Path | None) -> dict[str, Task]:
    """What was fitted, by name, as far as it can be found: inputs, a data set's test tasks."""
    embedded = embedded_exists(app.name) and data_label(data_folder(app, None, quiet=True)) == label
    if not (inputs or data or embedded):
        return {}
    return {task.name: task for task in tasks_to_fit(app, inputs, data, quiet=True)[0]}
