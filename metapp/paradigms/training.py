"""Preparation on the training tasks: train a start, keep its best state on validation tasks, tune QuickFT."""

from __future__ import annotations

import functools
import itertools
import shutil
import sys
from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any

import torch
from torch import Generator, Tensor

from metapp.learning.adjoint import Loss
from metapp.learning.learn import MetaParameters, Progress, learn
from metapp.learning.recipe import Adam, Training
from metapp.learning.rules import outer_adam
from metapp.learning.task import Params, Tasks
from metapp.paradigms import general, meta, paradigms, quickft
from metapp.paradigms.paradigm import AT_ONCE, Job, Paradigm
from metapp.paradigms.resuming import Interrupted, Keep, Outer, Prepared, Reached, forget

Report = Callable[[int, int, str], None]  # (step, steps, note), for a progress bar


def split_validation(tasks: Tasks) -> tuple[Tasks, Tasks]:
    """(to train on, to validate on): of the groups, sorted by name, every eighth from the fourth on validates.

    Sorting spreads the validation tasks over the families that names begin with.

    Raises:
        ValueError: fewer than 4 groups.
    """
    groups = [(tasks.groups or tasks.names)[row] for row in tasks.rows.tolist()]
    if len(set(groups)) < 4:
        raise ValueError(
            f"training set: {len(tasks)} tasks that show {len(set(groups))} things, expected at least 4 (some are kept "
            "for validation)."
        )
    validating = set(sorted(set(groups))[3::8])
    rows = range(len(tasks))
    return (
        tasks.select([row for row in rows if groups[row] not in validating]),
        tasks.select([row for row in rows if groups[row] in validating]),
    )


def validation_error(paradigm: Paradigm, job: Job, prepared: MetaParameters, tasks: Tasks) -> float:
    """Mean error of fits of all tasks with fixed seeds, as the table prints it; infinite where a fit diverges."""
    total, seeds = 0.0, 1 if job.app.deterministic else 2
    for seed in range(seeds):
        rng = Generator(tasks.rows.device).manual_seed(seed)
        for some in torch.arange(len(tasks)).split(AT_ONCE):
            part = tasks.select(some)
            try:
                theta = paradigm.fit(job, prepared, part, rng)
            except FloatingPointError:
                return float("inf")
            total += float(job.app.errors(theta, part)["error"].sum())
    return job.app.scale * total / (seeds * len(tasks))


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
        return tune_quickft(job, encoder, _to_tune_on(job, to_validate), report, steps, since, keep)
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
            few, looks = _to_tune_on(job, to_validate), None if training.steps else steps

            def keep_looks(reached: Reached) -> None:
                nonlocal since
                since = reached  # the outer steps keep them, too
                keep(reached)

            found = _search(paradigm, job, training.first, start_of, few, report, looks, since, keep_looks)
            if not training.steps:
                return found
            first = found.start
    if steps is not None:
        training = replace(training, steps=steps)

    def validate(params: Params) -> float:
        return validation_error(paradigm, job, MetaParameters.unflat(params), to_validate)

    return _train(first, loss, training, to_fit, validate, job.app.scale, rng, report, since, keep)


def _to_tune_on(job: Job, tasks: Tasks) -> Tasks:
    """All validation tasks where fits are cheap, else up to TUNED_ON of them, evenly spaced."""
    if job.app.cheap_fits:
        return tasks
    count = min(len(tasks), TUNED_ON)
    return tasks.select([i * len(tasks) // count for i in range(count)])


def _meta_start(
    job: Job, training: Training, encoder: MetaParameters | None, tasks: Tasks, rng: Generator
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
    training: Training,
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


def tune_quickft(
    job: Job,
    encoder: MetaParameters,
    tasks: Tasks,
    report: Report | None = None,
    looks: int | None = None,
    since: Reached = Reached(),  # noqa: B008  (never written to)
    keep: Keep = forget,
) -> Prepared:
    """Search QuickFT's Adam on validation tasks, in so many looks: a win over a badly tuned baseline is no win.

    Returns:
        A start whose alpha holds Adam's settings, scalars on the CPU, and the encoder that they were tuned for.

    Raises:
        Interrupted: Ctrl-C; carries the best settings so far.
    """

    def start_of(adam: Adam) -> MetaParameters:
        return encoder._replace(alpha=quickft.to_alpha(adam))

    return _search(quickft.QUICKFT, job, job.recipe.quickft, start_of, tasks, report, looks, since, keep)


def _search(
    paradigm: Paradigm,
    job: Job,
    first: Adam,
    start_of: Callable[[Adam], MetaParameters],
    tasks: Tasks,
    report: Report | None,
    looks: int | None,
    since: Reached,
    keep: Keep,
) -> Prepared:
    """The best Adam on validation tasks: a coordinate search, one setting or two at a time."""
    curve: list[tuple[int, float | None, float]] = []
    best, best_adam = Prepared(start_of(first), float("inf"), 0, curve), first
    total = min(1 + sum(len(choices) for choices in SEARCHED), looks or sys.maxsize)
    errors: list[float] = []

    def look(adam: Adam) -> None:
        nonlocal best, best_adam
        tuned, known = start_of(adam), since.looks[len(errors) :]
        error = known[0] if known else validation_error(paradigm, job, tuned, tasks)
        errors.append(error)
        done = len(errors)
        if error < best.validation:
            best, best_adam = Prepared(tuned, error, done, curve), adam
            curve.append((done, None, error))
        if known:
            return
        keep(Reached(tuple(errors)))
        if report:
            report(done, total, f"rate {adam.rate:.1e}, validation {error:.3f}, best {best.validation:.3f}")

    try:
        look(best_adam)
        for choices in SEARCHED:
            around = best_adam
            for changes in choices[: total - len(errors)]:
                look(replace(around, **{**changes, "rate": around.rate * changes.get("rate", 1.0)}))
    except KeyboardInterrupt:
        raise Interrupted(best) from None
    return best


# What the search tries, one line after the other around the best so far; a rate is a factor of the best's.
TUNED_ON = 8  # validation tasks, where a fit takes longer than an instant
SEARCHED: tuple[list[dict[str, float]], ...] = (
    [{"rate": 2.0**i} for i in (-5, -4, -3, -2, -1, 1, 2, 3, 4, 5)],
    [
        {"beta1": beta1, "beta2": beta2}
        for beta1, beta2 in itertools.product((0.3, 0.5, 0.7, 0.8, 0.9), (0.8, 0.9, 0.97, 0.99, 0.999))
    ],
    [{"final": final, "rate": factor} for final, factor in itertools.product((1.0, 0.3, 0.1, 0.0), (1.0, 1.3))],
    [{"eps": eps, "rate": factor} for eps, factor in itertools.product((1e-8, 1e-6, 1e-4, 1e-3), (0.84, 1.0, 1.19))],
    [{"rate": 2 ** (i / 8)} for i in (-5, -3, -2, -1, 1, 2, 3, 5)],
)


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


def training_of(job: Job, name: str, steps: int | None) -> Training | None:
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
