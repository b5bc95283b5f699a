"""Run a paradigm on tasks: fit each, keep its record and parameters, write what it makes."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Generator

from metapp.experiments.export import export_all
from metapp.experiments.inputs import tasks_to_fit
from metapp.experiments.pictures import write_files
from metapp.experiments.reporter import number, progress, say
from metapp.experiments.session import Options, Start, make_folder, name_of, observe_of, settings_of
from metapp.experiments.starts import find_start, train_start
from metapp.learning.app import stack
from metapp.learning.task import Params, Task, Tasks
from metapp.paradigms import Job, Paradigm, paradigms
from metapp.storage.records import FIT, RunFolder, summary


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
    scene_roots: Sequence[Path] = (),
) -> Run:
    """Fit tasks and write the run folder.

    Args:
        options: of all paradigms.
        paradigm_name: one of the five.
        inputs: the user's files; none: the test tasks of the data set.
        train: train the checkpoint on the training tasks first.
        train_steps: outer steps of that, instead of the recipe's.
        export: the format that each fit is also written in.
        scene_roots: folders that files of scenes may come from.

    Raises:
        ValueError: bad inputs, no checkpoint, a folder that cannot be written to.
        FloatingPointError: a fit is not finite.
    """
    paradigm = paradigms()[paradigm_name]
    if options.steps == paradigm.steps(options.job.recipe):
        options = options._replace(steps=None)  # the recipe's own number is the recipe's own run
    make_folder(options.out)
    tasks, label = tasks_to_fit(options.app, inputs, options.data, options.quiet, scene_roots)
    if train:
        train_start(options, paradigm, train_steps)
    start = find_start(options, paradigm)
    settings = settings_of(options, paradigm, start, label)
    folder = RunFolder(run_path(options, settings, label), settings, FIT)
    if not options.quiet:
        what = f"{name_of(options.app)} {paradigm.name}"
        say(f"{what}: {len(tasks)} tasks, {settings['steps']} steps, start: {start.source}")
    # a finished run is run anew, one that was cut off is completed
    again = len(folder.finished()) >= len(tasks)
    records = run_tasks(options, paradigm, start, tasks, folder, again=again)
    made = write_files(options.app, tasks, folder.path)
    if export:
        export_all(options.app, tasks, folder, export)
    return Run(options, settings, label, tasks, records, folder, made)


def run_path(options: Options, settings: dict[str, Any], label: str) -> Path:
    """runs/<app>/<paradigm>/<data>-<recipe>-seed<seed>, with rule, steps that are not the recipe's, and protocol."""
    name = f"{label}-{options.recipe}-seed{options.seed}"
    if settings["paradigm"] == "meta":
        name += f"-{settings['rule']}"
    if options.steps is not None:
        name += f"-{options.steps}steps"
    if options.app.protocol:
        name += f"-{options.app.protocol}"
    return options.out / options.app.name / settings["paradigm"] / name


def run_tasks(
    options: Options, paradigm: Paradigm, start: Start, tasks: list[Task], folder: RunFolder, *, again: bool = False
) -> list[dict[str, Any]]:
    """Fit each task that has no record yet, or all again, with a progress bar; the records of all, in order."""
    done = {} if again else folder.finished()
    with progress(paradigm.name, len(tasks), done=len(done), quiet=options.quiet) as bar:
        missing = [task for task in tasks if task.name not in done]
        for record in fit_tasks(options, paradigm, start, missing, folder):
            done[record["name"]] = record
            bar.advance(f"{record['name']} {number(record['error'], '.3f')}".removesuffix(" -"))
    return [done[task.name] for task in tasks]


def fit_tasks(
    options: Options, paradigm: Paradigm, start: Start, tasks: list[Task], folder: RunFolder
) -> Iterator[dict[str, Any]]:
    """Fit tasks, each alone, so that its time is its own, and keep each as soon as it is done.

    The time is from the task's samples to the final parameters, warm. The error is None where a task holds no
    reference.

    Yields:
        Their records.
    """
    app, job, device = options.app, options.job, options.device

    def fit_one(task: Any, steps: int | None) -> tuple[dict, float, Any]:
        rng = rng_of(options, task)
        _synchronise(device)
        begin = time.perf_counter()
        stacked = stack(app, [task], device)
        theta = paradigm.fit(job if steps is None else job._replace(steps=steps), start.prepared, stacked, rng)
        _synchronise(device)
        return theta, time.perf_counter() - begin, stacked

    for task in tasks if app.protocols else ():
        app.prepare(task)  # that one does not hold what a fit may see should not be found after an hour
    for task in tasks[:1]:
        fit_one(task, min(paradigm.count(job), 3))  # warm: first calls load kernels
    threads = torch.get_num_threads()
    for task in tasks:
        theta, seconds, stacked = fit_one(task, None)
        errors = {key: float(value[0]) for key, value in app.errors(theta, stacked).items()}
        errors |= {key: app.scale * value for key, value in errors.items() if key == "error"}
        finite = all(bool(torch.isfinite(value).all()) for value in theta.values())
        if not finite or (errors and not math.isfinite(errors["error"])):
            what = "error is" if finite else "parameters are"
            raise FloatingPointError(f"{task.name}: the fit's {what} not finite; use another start or fewer steps.")
        # sums depend on the number of threads, in their last digits: the record says it, but its key does not, since
        # that is no reason to fit anew
        record = {"name": task.name, "error": None, **errors, "seconds": seconds, "threads": threads}
        record |= warning_of(paradigm, job, start, stacked, theta, rng_of(options, task))
        folder.add(record, {key: value[0] for key, value in theta.items()})
        yield record


def warning_of(
    paradigm: Paradigm, job: Job, start: Start, stacked: Tasks, theta: Params, rng: Generator
) -> dict[str, str]:
    """What a record says of a fit that leaves what it sees worse than its start: a learned rule can fail on a task.

    Args:
        paradigm, job, start: what the fit was made by.
        stacked: the one task.
        theta: the fit, [1, ...].
        rng: as it was at the beginning of the fit, so that the start is the same.
    """
    if paradigm.count(job) == 0:
        return {}
    first = paradigm.start(job, start.prepared, stacked, rng)
    with torch.no_grad():
        batch = job.app.sample(stacked, torch.Generator(rng.device).manual_seed(0), job.recipe.batch)
        before, after = (float(job.app.loss(each, batch, {})[0]) for each in (first, theta))
    if after <= before:
        return {}
    warning = f"the visible loss rose from {before:.4g} to {after:.4g}"
    say(f"warning: {stacked.names[0]}: {warning}; try another rule, more steps or another paradigm.")
    return {"warning": warning}


def rng_of(options: Options, task: Task) -> Generator:
    """The source of a fit's draws: it depends on the task's name alone, whatever is fitted beside it."""
    seed = int.from_bytes(
        hashlib.sha256(f"{options.seed} {task.name}".encode(errors="surrogatepass")).digest()[:6], "big"
    )
    return Generator(options.device).manual_seed(seed)


def _synchronise(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize(device)
