"""QuickFT: General's result, then Adam at a raised rate for Meta's number of steps."""

from __future__ import annotations

import torch

from metapp.learning.adjoint import UpdateRule
from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import Adam
from metapp.learning.rules import fixed_adam
from metapp.learning.task import Params, Tasks
from metapp.paradigms.general import GENERAL, start
from metapp.paradigms.paradigm import Given, Job, Paradigm, Report
from metapp.paradigms.resuming import Keep, Prepared, Reached, forget
from metapp.paradigms.tuning import search, to_tune_on

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
        A checkpoint whose alpha holds Adam's settings, scalars on the CPU, and the encoder that they were tuned for.

    Raises:
        Interrupted: Ctrl-C; carries the best settings so far.
    """

    def start_of(adam: Adam) -> MetaParameters:
        return encoder._replace(alpha=to_alpha(adam))

    return search(QUICKFT, job, job.recipe.quickft, start_of, tasks, report, looks, since, keep)


def prepare(job: Job, given: Given) -> Prepared:
    """Search the Adam that goes on from General's encoder."""
    assert given.encoder is not None
    few = to_tune_on(job, given.to_validate)
    return tune_quickft(job, given.encoder, few, given.report, given.steps, given.since, given.keep)


QUICKFT = Paradigm(
    name="quickft",
    needs=lambda job: (*GENERAL.needs(job), "quickft"),
    start=start,
    rule=rule,
    steps=lambda recipe: recipe.steps,
    prepare=prepare,
    adam=adam_of,
)
