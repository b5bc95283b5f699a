"""Interactive pages of runs: which fits stand side by side, and what is said of each."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import torch

from data_tools.synthetic.examples import EXAMPLES, write_example
from metapp.extensions.viewer.page import Group, Shown, write_page
from metapp.extensions.viewer.view import view_of
from metapp.learning.app import App
from metapp.learning.task import Params, Task
from metapp.runs.execution import execute
from metapp.runs.naming import factor_of, title_of
from metapp.runs.options import fit_options
from metapp.runs.outputs.recorded import Recorded, by_settings, read_run, tasks_as
from metapp.runs.reporter import number, progress, say
from metapp.runs.run import Run
from metapp.runs.surroundings import make_folder, threads, threads_of
from metapp.storage import Document
from metapp.storage.files import file_name
from metapp.storage.fits import read_params

if TYPE_CHECKING:
    from metapp.runs.fit import Fit

MOST = 20  # tasks of a page, unless it says otherwise
PAGE = "view.html"
INPUTS = "inputs"  # the folder of those of `metapp try`


class FitOfRun(NamedTuple):
    """A fit that is to be shown: of which run, its record, what was fitted (without data where that is not at hand)."""

    app: App
    run: Path
    record: Document
    task: Task


def view_page(
    runs: Sequence[Path],
    out: Path | None,
    *,
    inputs: Sequence[Path] = (),
    data: Path | None = None,
    task: str = "",
    most: int = MOST,
    quiet: bool = False,
) -> Path:
    """Write the page of runs; fits of the same task stand side by side.

    Args:
        runs: folders of runs, or of their tasks.
        out: the file; None: `view.html` in the first run's folder.
        inputs: what was fitted, where it is not where records say.
        data: the data set that was fitted, for the same.
        task: the one to show; "" for all.
        most: tasks at most.
        quiet: no progress.

    Raises:
        ValueError: no run, no fit of that task, damaged records or parameters, nothing that can be shown.
    """
    read = [read_run(path, task) for path in runs]
    fits = [fit for run in read for fit in _fits(run, inputs, data)]
    by_task: dict[tuple[str, str], list[FitOfRun]] = {}
    for fit in fits:
        by_task.setdefault((fit.app.name, fit.record["name"]), []).append(fit)
    tasks_shown = list(by_task.values())[:most]
    if len(by_task) > len(tasks_shown):
        say(f"view: {len(tasks_shown)} of {len(by_task)} tasks; --most {len(by_task)} shows all.")
    labels, page = _labels(read), out or read[0].folder / PAGE
    make_folder(page.parent)  # before what takes time
    with progress("view", len(tasks_shown), quiet=quiet) as bar:
        groups, lacking = [], list[str]()
        for several in tasks_shown:
            groups.append(group_of(several, labels, lacking))
            bar.advance(several[0].record["name"])
    groups = [group for group in groups if group.fits]
    if not groups:
        raise ValueError(lacking[0])
    for line in lacking:
        say(f"warning: left out: {line}")
    title = f"metapp: {', '.join(dict.fromkeys(title_of(fit.app) for fit in fits))}"
    return write_page(title, groups, page)


def _fits(run: Recorded, inputs: Sequence[Path], data: Path | None) -> list[FitOfRun]:
    groups = [(Run.of_settings(some[-1]["settings"]).app, some) for some in by_settings(run.records)]
    tasks = {name: task for app, some in groups for name, task in tasks_as(some, app, list(inputs), data).items()}
    if missing := sum(record["name"] not in tasks for record in run.records):
        what = f"the inputs of {missing} of {len(run.records)} fits are not at hand"
        say(f"view: {what}; give them by --input or --data to see references.")
    return [
        FitOfRun(app, run.folder, record, tasks.get(record["name"], Task(record["name"], {})))
        for app, some in groups
        for record in some
    ]


def _labels(runs: Sequence[Recorded]) -> dict[Path, str]:
    """Labels that tell runs apart: the paradigm, and of what differs as much as is needed."""
    labels: dict[Path, str] = {}
    for app in {run.records[-1]["settings"]["app"] for run in runs}:
        labels |= _apart({run.folder: of for run in runs if (of := run.records[-1]["settings"])["app"] == app})
    return labels


def _apart(settings: dict[Path, Document]) -> dict[Path, str]:
    labels = {folder: of["paradigm"] for folder, of in settings.items()}
    for key in ("rule", "recipe", "steps", "seed"):
        if len(set(labels.values())) == len(labels):
            break
        word = f" {key}" if key in ("steps", "seed") else ""
        if len({str(of.get(key)) for of in settings.values()}) > 1:
            labels = {folder: f"{label}{word} {settings[folder].get(key)}" for folder, label in labels.items()}
    return labels


@torch.no_grad()
def group_of(fits: Sequence[FitOfRun], labels: dict[Path, str], lacking: list[str]) -> Group:
    """Fits of one task, side by side; `lacking` gets a line for each that needs what was fitted and has not got it."""
    shown = []
    for fit in fits:
        try:
            theta = read_params(fit.record["folder"])
            with threads(threads_of(fit.app)):
                shown.append(shown_of(fit.app, labels[fit.run], fit.record, theta, fit.task))
        except ValueError as error:
            lacking.append(f"{labels[fit.run]} of {error}")
    return Group(fits[0].record["name"], title_of(fits[0].app), shown)


def shown_of(app: App, label: str, record: Document, theta: Params, task: Task) -> Shown:
    """One fit, with its error and seconds."""
    try:
        view = view_of(app, theta, task)
    except KeyError as missing:
        if task.data:
            raise
        raise ValueError(
            f"{task.name}: its view is made of the fit and its input ({missing}), expected both; "
            "give what was fitted by --input or --data."
        ) from None
    error = "" if record["error"] is None else f"error{factor_of(app)} {number(record['error'], '.3f')}, "
    return Shown(label, f"{error}{number(record['seconds'], '.3g')} s", view)


@torch.no_grad()
def view_fit(fit: Fit, path: str | bytes | PathLike[str] = "") -> Path:
    """Write an interactive page of a fit, as `metapp view` does.

    Args:
        fit: of the Python API, where this is its method `view`.
        path: the HTML file; "" for one of the task's name in the current folder.

    Raises:
        OSError: the file cannot be written.
    """
    title, record = title_of(fit.app), {"error": fit.error, "seconds": fit.seconds}
    with threads(threads_of(fit.app)):
        shown = shown_of(fit.app, fit.settings["paradigm"], record, fit.parameters, fit.task)
    page = Path(os.fsdecode(path or f"{file_name(fit.name)}.html"))
    return write_page(f"metapp: {title}", [Group(fit.name, title, [shown])], page)


def try_app(app: str, out: Path, recipe: str = "") -> tuple[Path, Document]:
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
    source = write_example(app, out / INPUTS)[0]
    run = execute(
        Run.of(fit_options(app, inputs=[source], observe=EXAMPLES[app].observe, recipe=recipe, out=out, quiet=True))
    )
    assert run is not None  # of several ranks only
    (fit,) = run.records
    told = {key: fit[key] for key in ("name", "error", "seconds")}
    return run.folder, {"app": app, **told, "whole_seconds": time.perf_counter() - begin}
