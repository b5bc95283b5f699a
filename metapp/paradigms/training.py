"""The outer loop: prepare what a paradigm needs on the training tasks, keep the best state on validation tasks."""

from __future__ import annotations

import functools
import shutil
from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any

import torch
from torch import Generator, Tensor

from metapp.learning.adjoint import Loss
from metapp.learning.learn import MetaParameters, Progress, learn
from metapp.learning.recipe import MetaTraining, OuterLoop
from metapp.learning.rules import outer_adam
from metapp.learning.task import Params, Tasks
from metapp.paradigms import general, meta, paradigms
from metapp.paradigms.paradigm import Job
from metapp.paradigms.resuming import Interrupted, Keep, Outer, Prepared, Reached, forget
from metapp.paradigms.tuning import Report, search, to_tune_on, tune_quickft
from metapp.paradigms.validation import split_validation, validation_error


def prepare(
    name: str,
    job: Job,
    tasks: Tasks,
    rng: Generator,
    *,
    encoder: MetaParameters | None = None,
    steps: int | None = None,
    report: Report | None = None,
    since: Reached = Reached(),  # noqa: B008  (never written to)
    keep: Keep = forget,
) -> Prepared:
    """Prepare what a paradigm needs, by its name: "general", "quickft", or a learned rule.

    Args:
        name: what to prepare.
        job: application and recipe.
        tasks: the training tasks; every eighth of them validates.
        rng: of all random draws.
        encoder: a prepared General; QuickFT tunes on it, Meta starts from it or from the mean of its predictions.
        steps: outer steps instead of the recipe's; looks at validation tasks where there is only a search.
        report: called with the progress.
        since: how far the same preparation was when it was cut off, to go on from.
        keep: called with how far it is, before each outer step and after each look of a search.

    Raises:
        Interrupted: Ctrl-C; carries the best state so far.
        FloatingPointError: the training loss is not finite; names tasks and step.
    """
    job = job._replace(steps=None)  # a start is learned through the recipe's number of steps
    to_fit, to_validate = split_validation(tasks)
    if name == "quickft":
        assert encoder is not None
        return tune_quickft(job, encoder, to_tune_on(job, to_validate), report, steps, since, keep)
    if name == "general":
        training, paradigm = job.recipe.general, paradigms()["general"]
        first, loss = general.preparation(job, rng)
    else:
        training, paradigm = job.recipe.meta_training(name), paradigms()["meta"]
        compiled = job.app.compiles and can_compile()
        first, loss = meta.preparation(job, _meta_start(job, training, encoder, to_fit, rng), rng, compiled=compiled)
        first = meta.with_gradients(job, first, to_fit, rng)
        if training.tuned:
            start_of = functools.partial(meta.with_adam, job, first)
            few, looks = to_tune_on(job, to_validate), None if training.steps else steps

            def keep_looks(reached: Reached) -> None:
                nonlocal since
                since = reached  # the outer steps keep them, too
                keep(reached)

            found = search(paradigm, job, training.first, start_of, few, report, looks, since, keep_looks)
            if not training.steps:
                return found
            first = found.start
    if steps is not None:
        training = replace(training, steps=steps)

    def validate(params: Params) -> float:
        return validation_error(paradigm, job, MetaParameters.unflat(params), to_validate)

    return _train(first, loss, training, to_fit, validate, job.app.scale, rng, report, since, keep)


def _meta_start(
    job: Job, training: MetaTraining, encoder: MetaParameters | None, tasks: Tasks, rng: Generator
) -> MetaParameters:
    if encoder is None or training.start == "random":
        return MetaParameters()
    if training.start == "encoder":
        return encoder
    predicted = general.start(job, encoder, tasks, rng)
    return MetaParameters({key: value.mean(0) for key, value in predicted.items()})


def _train(
    first: MetaParameters,
    loss: Loss,
    training: OuterLoop,
    tasks: Tasks,
    validate: Callable[[Params], float],
    scale: float,
    rng: Generator,
    report: Report | None,
    since: Reached,
    keep: Keep,
) -> Prepared:
    best = Prepared(first, float("inf"), 0, [])
    losses: list[Tensor] = []
    if since.outer:
        best = since.outer.best._replace(curve=list(since.outer.best.curve))
        losses = list(since.outer.losses)
        rng.set_state(since.outer.rng)

    def keep_copy(progress: Progress) -> None:
        reached = best._replace(curve=list(best.curve))
        keep(since._replace(outer=Outer(progress, rng.get_state(), reached, tuple(losses))))

    def look(step: int, params: Params) -> None:
        nonlocal best
        error = validate(params)
        mean = scale * float(torch.stack(losses).mean()) if losses else None
        losses.clear()
        best.curve.append((step, mean, error))
        if error < best.validation:
            kept = {key: value.clone() for key, value in params.items()}
            best = Prepared(MetaParameters.unflat(kept), error, step, best.curve)
        if report:
            loss_note = "" if mean is None else f"loss {mean:.3f}, "
            report(step, training.steps, f"{loss_note}validation {error:.3f}, best {best.validation:.3f}")

    def watch(step: int, params: Params, value: Tensor) -> None:
        if step % training.validate_every == 0:
            look(step, params)
        losses.append(value.mean())

    params = first.flat()
    rule = outer_adam(training, params)
    try:
        final = learn(
            params,
            rule,
            tasks,
            loss,
            steps=training.steps,
            rng=rng,
            watch=watch,
            check_every=1,
            since=since.outer and since.outer.progress,
            keep=keep_copy,
        )
        look(training.steps, final)
    except KeyboardInterrupt:
        raise Interrupted(best) from None
    return best


@functools.cache
def can_compile() -> bool:
    """torch.compile needs a whole C++ tool chain on the CPU; without one, training is about half as fast, the same."""
    if not any(shutil.which(name) for name in ("g++", "clang++")):
        return False
    try:
        torch.compile(lambda x: x.sin() + 1)(torch.ones(8))
    except Exception:  # whatever a compiler that lacks a part raises
        return False
    return True


def training_of(job: Job, name: str, steps: int | None) -> OuterLoop | None:
    """How a start is trained, with outer steps instead of the recipe's; None where there is only a search."""
    if name == "quickft":
        return None
    training = job.recipe.general if name == "general" else job.recipe.meta_training(name)
    if training.steps and steps is not None:
        training = replace(training, steps=steps)
    return training


def describe(job: Job, name: str, prepared: Prepared, steps: int | None = None) -> dict[str, Any]:
    """What a start says about itself: JSON-ready.

    Args:
        job: application and recipe.
        name: what was prepared.
        prepared: the result.
        steps: outer steps instead of the recipe's.
    """
    recipe, training = job.recipe, training_of(job, name, steps)
    return {
        "app": job.app.name,
        "start": name,
        "inner_steps": recipe.steps,
        "batch": recipe.batch,
        "training": training and asdict(training),
        "validation_error": prepared.validation,
        "best_step": prepared.step,
        "curve": prepared.curve,
    }
