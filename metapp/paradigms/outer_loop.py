"""The outer loop: train on the training tasks, keep the best state on the validation tasks."""

from __future__ import annotations

import functools
import shutil
from dataclasses import replace

import torch
from torch import Tensor

from metapp.learning.adjoint import Loss
from metapp.learning.learn import MetaParameters, Progress, learn
from metapp.learning.recipe import OuterLoop
from metapp.learning.rules import outer_adam
from metapp.learning.task import Params
from metapp.paradigms import ranks
from metapp.paradigms.paradigm import Given, Job, Paradigm
from metapp.paradigms.resuming import Interrupted, Outer, Prepared
from metapp.paradigms.validation import validation_error


def train(
    paradigm: Paradigm, job: Job, first: MetaParameters, loss: Loss, training: OuterLoop, given: Given
) -> Prepared:
    """Train a checkpoint by the outer loop and keep its best state on the validation tasks.

    Args:
        paradigm: whose fits validate.
        job: application and recipe.
        first: phi before the first outer step.
        loss: on phi, in its flat tree.
        training: settings of the loop; `given.steps` goes before its own.
        given: tasks, generator, progress.

    Raises:
        Interrupted: Ctrl-C; carries the best state so far.
        FloatingPointError: the training loss is not finite; names tasks and step.
    """
    rng, since, scale = given.rng, given.since, job.app.traits.scale
    if given.steps is not None:
        training = replace(training, steps=given.steps)
    best = Prepared(first, float("inf"), 0, [])
    losses: list[Tensor] = []
    if since.outer:
        best = since.outer.best._replace(curve=list(since.outer.best.curve))
        losses = list(since.outer.losses)
        rng.set_state(since.outer.rng)

    def keep_copy(progress: Progress) -> None:
        reached = best._replace(curve=list(best.curve))
        given.keep(since._replace(outer=Outer(progress, rng.get_state(), reached, tuple(losses))))

    def look(step: int, params: Params) -> None:
        nonlocal best
        error = validation_error(paradigm, job, MetaParameters.unflat(params), given.to_validate)
        mean = scale * float(torch.stack(losses).mean()) if losses else None
        losses.clear()
        best.curve.append((step, mean, error))
        if error < best.validation:
            kept = {key: value.clone() for key, value in params.items()}
            best = Prepared(MetaParameters.unflat(kept), error, step, best.curve)
        if given.report:
            loss_note = "" if mean is None else f"loss {mean:.3f}, "
            given.report(step, training.steps, f"{loss_note}validation {error:.3f}, best {best.validation:.3f}")

    def watch(step: int, params: Params, value: Tensor) -> None:
        if step % training.validate_every == 0:
            look(step, params)
        losses.append(value.mean())

    params = first.flat()
    rule = outer_adam(training, params)
    if ranks.count() > 1:
        ranks.require(min(training.tasks, len(given.to_fit)))
        rule = rule._replace(sees=ranks.summed_gradient)
    try:
        final = learn(
            params,
            rule,
            given.to_fit,
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
