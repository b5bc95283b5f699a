"""The fitting of tasks, one by one or side by side, with errors, times and warnings.

Inputs are read when their turn comes, so that a large set need not fit into memory. Nothing is written here: what is
kept of a fit is decided in `metapp.runs.execution`.
"""

from __future__ import annotations

import contextlib
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
from metapp.storage.fit_folders import CPU_SECONDS, RunFolder

READ_TIME_SHARE, FITTED_TIME_SHARE = 0.2, 0.5  # about the shares of an input's time when it is read, and when fitted
# Gradient steps of the fit that loads kernels: a fit after it takes at most 2 % longer than after more steps
WARM_UP_STEPS = 1
MAX_NOTED_INPUTS = 3  # number of inputs for which a line says that they were cut or scaled
LOSS_ROSE_CLAUSE = "the visible loss rose"  # the beginning of a clause of warnings, which tables count by itself
FIT_ERRORS = (ValueError, OSError, FloatingPointError, MemoryError, RuntimeError)  # errors by which a fit may fail


class BadInput(ValueError):
    """An input that cannot be read; the message names its place."""


class EarlierFit(NamedTuple):
    """An earlier fit of a task that --resume keeps instead of a new one.

    Attributes:
        run: the present run.
        task: the task as it was read by the present run.
        record: the record of the earlier fit.
    """

    run: Run
    task: Task
    record: Document


def fit_inputs(
    run: Run, inputs: Sequence[Input], folder: RunFolder | None = None, bar: Bar | None = None
) -> Iterator[tuple[Input, Fit | EarlierFit | Exception]]:
    """Read and fit inputs, `--batch` of them side by side, and say the warnings of each fit.

    Args:
        run: a run with its checkpoint.
        inputs: the inputs to fit; each is read when its turn comes.
        folder: the folder of the run; None if fits are not kept.
        bar: the progress, which shows the name of each task that was read.

    Yields:
        Each input with its fit, or with the error by which it has none. With --resume it may be an earlier fit.
    """
    is_warm = False
    pending: list[tuple[Input, Task]] = []

    def fit_pending() -> Iterator[tuple[Input, Fit | Exception]]:
        nonlocal is_warm
        for group in group_by_tensor_sizes(pending):
            if not is_warm:
                with contextlib.suppress(*FIT_ERRORS):  # the fit itself fails of the same, and says so of its input
                    warm_up(run, group[0][1])
                is_warm = True
            for run_input, fit in _fit_group(run, group):
                if isinstance(fit, Fit):
                    _say_warnings(fit)
                yield run_input, fit

    for run_input, result in _read_tasks(run, inputs, folder, bar or Bar()):
        if isinstance(result, Task):
            pending.append((run_input, result))
        else:
            yield run_input, result
        if len(pending) == (run.options.batch or 1):
            yield from fit_pending()
            pending.clear()
    yield from fit_pending()


def _read_tasks(
    run: Run, inputs: Iterable[Input], folder: RunFolder | None, bar: Bar
) -> Iterator[tuple[Input, Task | EarlierFit | Exception]]:
    """Read inputs one after the other, and say what was cut or scaled.

    Yields:
        Each input with its task, with an earlier fit that --resume keeps, or with the error of a bad input.
    """
    note_count = 0
    for run_input in inputs:
        try:
            task = run_input.read_task()
            record = folder.earlier_record(task.name, run_input.place) if folder and run.options.resume else None
            if folder and record and folder.matches(record, task_digest(task)):
                yield run_input, EarlierFit(run, task, record)
            else:
                bar.set_label(f"{task.name}: fitting", READ_TIME_SHARE)
                require_tensors(run, task)
                note_count += bool(task.note)
                if task.note and note_count <= MAX_NOTED_INPUTS:
                    say(f"{Path(run_input.place).name}: {task.note}")
                elif task.note and note_count == MAX_NOTED_INPUTS + 1:
                    say("further inputs are cut and scaled likewise")
                yield run_input, task
        except (ValueError, OSError) as error:
            yield run_input, BadInput(str(error_about_file(error, Path(run_input.place))))


