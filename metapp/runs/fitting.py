"""Fitting: tasks one by one, or some side by side, with their errors and times; sources as they are read."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import NamedTuple

import torch
from torch import Generator

from metapp.appearance.pictures import photo_error_percent
from metapp.learning.app import stack_tasks
from metapp.learning.learn import DescentState, final_item
from metapp.learning.random_tensors import Rng, draw_per_task
from metapp.learning.task import Params, Task, Tasks
from metapp.runs.fit import Fit
from metapp.runs.inputs.run_inputs import Input, task_digest
from metapp.runs.reporter import Bar, say
from metapp.runs.run import Run
from metapp.storage import Document
from metapp.storage.files import error_about_file
from metapp.storage.fit_folders import RunFolder

READ_TIME_SHARE, FITTED_TIME_SHARE = 0.2, 0.5  # shares of an input's time until it is read, and fitted, about
WARM_UP_STEPS = 1  # steps of the fit that loads kernels: the next one takes at most 2 % longer than after more of them
MAX_NOTED_INPUTS = 3  # inputs of which it is said that they were cut or scaled
LOSS_ROSE_CLAUSE = "the visible loss rose"  # a clause of warnings, which tables count apart from the others
FIT_ERRORS = (ValueError, OSError, FloatingPointError, MemoryError, RuntimeError)  # of inputs and fits


class BadInput(ValueError):
    """An input that cannot be read, with its place."""


class EarlierFit(NamedTuple):
    """An earlier fit of a task, which --resume takes for the fit of now.

    Attributes:
        run: of now.
        task: as it was read now.
        record: of the fit.
    """

    run: Run
    task: Task
    record: Document


def fit_sources(
    run: Run, sources: Sequence[Input], folder: RunFolder | None = None, bar: Bar | None = None
) -> Iterator[tuple[Input, Fit | EarlierFit | Exception]]:
    """Fit sources, each read when its turn comes, `--batch` of them side by side; their warnings are said.

    Args:
        run: with a checkpoint.
        sources: to fit.
        folder: of the run; None if fits are not kept.
        bar: is told the name of each task that was read.

    Yields:
        Each source with its fit, or with the error by which it has none; with --resume an earlier fit if there is one.
    """
    is_warm = False
    waiting: list[tuple[Input, Task]] = []

    def fits() -> Iterator[tuple[Input, Fit | Exception]]:
        nonlocal is_warm
        for group in group_by_tensor_sizes(waiting):
            if not is_warm:
                warm_up(run, group[0][1])
                is_warm = True
            for source, fit in _fit_group(run, group):
                if isinstance(fit, Fit):
                    _say_warnings(fit)
                yield source, fit

    for source, read in _readable(run, sources, folder, bar or Bar()):
        if isinstance(read, Task):
            waiting.append((source, read))
        else:
            yield source, read
        if len(waiting) == (run.options.batch or 1):
            yield from fits()
            waiting.clear()
    yield from fits()


def _readable(
    run: Run, sources: Iterable[Input], folder: RunFolder | None, bar: Bar
) -> Iterator[tuple[Input, Task | EarlierFit | Exception]]:
    noted = 0
    for source in sources:
        try:
            task = source.task()
            record = folder.earlier(task.name, source.place) if folder and run.options.resume else None
            if folder and record and folder.holds(record, task_digest(task)):
                yield source, EarlierFit(run, task, record)
            else:
                bar.name(f"{task.name}: fitting", READ_TIME_SHARE)
                check_task(run, task)
                noted += bool(task.note)
                if task.note and noted <= MAX_NOTED_INPUTS:
                    say(f"{Path(source.place).name}: {task.note}")
                elif task.note and noted == MAX_NOTED_INPUTS + 1:
                    say("further inputs are cut and scaled likewise")
                yield source, task
        except (ValueError, OSError) as error:
            yield source, BadInput(str(error_about_file(error, Path(source.place))))


def _fit_group(run: Run, pairs: Sequence[tuple[Input, Task]]) -> Iterator[tuple[Input, Fit | Exception]]:
    """Fits side by side; if that fails, one by one."""
    failure: Exception | None = None
    try:
        fits = fit_side_by_side(run, [task for _, task in pairs])
    except FIT_ERRORS as error:
        failure = error.with_traceback(None)  # whose frames hold the tensors of the batch
    if failure is None:
        yield from zip([source for source, _ in pairs], fits, strict=True)
    elif len(pairs) == 1:
        yield pairs[0][0], failure
    else:
        for pair in pairs:
            yield from _fit_group(run, [pair])


def _say_warnings(fit: Fit) -> None:
    if "note" in fit.record:
        say(f"{fit.name}: {fit.record['note']}")
    for clause in filter(None, fit.warning.split("; ")):
        remedy = "; try another rule, more steps or another paradigm." if clause.startswith(LOSS_ROSE_CLAUSE) else ""
        say(f"warning: {fit.name}: {clause}{remedy}")


def group_by_tensor_sizes(pairs: Iterable[tuple[Input, Task]]) -> list[list[tuple[Input, Task]]]:
    """Groups of tasks whose tensors are of equal sizes, which can be fitted side by side."""
    groups: dict[tuple[tuple[str, torch.Size], ...], list[tuple[Input, Task]]] = {}
    for source, task in pairs:
        sizes = tuple((key, task.data[key].shape) for key in sorted(task.data))
        groups.setdefault(sizes, []).append((source, task))
    return list(groups.values())


def fit_tasks(run: Run, tasks: Sequence[Task]) -> Iterator[Fit]:
    """Fits of tasks, each alone, so that its time is its own; warnings are recorded, not said.

    Args:
        run: with a checkpoint.
        tasks: to fit.

    Yields:
        Each fit as it comes.

    Raises:
        FloatingPointError: a fit is not finite.
        ValueError: a task lacks a tensor, before the first fit.
    """
    for task in tasks:
        check_task(run, task)
    for number, task in enumerate(tasks):
        if number == 0:
            warm_up(run, task)
        yield from fit_side_by_side(run, [task])


def check_task(run: Run, task: Task) -> None:
    """Refuse a task without the tensors that a fit reads: that should not be found after hours.

    Raises:
        ValueError: one is missing.
    """
    if run.app.protocol:
        run.app.prepare(task)


def warm_up(run: Run, task: Task) -> None:
    """Take a step before the first fit, as first calls load kernels."""
    few = min(run.paradigm.steps, WARM_UP_STEPS)
    # what a guard looks at takes longer than a step
    stacked, paradigm = stack_tasks(run.app, [task], run.device), replace(run.paradigm, steps=few)
    paradigm.fit(run.phi, stacked, rng_of(run, task), guarded=False)


def fit_side_by_side(run: Run, tasks: Sequence[Task]) -> list[Fit]:
    """Fits of tasks of equal sizes, each as if it were alone; its seconds are its share of those that all took.

    The time is from the tasks' samples to the final parameters, warm. The error is None if a task holds no reference.

    Args:
        run: with a checkpoint.
        tasks: one or more.

    Raises:
        FloatingPointError: a fit is not finite.
        ValueError: tasks differ in their sizes.
    """
    app = run.app
    rng: Rng = tuple(rng_of(run, task) for task in tasks) if len(tasks) > 1 else rng_of(run, tasks[0])
    begin = _now(run.device)
    stacked = stack_tasks(app, tasks, run.device)
    descent = run.paradigm.descend(run.phi, stacked, rng)
    first = next(descent)
    end = final_item(chain([first], descent))
    theta = app.postprocess(end.theta)
    seconds = (_now(run.device) - begin) / len(tasks)
    measures, warnings = app.errors(theta, stacked), warnings_of(run, stacked, first, end)
    fits = []
    for i, (task, clauses) in enumerate(zip(tasks, warnings, strict=True)):
        errors = {
            key: float(value[i]) * (app.error_measure.scale if key == "error" else 1) for key, value in measures.items()
        }
        parameters = {key: value[i].detach().cpu() for key, value in theta.items()}
        _require_finite(task, parameters, errors)
        # sums depend on the number of threads, in their last digits: the record says it, but not its settings, since
        # that is no reason to fit anew
        record: Document = {"name": task.name, "error": None, **errors, "seconds": seconds}
        record |= {"threads": torch.get_num_threads(), **run.presenter.remarks(parameters, task)}
        record |= {"guarded": end.guarded is not None and bool(end.guarded[i])} if run.paradigm.guard else {}
        record |= {"warning": "; ".join(clauses)} if clauses else {}
        record |= {"batch": len(tasks)} if len(tasks) > 1 else {}
        if record["error"] is None and (compared := run.presenter.photo_comparison(parameters, task)):
            record |= {"photo_error": photo_error_percent(compared)}
        fits.append(Fit(run, task, record, parameters))
    return fits


def _now(device: torch.device) -> float:
    """Seconds on a clock, once the device is idle."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    return time.perf_counter()


