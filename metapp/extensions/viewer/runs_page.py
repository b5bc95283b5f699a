"""Interactive pages of runs: which fits stand side by side, and how they are labelled.

Fits of one task stand side by side, whichever runs they are of. This module reads records and inputs of runs; what a
page shows of a fit is the business of `view`.
"""

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
from metapp.runs.environment import make_folder, torch_defaults
from metapp.runs.fit import Fit
from metapp.runs.fitting import Failure, make_fitters
from metapp.runs.inputs.finding import find
from metapp.runs.keeping import fit_and_keep
from metapp.runs.reporter import format_number, progress, say
from metapp.runs.resolve import resolve
from metapp.runs.spec import given_words, parse_fit_options
from metapp.runs.stored_fits import RunFits, provide_tasks, read_run
from metapp.storage import Document
from metapp.storage.files import file_name, require_new_file

MAX_PAGE_TASKS = 20  # default number of tasks of a page
PAGE_FILE_NAME = "view.html"
INPUTS_FOLDER = "inputs"  # the folder of the inputs that `metapp try` makes


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
    """Write a page of runs, and return its path; fits of one task stand side by side.

    Args:
        folders: folders of runs, or of their tasks.
        out: the HTML file; None for `view.html` in the first run's folder.
        inputs: the fitted files, if they do not lie where records say.
        data: the fitted data set, if it does not lie where records say.
        task: the name of the task to show; "" for all tasks.
        most: number of tasks at most.
        quiet: whether to show no progress.

    Raises:
        ValueError: there is no run, or no fit of that task; records or parameters are damaged; no fit can be shown.
    """
    runs = [read_run(path, task) for path in folders]
    labels, page = _label_runs(runs), out or runs[0].folder / PAGE_FILE_NAME
    names = dict.fromkeys((fit.spec.app, fit.name) for _, fits in runs for fit in fits)
    shown_names = list(names)[:most]
    if len(names) > most:
        say(f"view: {most} of {len(names)} tasks; --most {len(names)} shows all.")
    fits_by_task: dict[tuple[str, str], list[tuple[str, Fit]]] = {}
    with progress("view: reading", len(runs), quiet=quiet) as bar:
        for folder, run_fits in runs:
            shown = [fit for fit in run_fits if (fit.spec.app, fit.name) in shown_names]
            if missing := provide_tasks(shown, inputs, data):
                found = f"the inputs of {missing} of {len(shown)} fits are not at hand"
                say(f"view: {found}; give them by --input or --data to see references.")
            for fit in shown:
                fits_by_task.setdefault((fit.spec.app, fit.name), []).append((labels[folder], fit))
            bar.advance()
    make_folder(page.parent)  # before views are made, which takes time
    groups, omissions = [], list[str]()
    with progress("view", len(fits_by_task), quiet=quiet) as bar:
        for fits in fits_by_task.values():
            views = []
            for label, fit in fits:
                try:
                    views.append(make_labelled_view(fit, label))
                except ValueError as error:
                    omissions.append(f"{label} of {error}")
            _, first_fit = fits[0]
            groups += [FitGroup(first_fit.name, first_fit.presenter.title, views)] if views else []
            bar.advance(first_fit.name)
    if not groups:
        raise ValueError(omissions[0])
    for line in omissions:
        say(f"warning: left out: {line}")
    titles = dict.fromkeys(fits[0][1].presenter.title for fits in fits_by_task.values())
    return write_page(f"metapp: {', '.join(titles)}", groups, page)


def _label_runs(runs: Sequence[RunFits]) -> dict[Path, str]:
    """Return labels by folder that tell runs of one application apart: the paradigm, and settings that differ."""
    specs = {run.folder: run.fits[-1].spec for run in runs}
    labels = {folder: spec.paradigm for folder, spec in specs.items()}
    for app in {spec.app for spec in specs.values()}:
        folders = [folder for folder, spec in specs.items() if spec.app == app]
        for key in ("rule", "recipe", "steps", "seed"):
            if len({labels[folder] for folder in folders}) == len(folders):
                break
            word = f" {key}" if key in ("steps", "seed") else ""
            if len({str(getattr(specs[folder], key)) for folder in folders}) > 1:
                labels |= {folder: f"{labels[folder]}{word} {getattr(specs[folder], key)}" for folder in folders}
    return labels


@torch.no_grad()
def make_labelled_view(fit: Fit, label: str) -> View:
    """Make the view of a fit, with a label, and with its error and seconds as the caption.

    Raises:
        ValueError: the view needs the input of the fit, which is not at hand.
    """
    try:
        with torch_defaults(single=fit.app.small_tensors):
            view = make_view(fit)
    except KeyError as missing:
        if fit.task.data:
            raise
        raise ValueError(
            f"{fit.name}: its view needs the input of the fit as well ({missing}), expected both; "
            "give the input by --input or --data."
        ) from None
    error = "" if fit.error is None else f"error{fit.app.error_measure.factor} {format_number(fit.error, '.3f')}, "
    return view._replace(label=label, caption=f"{error}{format_number(fit.seconds, '.3g')} s")


def write_fit_page(fit: Fit, path: str | bytes | PathLike[str] = "", *, overwrite: bool = False) -> Path:
    """Write an interactive page of a fit, as `metapp view` does.

    Args:
        fit: a fit of the Python API, whose method `view` this is.
        path: the HTML file; "" for a file with the task's name in the current folder, which is replaced.
        overwrite: whether an existing file at `path` is replaced.

    Returns:
        The HTML file.

    Raises:
        FileExistsError: the file at `path` is there already.
        OSError: the file cannot be written.
    """
    if path:
        require_new_file(Path(os.fsdecode(path)), overwrite=overwrite)
    title, views = fit.presenter.title, [make_labelled_view(fit, fit.spec.paradigm)]
    page = Path(os.fsdecode(path or f"{file_name(fit.name)}.html"))
    return write_page(f"metapp: {title}", [FitGroup(fit.name, title, views)], page)


def fit_synthetic_input(app: str, out: Path, recipe: str = "") -> tuple[Path, Document]:
    """Write a synthetic input of an application into a folder and fit it by Meta.

    Args:
        app: the name of the application.
        out: the folder of inputs and runs.
        recipe: the recipe of the fit; "" for the application's own.

    Returns:
        The folder of the fit, and its record for the user: application, name, error, seconds of inference, and seconds
        that writing and fitting took together.

    Raises:
        ValueError: the folder cannot be written to; there is no such recipe, or no checkpoint.
    """
    begin = time.perf_counter()
    example_file = write_example(app, out / INPUTS_FOLDER)[0]
    spec, options = parse_fit_options(app, recipe=recipe or None, out=out, quiet=True)
    inputs = find(spec, [example_file])
    specs, _ = resolve(spec, inputs)
    make_folder(out)
    (fit,) = fit_and_keep(make_fitters(specs), inputs, out / app / given_words(spec), options)
    if isinstance(fit, Failure):
        raise fit.error
    figures = {"name": fit.name, "error": fit.error, "seconds": fit.seconds}
    return fit.folder, {"app": app, **figures, "whole_seconds": time.perf_counter() - begin}
