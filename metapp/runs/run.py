"""Run a paradigm on tasks: fit each, keep its record and parameters, write what it makes."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from metapp.appearance.presentation import Presentation
from metapp.apps import presentation_of
from metapp.learning.app import App
from metapp.learning.task import Task
from metapp.paradigms import Paradigm, paradigms, ranks
from metapp.runs import BadOption
from metapp.runs.checkpoints import find_checkpoint, train_checkpoint
from metapp.runs.export import export_fit
from metapp.runs.fits import Fitter
from metapp.runs.inputs import AS_FILES_SAY, Reading, tasks_to_fit
from metapp.runs.origin import origin_of
from metapp.runs.pictures import write_files
from metapp.runs.reporter import Reporter, number, progress, reporting, say
from metapp.runs.session import (
    Checkpoint,
    Options,
    make_folder,
    name_of,
    observe_of,
    settings_of,
    threads,
    threads_of,
)
from metapp.runs.timing import said_time
from metapp.runs.watching import Watched
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
        app, told = self.options.app, ("name", "error", "seconds", "steps")
        return {
            "app": app.name,
            **observe_of(app),
            "paradigm": self.settings["paradigm"],
            "rule": self.settings["rule"],
            "steps": self.settings["steps"],
            **({"budget": self.options.budget} if self.options.budget is not None else {}),
            "device": str(self.options.device),
            "data": self.label,
            **app.conditions(),
            **{key: self.settings[key] for key in ("precision",) if key in self.settings},
            **summary(self.records),
            "guarded": guarded(self.records),
            "tasks": [{key: record[key] for key in told if key in record} for record in self.records],
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
    options, paradigm, sides = placed(options, paradigm_name, size)
    with threads(threads_of(options.app)):
        tasks, label = tasks_to_fit(options.app, inputs, options.data, options.quiet, reading)
        fitter = Fitter(options, paradigm, checkpoint_of(options, paradigm, train, train_steps))
        return _fit(fitter, tasks, label, export, sides, origin_of(options, inputs, reading))


def run_each(
    options: Options,
    paradigm_name: str,
    inputs: Iterable[Path],
    *,
    train: bool = False,
    train_steps: int | None = None,
    export: str = "",
    size: str = "",
    reading: Reading = AS_FILES_SAY,
) -> Iterator[tuple[Path, Run | Exception]]:
    """Run a paradigm on each of many inputs as they come, the checkpoint and the kernels loaded once; see `run`.

    Yields:
        Each input with its run, or with why there is none.
    """
    options, paradigm, sides = placed(options, paradigm_name, size)
    with threads(threads_of(options.app)):
        fitter = Fitter(options, paradigm, checkpoint_of(options, paradigm, train, train_steps))
        for path in inputs:
            done: Run | Exception
            try:
                tasks, label = tasks_to_fit(options.app, [path], None, options.quiet, reading)
                done = _fit(fitter, tasks, label, export, sides, origin_of(options, [path], reading))
            except Exception as error:  # whatever it is, the next input is not to blame
                done = error
            yield path, done


def checkpoint_of(options: Options, paradigm: Paradigm, train: bool, train_steps: int | None) -> Checkpoint:
    """The best checkpoint, trained first if that is asked for, together with the other ranks where there are any."""
    if train:
        with ranks.joined(options.device):
            train_checkpoint(options, paradigm, train_steps)
    return find_checkpoint(options, paradigm)


def placed(options: Options, name: str, size: str) -> tuple[Options, Paradigm, tuple[int, int] | None]:
    """The options of a run by a paradigm, and the size of what its fits make; its folder can be written to.

    Raises:
        BadOption: no such size.
        ValueError: a folder that cannot be written to.
    """
    paradigm = paradigms()[name]
    options = options.by(paradigm)
    sides = check_size(size, options.app)
    if paradigm.steps(options.job.recipe) in (options.steps, 0):
        options = options._replace(steps=None)  # the recipe's own number is the recipe's own run
    make_folder(options.out)
    return options, paradigm, sides


def follow(options: Options, paradigm_name: str, train_steps: int | None) -> None:
    """Train along with rank 0 of `torchrun`, which alone writes and goes on to fit."""
    paradigm = paradigms()[paradigm_name]
    options = options.by(paradigm)._replace(quiet=True)
    with threads(threads_of(options.app)), reporting(Reporter()), ranks.joined(options.device):
        train_checkpoint(options, paradigm, train_steps)


def _fit(
    fitter: Fitter, tasks: list[Task], label: str, export: str, size: tuple[int, int] | None, origin: dict[str, Any]
) -> Run:
    options, paradigm, checkpoint = fitter.options, fitter.paradigm, fitter.checkpoint
    settings = settings_of(options, paradigm, checkpoint, label)
    folder = RunFolder(run_path(options, settings, label), settings, FIT, origin)
    if not options.quiet:
        what = f"{name_of(options.app)} {paradigm.name}"
        say(f"{what}: {len(tasks)} tasks, {settings['steps']} steps, from {checkpoint.source}")
        if options.watch:
            say(f"watch: {folder.path / 'watch.png'}; the time that it takes to draw is not part of the seconds")
    # a finished run is run anew, one that was cut off is completed
    again = len(folder.finished()) >= len(tasks)
    records = run_tasks(fitter, tasks, folder, again=again)
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
    if options.budget is not None:
        name += f"-{said_time(options.budget)}"
    if options.app.protocol:
        name += f"-{options.app.protocol}"
    result: Path = options.out / options.app.name / settings["paradigm"] / name
    return result


def run_tasks(fitter: Fitter, tasks: list[Task], folder: RunFolder, *, again: bool = False) -> list[dict[str, Any]]:
    """Fit each task that has no record yet, or all again, with a progress bar; the records of all, in order."""
    done = {} if again else folder.finished()
    name = fitter.paradigm.name
    with progress(name, len(tasks), done=len(done), quiet=fitter.options.quiet) as bar:
        missing = [task for task in tasks if task.name not in done]
        for record in _kept(fitter, missing, folder):
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
    return _kept(Fitter(options, paradigm, checkpoint), tasks, folder)


def _kept(fitter: Fitter, tasks: list[Task], folder: RunFolder) -> Iterator[dict[str, Any]]:
    options = fitter.options
    fitter.watched = Watched(options.app, fitter.paradigm.name, folder.path / "watch.png") if options.watch else None
    for record, theta in fitter.each(tasks):
        folder.add(record, theta)
        yield record