def _require_finite(task: Task, theta: Params, errors: Mapping[str, float]) -> None:
    """Refuse a fit of a task, parameters without a task axis, that holds NaN or infinite values, or has such an error.

    Raises:
        FloatingPointError: it does.
    """
    finite = all(bool(torch.isfinite(value).all()) for value in theta.values())
    if not finite or not math.isfinite(errors.get("error", 0.0)):
        what = "error is" if finite else "parameters are"
        raise FloatingPointError(
            f"{task.name}: the fit's {what} not finite; use another checkpoint or paradigm, or fewer steps."
        )


def warnings_of(run: Run, stacked: Tasks, first: DescentState, end: DescentState) -> list[list[str]]:
    """Clauses about each fit that is doubtful, as some applications see themselves, or whose visible loss rose.

    Learned rules can fail; a guard has compared its fits with their beginning.

    Args:
        run: of the fits.
        stacked: the tasks.
        first, end: of their descent.
    """
    doubts = run.presenter.quality_warnings(end.theta, stacked)
    if end.guarded is not None or not run.paradigm.steps:
        return doubts
    again = tuple(Generator(stacked.rows.device).manual_seed(0) for _ in stacked.names)
    with torch.no_grad():
        batch = draw_per_task(lambda some, own: run.app.sample(some, own, run.recipe.batch), stacked, again)
        before, after = (run.app.loss(state.theta, batch, {}).tolist() for state in (first, end))
    return [
        [*([] if high <= low else [f"{LOSS_ROSE_CLAUSE} from {low:.4g} to {high:.4g}"]), *doubt]
        for low, high, doubt in zip(before, after, doubts, strict=True)
    ]


def rng_of(run: Run, task: Task) -> Generator:
    """The source of a fit's draws: it depends on the task's name alone, whatever is fitted beside it."""
    text = f"{run.options.seed} {task.name}"
    seed = int.from_bytes(hashlib.sha256(text.encode(errors="surrogatepass")).digest()[:6], "big")
    return Generator(run.device).manual_seed(seed)
