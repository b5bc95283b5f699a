"""Prepare what a paradigm needs on the training tasks, by name, and say what a checkpoint is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace

from torch import Generator

from metapp.learning.learn import MetaParameters
from metapp.learning.progress import Prepared, Progress
from metapp.learning.recipe import OuterLoop
from metapp.learning.task import Tasks
from metapp.paradigms import paradigms
from metapp.paradigms.paradigm import Job, TrainingData
from metapp.paradigms.validation import split_validation


def prepare(
    name: str,
    job: Job,
    tasks: Tasks,
    rng: Generator,
    *,
    encoder: MetaParameters | None = None,
    steps: int | None = None,
    since: Progress = Progress(),  # noqa: B008  (never written to)
    first: MetaParameters = MetaParameters(),  # noqa: B008
) -> Iterator[Progress]:
    """Prepare what a paradigm needs, by its name: "general", "quickft", or a learned rule.

    Args:
        name: what to prepare.
        job: application and recipe.
        tasks: the training tasks; every eighth of them validates.
        rng: of all random draws.
        encoder: a prepared General; QuickFT tunes on it, Meta begins with it or with the mean of its predictions.
        steps: outer steps instead of the recipe's; validations where there is only a search.
        since: how far the same preparation was when it was cut off, to go on from.
        first: a checkpoint of this name whose outer steps go on, instead of a fresh one.

    Yields:
        How far it is, before each outer step and after each validation; at the end `best` is the result.

    Raises:
        FloatingPointError: the training loss is not finite; names tasks and step.
    """
    to_fit, to_validate = split_validation(tasks)
    # a checkpoint is learned through the recipe's number of steps
    job = job._replace(steps=None, rule=name if name not in paradigms() else job.rule)
    paradigm = paradigms().get(name, paradigms()["meta"])
    return paradigm.prepare(job, TrainingData(to_fit, to_validate, rng, encoder, steps, since, first))


def training_of(job: Job, name: str, steps: int | None) -> OuterLoop | None:
    """The training of a checkpoint, with outer steps instead of the recipe's; None where there is only a search."""
    if name == "quickft":
        return None
    training = job.recipe.general if name == "general" else job.recipe.training(name)
    if training.steps and steps is not None:
        training = replace(training, steps=steps)
    return training


def describe(job: Job, name: str, prepared: Prepared, steps: int | None = None) -> dict[str, object]:
    """The description of a checkpoint in its file: JSON-ready.

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
