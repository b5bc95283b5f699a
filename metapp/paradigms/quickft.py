"""QuickFT: General's result, then Adam at a raised rate for Meta's number of steps."""

from __future__ import annotations

import torch

from metapp.adjoint import UpdateRule
from metapp.learning import MetaParameters
from metapp.paradigms import Job, Paradigm
from metapp.paradigms.general import GENERAL, start
from metapp.rules import fixed_adam
from metapp.task import Adam, Params

TUNED = ("rate", "beta1", "beta2", "eps", "final")


def to_alpha(settings: Adam) -> Params:
    """Adam's settings as the quantities that a tuned start stores, scalars."""
    return {key: torch.tensor(getattr(settings, key), dtype=torch.float64) for key in TUNED}


def rule(job: Job, prepared: MetaParameters, theta: Params, steps: int) -> UpdateRule:
    """The recipe's Adam, or the one that was tuned on this data's validation tasks."""
    tuned = {key: float(value) for key, value in prepared.alpha.items()}
    return fixed_adam(Adam(**tuned) if tuned else job.recipe.quickft, theta, steps)


QUICKFT = Paradigm(name="quickft", needs=GENERAL.needs, start=start, rule=rule, steps=lambda recipe: recipe.steps)
