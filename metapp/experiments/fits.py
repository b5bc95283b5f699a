"""Fit tasks one by one, with their errors and times."""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Iterator
from typing import Any

import torch
from torch import Generator

from metapp.experiments.reporter import say
from metapp.experiments.session import Checkpoint, Options
from metapp.learning.app import stack
from metapp.learning.guard import Guarded
from metapp.learning.task import Params, Task, Tasks
from metapp.paradigms import Job, Paradigm


def fit_tasks(
    options: Options, paradigm: Paradigm, checkpoint: Checkpoint, tasks: list[Task]
) -> Iterator[tuple[dict[str, Any], Params]]:
    """Fit tasks, each alone, so that its time is its own.

    The time is from the task's samples to the final parameters, warm. The error is None where a task holds no
    reference.

    Yields:
        The record of each, and its parameters without a task axis.
    """
    app, job, device = options.app, options.job, options.device

    def fit_one(task: Any, steps: int | None) -> tuple[Guarded, float, Any]:
        rng = rng_of(options, task)
        _synchronise(device)
        begin = time.perf_counter()
        stacked = stack(app, [task], device)
        found = paradigm.fitted(job if steps is None else job._replace(steps=steps), checkpoint.prepared, stacked, rng)
        _synchronise(device)
        return found, time.perf_counter() - begin, stacked

    for task in tasks if app.protocols else ():
        app.prepare(task)  # that one does not hold what a fit may see should not be found after an hour
    for task in tasks[:1]:
        fit_one(task, min(paradigm.count(job), 3))  # warm: first calls load kernels
    threads = torch.get_num_threads()
    for task in tasks:
        (theta, acted), seconds, stacked = fit_one(task, None)
        errors = {key: float(value[0]) for key, value in app.errors(theta, stacked).items()}
        errors |= {key: app.scale * value for key, value in errors.items() if key == "error"}
        finite = all(bool(torch.isfinite(value).all()) for value in theta.values())
        if not finite or (errors and not math.isfinite(errors["error"])):
            what = "error is" if finite else "parameters are"
            raise FloatingPointError(
                f"{task.name}: the fit's {what} not finite; use another checkpoint or fewer steps."
            )
        # sums depend on the number of threads, in their last digits: the record says it, but its key does not, since
        # that is no reason to fit anew
        record = {"name": task.name, "error": None, **errors, "seconds": seconds, "threads": threads}
        record |= {"guarded": bool(acted[0])} if paradigm.guard(job) else {}
        record |= warning_of(paradigm, job, checkpoint, stacked, theta, rng_of(options, task))
        yield record, {key: value[0] for key, value in theta.items()}


def warning_of(
    paradigm: Paradigm, job: Job, checkpoint: Checkpoint, stacked: Tasks, theta: Params, rng: Generator
) -> dict[str, str]:
    """What a record says of a fit that is worse on what it sees than its initialisation: learned rules can fail.

    Args:
        paradigm, job, checkpoint: what the fit was made by.
        stacked: the one task.
        theta: the fit, [1, ...].
        rng: as it was at the beginning of the fit, so that the initialisation is the same.
    """
    if paradigm.count(job) == 0:
        return {}
    first = paradigm.start(job, checkpoint.prepared, stacked, rng)
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
