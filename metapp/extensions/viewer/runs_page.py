"""Interactive pages of runs: the fits that stand side by side, and their labels."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from os import PathLike
from pathlib import Path

import torch

from data_tools.synthetic.examples import write_example
from metapp.extensions.viewer.view import View, make_view
from metapp.extensions.viewer.viewer_page import FitGroup, write_page
from metapp.learning.task import Task
from metapp.runs.environment import make_folder, torch_defaults
from metapp.runs.execution import execute_run
from metapp.runs.fit import Fit
from metapp.runs.fit_options import fit_options
from metapp.runs.outputs.run_records import RunRecords, find_fitted_tasks, group_by_settings, read_run_records
from metapp.runs.reporter import format_number, progress, say
from metapp.runs.run import Run
from metapp.storage import Document
from metapp.storage.files import file_name
from metapp.storage.parameters import read_checked_params

MAX_PAGE_TASKS = 20  # tasks of a page, unless it says otherwise
PAGE_FILE_NAME = "view.html"
INPUTS_FOLDER = "inputs"  # the folder of those of `metapp try`


def write_runs_page(
    folders: Sequence[Path],
    out: Path | None,
    *,
    inputs: Sequence[Path] = (),
    data: Path | None = None,
    task: str = "",
    most: int = MAX_PAGE_TASKS,
    quiet: bool = False,
) -> Path:
    """Write the page of runs; fits of the same task stand side by side.

    Args:
        folders: of runs, or of their tasks.
        out: the file; None: `view.html` in the first run's folder.
        inputs: the fitted files, if they are not in the places of records.
        data: the data set that was fitted, for the same.
        task: the one to show; "" for all.
        most: tasks at most.
        quiet: no progress.

    Raises:
        ValueError: no run, no fit of that task, damaged records or parameters, nothing that can be shown.
    """
    read = [read_run_records(path, task) for path in folders]
    labels, page = _labels(read), out or read[0].folder / PAGE_FILE_NAME
    names = dict.fromkeys((record["settings"]["app"], record["name"]) for _, records in read for record in records)
    shown = list(names)[:most]
    if len(names) > most:
        say(f"view: {most} of {len(names)} tasks; --most {len(names)} shows all.")
    by_task: dict[tuple[str, str], list[tuple[str, Run, Task, Document]]] = {}
    with progress("view: reading", len(read), quiet=quiet) as bar:
        for folder, records in read:
            records = [record for record in records if (record["settings"]["app"], record["name"]) in shown]
            missing = 0
            for some in group_by_settings(records):
                run = Run.from_settings(some[-1]["settings"])
                tasks = find_fitted_tasks(some, run.app, list(inputs), data)
                missing += sum(record["name"] not in tasks for record in some)
                for record in some:
                    name = record["name"]
                    fit = labels[folder], run, tasks.get(name, Task(name, {})), record
                    by_task.setdefault((run.app.name, name), []).append(fit)
            if missing:
                what = f"the inputs of {missing} of {len(records)} fits are not at hand"
                say(f"view: {what}; give them by --input or --data to see references.")
            bar.advance()
    make_folder(page.parent)  # before what takes time
    groups, lacking = [], list[str]()
    with progress("view", len(by_task), quiet=quiet) as bar:
        for several in by_task.values():
            views = []
            for label, run, fitted, record in several:
                try:
                    views.append(
                        make_labelled_view(Fit(run, fitted, record, read_checked_params(record, run.app)), label)
                    )
                except ValueError as error:
                    lacking.append(f"{label} of {error}")
            _, run, fitted, _ = several[0]
            groups += [FitGroup(fitted.name, run.presenter.title, views)] if views else []
            bar.advance(fitted.name)
    if not groups:
        raise ValueError(lacking[0])
    for line in lacking:
        say(f"warning: left out: {line}")
    titles = dict.fromkeys(several[0][1].presenter.title for several in by_task.values())
    return write_page(f"metapp: {', '.join(titles)}", groups, page)


def _labels(found: Sequence[RunRecords]) -> dict[Path, str]:
    """Labels that tell the runs of an application apart: the paradigm, and as many differences as are needed."""
    settings = {each.folder: each.records[-1]["settings"] for each in found}
    labels = {folder: of["paradigm"] for folder, of in settings.items()}
    for app in {of["app"] for of in settings.values()}:
        folders = [folder for folder, of in settings.items() if of["app"] == app]
        for key in ("rule", "recipe", "steps", "seed"):
            if len({labels[folder] for folder in folders}) == len(folders):
                break
            word = f" {key}" if key in ("steps", "seed") else ""
            if len({str(settings[folder].get(key)) for folder in folders}) > 1:
                labels |= {folder: f"{labels[folder]}{word} {settings[folder].get(key)}" for folder in folders}
    return labels


@torch.no_grad()
def make_labelled_view(fit: Fit, label: str) -> View:
    """The view of a fit, with a label, its error and its seconds.

    Raises:
        ValueError: the view needs the input, which is not at hand.
    """
    try:
        with torch_defaults(single=fit.app.single_threaded):
            view = make_view(fit.run.presenter, fit.parameters, fit.task)
    except KeyError as missing:
        if fit.task.data:
            raise
        raise ValueError(
            f"{fit.name}: its view is made of the fit and its input ({missing}), expected both; "
            "give what was fitted by --input or --data."
        ) from None
    error = "" if fit.error is None else f"error{fit.app.error_measure.factor} {format_number(fit.error, '.3f')}, "
    return view._replace(label=label, caption=f"{error}{format_number(fit.seconds, '.3g')} s")


def write_fit_page(fit: Fit, path: str | bytes | PathLike[str] = "") -> Path:
    """Write an interactive page of a fit, as `metapp view` does.

    Args:
        fit: of the Python API, whose method `view` this is.
        path: the HTML file; "" for one of the task's name in the current folder.

    Raises:
        OSError: the file cannot be written.
    """
    title, views = fit.run.presenter.title, [make_labelled_view(fit, fit.settings["paradigm"])]
    page = Path(os.fsdecode(path or f"{file_name(fit.name)}.html"))
    return write_page(f"metapp: {title}", [FitGroup(fit.name, title, views)], page)


def fit_synthetic_input(app: str, out: Path, recipe: str = "") -> tuple[Path, Document]:
    """Write an input of an application into `out` and fit it by Meta, its run in the same folder.

    Args:
        app: the application.
        out: folder of inputs and runs.
        recipe: of the fit; "" for the application's own.

    Returns:
        The fit's folder; application, name, error, seconds of inference, and those that all of it took.

    Raises:
        ValueError: a folder that cannot be written to; no such recipe, no checkpoint.
    """
    begin = time.perf_counter()
    source = write_example(app, out / INPUTS_FOLDER)[0]
    report = execute_run(Run.from_options(fit_options(app, inputs=[source], recipe=recipe, out=out, quiet=True)))
    assert report is not None  # of several ranks only
    (fit,) = report.records
    told = {key: fit[key] for key in ("name", "error", "seconds")}
    return report.path, {"app": app, **told, "whole_seconds": time.perf_counter() - begin}
