"""Prepare what a paradigm needs on the training tasks, by name, and say what a checkpoint is."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any

from torch import Generator

from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import OuterLoop
from metapp.learning.task import Tasks
from metapp.paradigms import paradigms
from metapp.paradigms.paradigm import Given, Job, Report
from metapp.paradigms.resuming import Keep, Prepared, Reached, forget
from metapp.paradigms.validation import split_validation


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
    to_fit, to_validate = split_validation(tasks)
    # a checkpoint is learned through the recipe's number of steps
    job = job._replace(steps=None, rule=name if name not in paradigms() else job.rule)
    paradigm = paradigms().get(name, paradigms()["meta"])
    return paradigm.prepare(job, Given(to_fit, to_validate, rng, encoder, steps, report, since, keep))


def training_of(job: Job, name: str, steps: int | None) -> OuterLoop | None:
    """How a start is trained, with outer steps instead of the recipe's; None where there is only a search."""
    if name == "quickft":
        return None
    training = job.recipe.general if name == "general" else job.recipe.training(name)
    if training.steps and steps is not None:
        training = replace(training, steps=steps)
    return training


def describe(job: Job, name: str, prepared: Prepared, steps: int | None = None) -> dict[str, Any]:
    """What a checkpoint says about itself: JSON-ready.

    Args:
        job: application and recipe.
        name: what was prepared.
        prepared: the result.
        steps: outer steps instead of the recipe's.
    """
    recipe, training = job.recipe, training_of(job, name, steps)
    return {
        "app": job.app.name,
        "checkpoint": name,
        "inner_steps": recipe.steps,
        "batch": recipe.batch,
        "training": training and asdict(training),
        "validation_error": prepared.validation,
        "best_step": prepared.step,
        "curve": prepared.curve,
    }
