"""QuickFT: General's result, then Adam at a raised rate for Meta's number of steps."""

from __future__ import annotations

from collections.abc import Iterator

import torch

from metapp.learning.learn import MetaParameters
from metapp.learning.progress import Progress
from metapp.learning.recipe import Adam
from metapp.learning.task import Params
from metapp.paradigms.general import GENERAL, beginning
from metapp.paradigms.paradigm import Job, TrainingData, by_adam
from metapp.paradigms.tuning import search

TUNED = ("rate", "beta1", "beta2", "eps", "final")


def to_alpha(settings: Adam) -> Params:
    """Adam's settings as a checkpoint of QuickFT stores them, scalars."""
    return {key: torch.tensor(getattr(settings, key), dtype=torch.float64) for key in TUNED}


def adam_of(job: Job, prepared: MetaParameters) -> Adam:
    """The Adam that was tuned on this data's validation tasks, else the recipe's."""
    tuned = {key: float(value) for key, value in prepared.alpha.items()}
    return Adam(**tuned) if tuned else job.recipe.quickft


def prepare(job: Job, data: TrainingData) -> Iterator[Progress]:
    """Search QuickFT's Adam on validation tasks: a win over a badly tuned baseline is no win.

    What it prepares: alpha holds Adam's settings, scalars on the CPU, beside the encoder that they were tuned for.
    """
    encoder = data.encoder
    assert encoder is not None
    return search(QUICKFT, job, job.recipe.quickft, lambda adam: encoder._replace(alpha=to_alpha(adam)), data)


QUICKFT = GENERAL._replace(
    name="quickft",
    initialisation=beginning,
    needs=lambda job: (*GENERAL.needs(job), "quickft"),
    rule=by_adam(adam_of),
    steps=lambda recipe: recipe.steps,
    prepare=prepare,
    adam=adam_of,
)