def _fit_group(run: Run, pairs: Sequence[tuple[Input, Task]]) -> Iterator[tuple[Input, Fit | Exception]]:
    """Fit tasks side by side, or one by one if a fit side by side fails.

    Yields:
        Each input with its fit, or with the error of its fit.
    """
    failure: Exception | None = None
    try:
        fits = fit_side_by_side(run, [task for _, task in pairs])
    except FIT_ERRORS as error:
        failure = error.with_traceback(None)  # the frames of a traceback would hold the tensors of all tasks
    if failure is None:
        yield from zip([run_input for run_input, _ in pairs], fits, strict=True)
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
    """Group tasks whose tensors have equal sizes, so that they can be fitted side by side."""
    groups: dict[tuple[tuple[str, torch.Size], ...], list[tuple[Input, Task]]] = {}
    for run_input, task in pairs:
        sizes = tuple((key, task.data[key].shape) for key in sorted(task.data))
        groups.setdefault(sizes, []).append((run_input, task))
    return list(groups.values())


def fit_tasks(run: Run, tasks: Sequence[Task]) -> Iterator[Fit]:
    """Fit tasks one after the other, so that each has its own time; warnings are recorded, not said.

    Args:
        run: a run with its checkpoint.
        tasks: the tasks to fit.

    Yields:
        The fit of each task, in order.

    Raises:
        FloatingPointError: a fit is not finite.
        ValueError: a task lacks a tensor; this is found before the first fit.
    """
    for task in tasks:
        require_tensors(run, task)
    for number, task in enumerate(tasks):
        if number == 0:
            warm_up(run, task)
        yield from fit_side_by_side(run, [task])


def require_tensors(run: Run, task: Task) -> None:
    """Require the tensors of a task that a fit reads, rather than fail after hours of other fits.

    Raises:
        ValueError: a tensor is missing.
    """
    if run.app.observes:
        run.app.prepare(task)


def warm_up(run: Run, task: Task) -> None:
    """Take a gradient step before the first fit: first calls load kernels, which would count as time of the fit.

    The task is prepared by :meth:`App.warm_up_app`, which may take less time than a fit that is kept.
    """
    step_count = min(run.paradigm.steps, WARM_UP_STEPS)
    stacked = stack_tasks(run.app.warm_up_app(), [task], run.device)
    paradigm = replace(run.paradigm, steps=step_count)
    # without a guard, whose losses take longer than a step
    paradigm.fit(run.phi, stacked, rng_of(run, task), guarded=False)


def fit_side_by_side(run: Run, tasks: Sequence[Task]) -> list[Fit]:
    """Fit tasks of equal sizes side by side, each as if it were fitted alone.

    The seconds of a fit are its share of the time that all fits took, from the tasks' samples to the final parameters,
    without the first loading of kernels. The error of a fit is None if its task holds no reference.

    Args:
        run: a run with its checkpoint.
        tasks: one or more tasks whose tensors have equal sizes.

    Raises:
        FloatingPointError: a fit is not finite.
        ValueError: tasks differ in their sizes.
    """
    app = run.app
    rng: Rng = tuple(rng_of(run, task) for task in tasks) if len(tasks) > 1 else rng_of(run, tasks[0])
    begin_seconds, begin_cpu_seconds = _clock_seconds(run.device), time.process_time()
    stacked = stack_tasks(app, tasks, run.device)
    descent = run.paradigm.descend(run.phi, stacked, rng)
    first = next(descent)
    last = final_item(chain([first], descent))
    theta = app.postprocess(last.theta)
    seconds = (_clock_seconds(run.device) - begin_seconds) / len(tasks)
    cpu_seconds = (time.process_time() - begin_cpu_seconds) / len(tasks)
    measures, warnings = app.errors(theta, stacked), _warnings_or_fault(run, stacked, first, last)
    fits = []
    for i, (task, clauses) in enumerate(zip(tasks, warnings, strict=True)):
        errors = {
            key: float(value[i]) * (app.error_measure.scale if key == "error" else 1) for key, value in measures.items()
        }
        parameters = {key: value[i].detach().cpu() for key, value in theta.items()}
        _require_finite(task, parameters, errors)
        # the last digits of sums depend on the number of threads: the record states it, but outside of the settings,
        # since another number is no reason to fit anew
        record: Document = {"name": task.name, "error": None, **errors, "seconds": seconds}
        # fewer than the seconds if other programs took the CPU; where a GPU computes, they would say nothing
        record |= {CPU_SECONDS: cpu_seconds} if run.device.type == "cpu" else {}
        record |= {"threads": torch.get_num_threads(), **run.presenter.remarks(parameters, task)}
        record |= {"guarded": last.guarded is not None and bool(last.guarded[i])} if run.paradigm.guard else {}
        record |= {"warning": "; ".join(clauses)} if clauses else {}
        record |= {"batch": len(tasks)} if len(tasks) > 1 else {}
        if record["error"] is None and (comparison := run.presenter.photo_comparison(parameters, task)):
            record |= {"photo_error": photo_error_percent(comparison)}
        fits.append(Fit(run, task, record, parameters))
    return fits


