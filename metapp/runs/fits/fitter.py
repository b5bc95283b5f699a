"""Fit tasks one by one, or some side by side, with their errors and times."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain
from typing import NamedTuple

import torch
from torch import Generator

from metapp.learning.app import stack
from metapp.learning.learn import Step, last
from metapp.learning.task import Params, Rng, Task, Tasks, drawn
from metapp.runs.plan import Plan
from metapp.runs.reporter import say
from metapp.storage import Document

WARM = 1  # steps of the fit that loads kernels: the next one takes at most 2 % longer than after more of them
ROSE = "the visible loss rose"  # a clause of warnings, which tables count apart from the others


class Result(NamedTuple):
    """The result of a fit of a task: its record, and its parameters without a task axis."""

    record: Document
    theta: Params


def fit_tasks(plan: Plan, tasks: Sequence[Task], *, warns: bool = False) -> Iterator[Result]:
    """Fit tasks, each alone, so that its time is its own.

    The time is from the task's samples to the final parameters, warm. The error is None where a task holds no
    reference.

    Args:
        plan: with a checkpoint.
        tasks: what to fit.
        warns: whether warnings are also said, not only recorded; tables of hundreds of fits count them instead.

    Yields:
        Each fit as it comes.
    """
    fitter = Fitter(plan, warns=warns)
    fitter.check(tasks)
    for task in tasks:
        yield from fitter.fit([task])


class Fitter:
    """Fits tasks by a plan and times it; the first fit comes after a warm-up.

    Attributes:
        plan: with a checkpoint.
        warns: whether warnings are also said.
    """

    def __init__(self, plan: Plan, *, warns: bool = False) -> None:
        self.plan, self.warns = plan, warns
        self._warm = False

    def check(self, tasks: Sequence[Task]) -> None:
        """Refuse tasks that do not hold what a fit may see: that should not be found after hours.

        Raises:
            ValueError: one does not.
        """
        for task in tasks if self.plan.app.protocol else ():
            self.plan.app.prepare(task)

    def fit(self, tasks: Sequence[Task]) -> list[Result]:
        """Fit tasks side by side, each as if it were alone; its seconds are its share of those that all took.

        Raises:
            FloatingPointError: a fit is not finite.
            ValueError: tasks differ in their sizes.
        """
        plan, app = self.plan, self.plan.app
        self._warm_up(tasks[0])
        rng, begin = self._rng(tasks), _now(plan.device)
        stacked = stack(app, tasks, plan.device)
        descent = plan.paradigm.descend(plan.prepared, stacked, rng)
        first = next(descent)
        fit = last(chain([first], descent))
        theta = app.finish(fit.theta)
        seconds = _now(plan.device) - begin
        measures = app.errors(theta, stacked)
        warnings = warnings_of(plan, stacked, first, fit)
        results = []
        for i, (task, clauses) in enumerate(zip(tasks, warnings, strict=True)):
            errors = {key: float(value[i]) for key, value in measures.items()}
            errors |= {key: app.scale * value for key, value in errors.items() if key == "error"}
            theta_of_task = {key: value[i] for key, value in theta.items()}
            require_finite(task, theta_of_task, errors)
            # sums depend on the number of threads, in their last digits: the record says it, but its key does not,
            # since that is no reason to fit anew
            record: Document = {"name": task.name, "error": None, **errors, "seconds": seconds / len(tasks)}
            record["threads"] = torch.get_num_threads()
            record |= app.remarks(task, theta_of_task)
            record |= {"guarded": fit.guarded is not None and bool(fit.guarded[i])} if plan.paradigm.guard else {}
            if self.warns and "note" in record:
                say(f"{task.name}: {record['note']}")
            results.append(Result(record | ({"warning": "; ".join(clauses)} if clauses else {}), theta_of_task))
            for clause in clauses if self.warns else ():
                remedy = "; try another rule, more steps or another paradigm." if clause.startswith(ROSE) else ""
                say(f"warning: {task.name}: {clause}{remedy}")
        return results

    def _warm_up(self, task: Task) -> None:
        """Take a step before the first fit, as first calls load kernels."""
        if self._warm:
            return
        self._warm = True
        plan, few = self.plan, min(self.plan.steps, WARM)
        tasks = stack(plan.app, [task], plan.device)
        # what a guard looks at takes longer than a step
        plan.paradigm.unguarded(few).fit(plan.prepared, tasks, self._rng([task]))

    def _rng(self, tasks: Sequence[Task]) -> Rng:
        rngs = tuple(rng_of(self.plan, task) for task in tasks)
        return rngs if len(rngs) > 1 else rngs[0]


def _now(device: torch.device) -> float:
    """Seconds on a clock, once the device has done what it was asked for."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    return time.perf_counter()


def require_finite(task: Task, theta: Params, errors: Mapping[str, float]) -> None:
    """Refuse a fit of a task, parameters without a task axis, that holds NaN or infinite values, or has such an error.

    Raises:
        FloatingPointError: it does.
    """
    finite = all(bool(torch.isfinite(value).all()) for value in theta.values())
    if not finite or (errors and not math.isfinite(errors["error"])):
        what = "error is" if finite else "parameters are"
        raise FloatingPointError(
            f"{task.name}: the fit's {what} not finite; use another checkpoint or paradigm, or fewer steps."
        )


def warnings_of(plan: Plan, stacked: Tasks, first: Step, fit: Step) -> list[list[str]]:
    """Warnings in records of fits that are doubtful, as some applications see themselves, or worse than they began.

    Fits that a guard compared with their beginning are none of the latter.

    Args:
        plan: what the fits were made by.
        stacked: the tasks.
        first, fit: their fits at their beginning and end.

    Returns:
        Clauses for each task, [] where there is nothing to say.
    """
    app = plan.app
    doubts = app.doubts(fit.theta, stacked)
    compared = fit.guarded is not None or not plan.steps
    rises = [[] for _ in range(len(stacked))] if compared else _rises(plan, stacked, first, fit)
    return [[*rise, *doubt] for rise, doubt in zip(rises, doubts, strict=True)]


def _rises(plan: Plan, stacked: Tasks, first: Step, fit: Step) -> list[list[str]]:
    """Warnings of fits that are worse on what they see than their initialisation: learned rules can fail."""
    again = tuple(Generator(stacked.rows.device).manual_seed(0) for _ in stacked.names)
    with torch.no_grad():
        batch = drawn(lambda some, own: plan.app.sample(some, own, plan.recipe.batch), stacked, again)
        before, after = (plan.app.loss(step.theta, batch, {}).tolist() for step in (first, fit))
    pairs = zip(before, after, strict=True)
    return [[] if high <= low else [f"{ROSE} from {low:.4g} to {high:.4g}"] for low, high in pairs]


def rng_of(plan: Plan, task: Task) -> Generator:
    """The source of a fit's draws: it depends on the task's name alone, whatever is fitted beside it."""
    text = f"{plan.options.seed} {task.name}"
    seed = int.from_bytes(hashlib.sha256(text.encode(errors="surrogatepass")).digest()[:6], "big")
    return Generator(plan.device).manual_seed(seed)
