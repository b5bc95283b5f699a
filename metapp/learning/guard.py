"""The guard of learned rules: a fit that fails goes on from its best iterate by a plain Adam.

A learned rule promises nothing on a task unlike those that it was trained on. Safeguarded learned optimisation (Heaton
et al. 2023) keeps what it does where the loss falls, and falls back to a rule that descends where it does not.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from metapp.learning.adjoint import AnyBatch, Loss, StepsOf, UpdateRule, torch_steps
from metapp.learning.learn import Step, checked, descend, last
from metapp.learning.recipe import Guard
from metapp.learning.rules import fixed_adam, like
from metapp.learning.task import Params, Rng, Tasks, copied, picked


class Iterate(NamedTuple):
    """Parameters and their visible loss, [T]; infinite where it is not finite."""

    theta: Params
    loss: Tensor


def descend_guarded(
    params: Params,
    rule: UpdateRule,
    tasks: Tasks,
    loss: Loss,
    *,
    rng: Rng,
    guard: Guard,
    steps: int,
    steps_of: StepsOf = torch_steps,
) -> Iterator[Step]:
    """Descend by a learned rule; where that fails, go on by Adam, and keep what has the lowest visible loss.

    A task's iterates are compared on one batch, as the first step's but of all of the data, by the plain loss: neither
    other samples nor learned loss parameters make one look better.

    Args:
        params: the initialisations, [T, ...].
        rule: the learned rule.
        tasks: T of them.
        loss: what the rule descends; each task has its own parameters.
        rng: source of the rule's draws, one for all tasks or one for each; the guard draws from copies.
        guard: which fits are doubtful, and the Adam that these go on by.
        steps: number of the rule's steps, and of Adam's.
        steps_of: what takes the steps.

    Yields:
        The rule's steps, then one with the parameters that are kept.

    Raises:
        FloatingPointError: the loss of an initialisation is not finite.
    """
    judge = functools.partial(_judged, loss, loss.draw(tasks, copied(rng), 1.0).batch)
    before, now = Step(0, params, {}), Step(0, params, {})
    losses: list[Tensor] = []

    def descent(theta: Params, rule: UpdateRule, tasks: Tasks, loss: Loss, rng: Rng) -> Iterator[Step]:
        return checked(descend(theta, rule, tasks, loss, steps=steps, rng=rng, steps_of=steps_of), every=0)

    for after in descent(params, rule, tasks, loss, rng):
        before, now = now, after
        losses += [] if after.loss is None else [after.loss]
        yield after
    candidates = [judge(now.theta), judge(params)]
    doubtful = ~(candidates[0].loss <= guard.fall * candidates[1].loss)
    if math.isfinite(guard.rise):
        candidates.append(judge(before.theta))
        doubtful |= rises(losses, guard.rise) | (candidates[2].loss < candidates[0].loss)
    if rows := doubtful.nonzero()[:, 0].tolist():
        best = functools.reduce(_lower, candidates)
        some = {key: value[rows] for key, value in best.theta.items()}
        adam = fixed_adam(guard.adam, some, steps)
        plain = Loss(loss.draw, loss.value)  # Adam follows the gradient, whatever the rule does
        further = last(descent(some, adam, tasks.select(rows), plain, picked(copied(rng), rows))).theta
        best = _lower(best, judge({k: value.index_put((doubtful,), further[k]) for k, value in best.theta.items()}))
        now, doubtful = now._replace(theta=best.theta), best.loss < candidates[0].loss
    yield now._replace(guarded=doubtful)


def _judged(loss: Loss, batch: AnyBatch, theta: Params) -> Iterate:
    with torch.no_grad():
        return Iterate(theta, loss.value(theta, batch, {}).nan_to_num(math.inf, math.inf, math.inf))


def rises(losses: list[Tensor], factor: float) -> Tensor:
    """Test for losses that rise, in the second half of the steps, above so many times the lowest before them, [T].

    Learned rules often climb early, on their way to something better.
    """
    stacked = torch.stack(losses)
    above = stacked[1:] > factor * stacked.cummin(0).values[:-1]
    return above[max(len(losses) // 2 - 1, 0) :].any(0)


def _lower(one: Iterate, other: Iterate) -> Iterate:
    """Of two iterates, task by task, the one with the lower loss; the first where that is the same."""
    wins = other.loss < one.loss
    theta = {key: torch.where(like(wins, value), other.theta[key], value) for key, value in one.theta.items()}
    return Iterate(theta, torch.where(wins, other.loss, one.loss))