def _clock_seconds(device: torch.device) -> float:
    """Wait until the device is idle, and return the seconds on a clock."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    return time.perf_counter()


def _require_finite(task: Task, theta: Params, errors: Mapping[str, float]) -> None:
    """Refuse a fit whose parameters or error are NaN or infinite.

    Args:
        task: the task that was fitted, which the message names.
        theta: the parameters of the fit, without a task axis.
        errors: the errors of the fit, by name.

    Raises:
        FloatingPointError: a parameter or the error is not finite.
    """
    are_params_finite = all(bool(torch.isfinite(value).all()) for value in theta.values())
    if not are_params_finite or not math.isfinite(errors.get("error", 0.0)):
        subject = "error is" if are_params_finite else "parameters are"
        raise FloatingPointError(
            f"{task.name}: the fit's {subject} not finite; use another checkpoint or paradigm, or fewer steps."
        )


def _warnings_or_fault(run: Run, stacked: Tasks, first: DescentState, last: DescentState) -> list[list[str]]:
    """Return :func:`warnings_of` the fits, or a clause for each that they could not be found: no doubt ends a fit."""
    try:
        return warnings_of(run, stacked, first, last)
    except FIT_ERRORS as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        return [[f"the fit could not be examined for doubts ({reason})"] for _ in stacked.names]


def warnings_of(run: Run, stacked: Tasks, first: DescentState, last: DescentState) -> list[list[str]]:
    """Return clauses of warnings for each fit, [] for a fit without doubt.

    A fit is doubtful where the application's presenter says so, and where its loss on visible samples rose: learned
    rules can fail. The loss is not compared where a guard has already compared each fit with its beginning.

    Args:
        run: the run of the fits.
        stacked: the fitted tasks.
        first: the first state of their descent.
        last: the last state of their descent.
    """
    clauses_by_task = run.presenter.quality_warnings(last.theta, stacked)
    if last.guarded is not None or not run.paradigm.steps:
        return clauses_by_task
    generators = tuple(Generator(stacked.rows.device).manual_seed(0) for _ in stacked.names)
    with torch.no_grad():
        batch = draw_per_task(lambda tasks, rng: run.app.sample(tasks, rng, run.recipe.samples), stacked, generators)
        losses_before, losses_after = (run.app.loss(state.theta, batch, {}).tolist() for state in (first, last))
    return [
        [*([] if after <= before else [f"{LOSS_ROSE_CLAUSE} from {before:.4g} to {after:.4g}"]), *clauses]
        for before, after, clauses in zip(losses_before, losses_after, clauses_by_task, strict=True)
    ]


def rng_of(run: Run, task: Task) -> Generator:
    """Return the generator of a fit's random draws, which depends on the seed and the task's name alone.

    A fit is therefore the same whatever is fitted beside it.
    """
    text = f"{run.options.seed} {task.name}"
    seed = int.from_bytes(hashlib.sha256(text.encode(errors="surrogatepass")).digest()[:6], "big")
    return Generator(run.device).manual_seed(seed)
