"""What prepares a checkpoint, by its name, and the description that its file holds."""

from __future__ import annotations

from dataclasses import asdict, replace

from metapp.learning.progress import TrainState
from metapp.learning.recipe import OuterLoop
from metapp.paradigms import PARADIGMS
from metapp.paradigms.meta import Meta
from metapp.paradigms.paradigm import Paradigm


def preparing(paradigm: Paradigm, name: str) -> Paradigm:
    """The paradigm that prepares a checkpoint: "general", "quickft", or a learned rule.

    A checkpoint is learned through the recipe's number of steps.
    """
    if name in PARADIGMS:
        return PARADIGMS[name](paradigm.app, paradigm.recipe, paradigm.rule_name)
    return Meta(paradigm.app, paradigm.recipe, name)


def training_of(paradigm: Paradigm, steps: int | None) -> OuterLoop | None:
    """The outer loop of a preparation, with other steps than the recipe's; None where there is only a search."""
    training = paradigm.training
    if training and training.steps and steps is not None:
        training = replace(training, steps=steps)
    return training


def describe(paradigm: Paradigm, state: TrainState, steps: int | None = None) -> dict[str, object]:
    """The description of a checkpoint in its file: JSON-ready.

    Args:
        paradigm: that prepared it.
        state: at the end.
        steps: outer steps instead of the recipe's.
    """
    recipe, training = paradigm.recipe, training_of(paradigm, steps)
    return {
        "app": paradigm.app.name,
        "checkpoint": paradigm.needs[-1],
        "inner_steps": recipe.steps,
        "batch": recipe.batch,
        "training": training and asdict(training),
        "validation_error": state.validation,
        "best_step": state.best_step,
        "curve": state.curve,
    }
