"""QuickFT: General's result, then Adam at a raised rate for Meta's number of steps."""

from __future__ import annotations

import torch

from metapp.learning.adjoint import UpdateRule
from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import Adam
from metapp.learning.rules import fixed_adam
from metapp.learning.task import Params
from metapp.paradigms.general import GENERAL, start
from metapp.paradigms.paradigm import Job, Paradigm

TUNED = ("rate", "beta1", "beta2", "eps", "final")


def to_alpha(settings: Adam) -> Params:
    """Adam's settings as a checkpoint of QuickFT stores them, scalars."""
    return {key: torch.tensor(getattr(settings, key), dtype=torch.float64) for key in TUNED}


def adam_of(job: Job, prepared: MetaParameters) -> Adam:
    """The Adam that was tuned on this data's validation tasks, else the recipe's."""
    tuned = {key: float(value) for key, value in prepared.alpha.items()}
    return Adam(**tuned) if tuned else job.recipe.quickft


def rule(job: Job, prepared: MetaParameters, theta: Params, steps: int) -> UpdateRule:
    """Adam at a raised rate."""
    return fixed_adam(adam_of(job, prepared), theta, steps)


QUICKFT = Paradigm(
    name="quickft",
    needs=lambda job: (*GENERAL.needs(job), "quickft"),
    start=start,
    rule=rule,
    steps=lambda recipe: recipe.steps,
    adam=adam_of,
)
