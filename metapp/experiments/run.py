"""Run a paradigm on tasks: fit each, keep its record and parameters, write what it makes."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from metapp.appearance.presentation import Presentation
from metapp.apps import presentation_of
from metapp.experiments import BadOption
from metapp.experiments.checkpoints import find_checkpoint, train_checkpoint
from metapp.experiments.export import export_fit
from metapp.experiments.fits import fit_tasks
from metapp.experiments.inputs import AS_FILES_SAY, Reading, tasks_to_fit
from metapp.experiments.pictures import write_files
from metapp.experiments.reporter import number, progress, say
from metapp.experiments.session import (
    Checkpoint,
    Options,
    make_folder,
    name_of,
    observe_of,
    settings_of,
    threads,
    threads_of,
)
from metapp.learning.app import App
from metapp.learning.task import Task
from metapp.paradigms import Paradigm, paradigms
from metapp.storage.records import FIT, RunFolder, file_name, guarded, summary


class Run(NamedTuple):
    """Fits of tasks by one paradigm.

    Attributes:
        options: what was asked for.
        settings: everything that the figures depend on.
        label: the data's name.
        tasks: what was fitted.
        records: of each, in the same order.
        folder: where records and parameters are.
        made: the folder of what fits made for their user; None where nothing.
    """

    options: Options
    settings: dict[str, Any]
    label: str
    tasks: list[Task]
    records: list[dict[str, Any]]
    folder: RunFolder
    made: Path | None

    def document(self) -> dict[str, Any]:
        """What --json prints."""
        app = self.options.app
        return {
            "app": app.name,
            **observe_of(app),
            "paradigm": self.settings["paradigm"],
            "rule": self.settings["rule"],
            "steps": self.settings["steps"],
            "device": str(self.options.device),
            "data": self.label,
            **app.conditions(),
            **summary(self.records),
            "guarded": guarded(self.records),
            "tasks": [{key: record[key] for key in ("name", "error", "seconds")} for record in self.records],
            "out": str(self.folder.path),
        }


def run(
    options: Options,
    paradigm_name: str,
    inputs: list[Path],
    *,
    train: bool = False,
    train_steps: int | None = None,
    export: str = "",
    size: str = "",
    reading: Reading = AS_FILES_SAY,
) -> Run:
    """Fit tasks and write the run folder.

    Args:
        options: of all paradigms.
        paradigm_name: one of the five.
        inputs: the user's files; none: the test tasks of the data set.
        train: train the checkpoint on the training tasks first.
        train_steps: outer steps of that, instead of the recipe's.
        export: the format that each fit is also written in.
        size: of what fits make for their users, "HxW" in px; "" for the application's own choice.
        reading: what readers of files should know beside the paths.

    Raises:
        ValueError: bad inputs, no checkpoint, a folder that cannot be written to.
        FloatingPointError: a fit is not finite.
    """
    paradigm = paradigms()[paradigm_name]
    options = options.by(paradigm)
    sides = check_size(size, options.app)
    if paradigm.steps(options.job.recipe) in (options.steps, 0):
        options = options._replace(steps=None)  # the recipe's own number is the recipe's own run
    make_folder(options.out)
    with threads(threads_of(options.app)):
        tasks, label = tasks_to_fit(options.app, inputs, options.data, options.quiet, reading)
        if train:
            train_checkpoint(options, paradigm, train_steps)
        checkpoint = find_checkpoint(options, paradigm)
        return _fit(options, paradigm, checkpoint, tasks, label, export, sides)


def _fit(
    options: Options,
    paradigm: Paradigm,
    checkpoint: Checkpoint,
    tasks: list[Task],
    label: str,
    export: str,
    size: tuple[int, int] | None,
) -> Run:
    settings = settings_of(options, paradigm, checkpoint, label)
    folder = RunFolder(run_path(options, settings, label), settings, FIT)
    if not options.quiet:
        what = f"{name_of(options.app)} {paradigm.name}"
        say(f"{what}: {len(tasks)} tasks, {settings['steps']} steps, from {checkpoint.source}")
    # a finished run is run anew, one that was cut off is completed
    again = len(folder.finished()) >= len(tasks)
    records = run_tasks(options, paradigm, checkpoint, tasks, folder, again=again)
    made = _write(presentation_of(options.app, size), tasks, folder, export)
    return Run(options, settings, label, tasks, records, folder, made)


def _write(shown: Presentation[Any], tasks: list[Task], folder: RunFolder, export: str) -> Path | None:
    """Write what fits make for their user, <run>/outputs, and the form of --export, if any, <run>/<form>.

    Returns:
        The first folder; None where they make nothing.
    """
    made = None
    for task in tasks:
        theta = folder.theta(task.name)
        made = folder.path / "outputs" if write_files(shown, task, theta, folder.path / "outputs") else made
        if export:
            path = folder.path / export / file_name(task.name)
            export_fit(shown, task, theta, path, export, folder.settings)
    if export:
        say(f"{len(tasks)} fits written as {export}: {folder.path / export}")
    return made


def check_size(text: str, app: App) -> tuple[int, int] | None:
    """Height and width of "HxW", in px; None of "".

    Raises:
        BadOption: no such text, or nothing that the application makes can be of that size.
    """
    if not text:
        return None
    found = re.fullmatch(r"(\d{1,6})x(\d{1,6})", text)
    if not found:
        raise BadOption(f"--size '{text}': expected HEIGHTxWIDTH in px, such as 1024x1024.")
    height, width = map(int, found.groups())
    if refusal := presentation_of(app).refusal(height, width):
        raise BadOption(f"--size {text}: {name_of(app)} {refusal}.")
    return height, width


def run_path(options: Options, settings: dict[str, Any], label: str) -> Path:
    """runs/<app>/<paradigm>/<data>-<recipe>-seed<seed>, with rule, steps that are not the recipe's, and protocol."""
    name = f"{label}-{options.recipe}-seed{options.seed}"
    if settings["paradigm"] == "meta":
        name += f"-{settings['rule']}"
    if options.steps is not None:
        name += f"-{options.steps}steps"
    if options.app.protocol:
        name += f"-{options.app.protocol}"
    result: Path = options.out / options.app.name / settings["paradigm"] / name
    return result


def run_tasks(
    options: Options,
    paradigm: Paradigm,
    checkpoint: Checkpoint,
    tasks: list[Task],
    folder: RunFolder,
    *,
    again: bool = False,
) -> list[dict[str, Any]]:
    """Fit each task that has no record yet, or all again, with a progress bar; the records of all, in order."""
    done = {} if again else folder.finished()
    with progress(paradigm.name, len(tasks), done=len(done), quiet=options.quiet) as bar:
        missing = [task for task in tasks if task.name not in done]
        for record in fit_and_keep(options, paradigm, checkpoint, missing, folder):
            done[record["name"]] = record
            bar.advance(f"{record['name']} {number(record['error'], '.3f')}".removesuffix(" -"))
    return [done[task.name] for task in tasks]


def fit_and_keep(
    options: Options, paradigm: Paradigm, checkpoint: Checkpoint, tasks: list[Task], folder: RunFolder
) -> Iterator[dict[str, Any]]:
    """Fit tasks and keep the record and the parameters of each as soon as it is done.

    Yields:
        Their records.
    """
    for record, theta in fit_tasks(options, paradigm, checkpoint, tasks):
        folder.add(record, theta)
        yield record
