"""Fit tasks one by one, or some side by side, with their errors and times."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import torch
from torch import Generator

from metapp.learning.app import stack
from metapp.learning.deadline import REMEMBERED, Deadline, Pace, usual
from metapp.learning.learn import Step, last
from metapp.learning.task import Params, Rng, Task, Tasks, drawn
from metapp.paradigms import Job, Paradigm
from metapp.runs.reporter import say
from metapp.runs.session import Checkpoint, Options
from metapp.runs.timing import Stopwatch, said_time
from metapp.runs.watching import Watched

WARM = 1  # steps of the fit that loads kernels: the next one takes at most 2 % longer than after more of them
PACED = 8  # steps of those that measure a step: as many as show all stages of a descent from coarse to fine
PACING = 0.3  # seconds that these take, about; one of them at least


def fit_tasks(
    options: Options, paradigm: Paradigm, checkpoint: Checkpoint, tasks: list[Task], watched: Watched | None = None
) -> Iterator[tuple[dict[str, Any], Params]]:
    """Fit tasks, each alone, so that its time is its own.

    The time is from the task's samples to the final parameters, warm. The error is None where a task holds no
    reference. Where fits are watched, drawing is not part of their times.

    Returns:
        The record of each, and its parameters without a task axis, as they come.
    """
    return Fitter(options, paradigm, checkpoint, watched).each(tasks)


class Fitter:
    """Fits tasks by one paradigm and times it.

    Attributes:
        over: by how many seconds fits were longer than the budget, of those that took steps and of those that did not.
    """

    def __init__(
        self, options: Options, paradigm: Paradigm, checkpoint: Checkpoint, watched: Watched | None = None
    ) -> None:
        self.options, self.paradigm, self.checkpoint, self.watched = options, paradigm, checkpoint, watched
        self.over: dict[bool, list[float]] = {True: [], False: []}
        self._paces: list[Pace] = []
        self._warm = False

    def each(self, tasks: Sequence[Task]) -> Iterator[tuple[dict[str, Any], Params]]:
        """Fit tasks one by one; see `fit_tasks`."""
        for task in tasks if self.options.app.protocol else ():
            self.options.app.prepare(task)  # that one does not hold what a fit may see should not be found after hours
        for task in tasks:
            self.warm(task)
            yield from self.fit([task])
        if self.watched:
            self.watched.finish()
        self.tell(len(tasks))

    def warm(self, task: Task) -> None:
        """Take a step before the first fit, as first calls load kernels; for a budget measure how long they are."""
        if self._warm:
            return
        self._warm = True
        few = min(self.paradigm.count(self.options.job), WARM)
        unguarded = self.paradigm._replace(guard=lambda job: None)  # what a guard looks at takes longer than a step
        tasks = stack(self.options.app, [task], self.options.device)
        unguarded.fit(self.options.job._replace(steps=few), self.checkpoint.prepared, tasks, self._rng([task]))
        if self.options.budget is not None and few:
            self._measure(task, PACING)

    def _measure(self, task: Task, seconds: float) -> None:
        """Measure how long steps take, on fits that nothing is kept of; for about so long, and at least on one."""
        spent = 0.0
        while not spent or (spent < seconds and len(self._paces) < REMEMBERED):
            spent += self._timed([task], self.options.job._replace(steps=PACED), math.inf)[1]

    def fit(self, tasks: Sequence[Task]) -> list[tuple[dict[str, Any], Params]]:
        """Fit tasks side by side, each as if it were alone; its seconds are its share of those that all took.

        Returns:
            The record of each task, and its parameters without a task axis.

        Raises:
            FloatingPointError: a fit is not finite.
            ValueError: tasks differ in their sizes.
        """
        options, paradigm, job, app = self.options, self.paradigm, self.options.job, self.options.app
        fit, seconds, stacked, taken = self._timed(tasks, job, options.budget, self.watched)
        theta = fit.theta
        if self.watched:
            self.watched.show(tasks[0], theta, f"after {taken} steps")
        measures = app.errors(theta, stacked)
        alarms = warnings_of(paradigm, job, self.checkpoint, stacked, theta, self._rng(tasks))
        found = []
        for i, (task, alarm) in enumerate(zip(tasks, alarms, strict=True)):
            errors = {key: float(value[i]) for key, value in measures.items()}
            errors |= {key: app.traits.scale * value for key, value in errors.items() if key == "error"}
            own = {key: value[i] for key, value in theta.items()}
            require_finite(task, own, errors)
            # sums depend on the number of threads, in their last digits: the record says it, but its key does not,
            # since that is no reason to fit anew
            record = {"name": task.name, "error": None, **errors, "seconds": seconds / len(tasks)}
            record["threads"] = torch.get_num_threads()
            record |= {"guarded": fit.guarded is not None and bool(fit.guarded[i])} if paradigm.guard(job) else {}
            record |= {"steps": taken} if options.budget is not None else {}
            found.append((record | ({"warning": alarm} if alarm else {}), own))
        if options.budget is not None:
            self._judge(seconds, taken)
            if taken < min(2, paradigm.count(job)):
                self._measure(tasks[0], 0.0)  # a fit of no step does not say whether one would fit now
        return found

    def _rng(self, tasks: Sequence[Task]) -> Rng:
        each = tuple(rng_of(self.options, task) for task in tasks)
        return each if len(each) > 1 else each[0]

    def _timed(
        self, tasks: Sequence[Task], job: Job, budget: float | None = None, watched: Watched | None = None
    ) -> tuple[Step, float, Tasks, int]:
        """Fits at their end, their seconds, the stacked tasks, the steps taken; a budget learns their pace."""
        rng = self._rng(tasks)
        clock = Stopwatch(self.options.device)
        known = usual(self._paces) if self._paces and budget != math.inf else None
        deadline = None if budget is None else Deadline(budget, clock, known)
        stacked = stack(self.options.app, tasks, self.options.device)
        descent = self.paradigm.descend(job, self.checkpoint.prepared, stacked, rng, deadline)
        if watched:
            descent = watched.shown(descent, tasks[0], self.paradigm.count(job), clock)
        fit = last(descent)
        seconds = clock()
        pace = deadline and deadline.pace()
        self._paces += [pace] if pace else []
        return fit, seconds, stacked, deadline.taken[0] if deadline else self.paradigm.count(job)

    def _judge(self, seconds: float, taken: int) -> None:
        over = seconds - (self.options.budget or 0.0)
        if over > 0:
            self.over[taken > 0].append(over)

    def tell(self, count: int) -> None:
        """Say how many fits took longer than the budget, and why."""
        budget = self.options.budget or 0.0
        for moved, why in ((False, "even the initialisation took longer"), (True, "slow steps took longer")):
            if over := self.over[moved]:
                most = said_time(budget + max(over))
                say(f"budget: on {len(over)} of {count} tasks {why} than {said_time(budget)}, up to {most}")
                over.clear()


def require_finite(task: Task, theta: Params, errors: Mapping[str, float]) -> None:
    """Refuse a fit of a task, parameters without a task axis, that holds NaN or infinite values, or has such an error.

    Raises:
        FloatingPointError: it does.
    """
    finite = all(bool(torch.isfinite(value).all()) for value in theta.values())
    if not finite or (errors and not math.isfinite(errors["error"])):
        what = "error is" if finite else "parameters are"
        raise FloatingPointError(f"{task.name}: the fit's {what} not finite; use another checkpoint or fewer steps.")


def warnings_of(
    paradigm: Paradigm, job: Job, checkpoint: Checkpoint, stacked: Tasks, theta: Params, rng: Rng
) -> list[str]:
    """What records say of fits that are worse on what they see than their initialisation: learned rules can fail.

    Args:
        paradigm, job, checkpoint: what the fits were made by.
        stacked: the tasks.
        theta: their fits, [T, ...].
        rng: as it was at the beginning of the fits, so that the initialisations are the same.

    Returns:
        A line for each task, "" where there is nothing to say.
    """
    if paradigm.count(job) == 0:
        return [""] * len(stacked)
    first = paradigm.initialisation(job, checkpoint.prepared, stacked, rng)
    again = tuple(Generator(stacked.rows.device).manual_seed(0) for _ in stacked.names)
    with torch.no_grad():
        batch = drawn(lambda some, own: job.app.sample(some, own, job.recipe.batch), stacked, again)
        before, after = (job.app.loss(each, batch, {}).tolist() for each in (first, theta))
    lines = []
    for name, low, high in zip(stacked.names, before, after, strict=True):
        lines.append("" if high <= low else f"the visible loss rose from {low:.4g} to {high:.4g}")
        if lines[-1]:
            say(f"warning: {name}: {lines[-1]}; try another rule, more steps or another paradigm.")
    return lines


def rng_of(options: Options, task: Task) -> Generator:
    """The source of a fit's draws: it depends on the task's name alone, whatever is fitted beside it."""
    seed = int.from_bytes(
        hashlib.sha256(f"{options.seed} {task.name}".encode(errors="surrogatepass")).digest()[:6], "big"
    )
    return Generator(options.device).manual_seed(seed)
