"""Prepare what a paradigm needs on the training tasks, by name, and say what a checkpoint is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace

from metapp.learning.progress import Prepared, Progress
from metapp.learning.recipe import OuterLoop
from metapp.paradigms import paradigms
from metapp.paradigms.paradigm import Job, TrainingData


def prepare(name: str, job: Job, data: TrainingData) -> Iterator[Progress]:
    """Prepare what a paradigm needs, by its name: "general", "quickft", or a learned rule.

    Args:
        name: what to prepare.
        job: application and recipe.
        data: the training tasks.

    Yields:
        How far it is, before each outer step and after each validation; at the end `best` is the result.

    Raises:
        FloatingPointError: the training loss is not finite; names tasks and step.
    """
    # a checkpoint is learned through the recipe's number of steps
    job = job._replace(steps=None, rule=name if name not in paradigms() else job.rule)
    return paradigms().get(name, paradigms()["meta"]).prepare(job, data)


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
