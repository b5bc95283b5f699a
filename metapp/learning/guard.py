"""The guard of learned rules: a fit that fails goes on from its best iterate by a plain Adam.

A learned rule promises nothing on a task unlike those that it was trained on. Safeguarded learned optimisation (Heaton
et al. 2023) keeps what it does where the loss falls, and falls back to a rule that descends where it does not.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator
from typing import NamedTuple

import torch
from torch import Tensor

from metapp.learning.adjoint import Loss, same
from metapp.learning.draws import Rng, copied, picked
from metapp.learning.learn import Step, checked
from metapp.learning.recipe import Guard
from metapp.learning.rules import like
from metapp.learning.task import Params, Tasks

Fallback = Callable[[Params, Tasks, Rng], Params]


class Iterate(NamedTuple):
    """Parameters and their visible loss, [T]; infinite where it is not finite."""

    theta: Params
    loss: Tensor


def guarded(
    descent: Iterator[Step], tasks: Tasks, loss: Loss, rng: Rng, *, guard: Guard, comparable: bool, fallback: Fallback
) -> Iterator[Step]:
    """Descend by a learned rule; where that fails, go on by Adam, and keep what has the lowest visible loss.

    A task's iterates are compared on one batch of all of the data, by the plain loss: neither other samples nor learned
    loss parameters make one look better. Nothing depends on the data but whether there are doubtful tasks at the end.

    Args:
        descent: the rule's, not begun.
        tasks: T of them.
        loss: what it descends; each task has its own parameters.
        rng: source of its draws, one for all tasks or one for each; the guard draws from copies.
        guard: which fits are doubtful.
        comparable: whether the first step's loss is the plain one, on a batch of all of the data.
        fallback: (parameters, tasks, rng) of doubtful fits -> parameters after further steps by a plain Adam.

    Yields:
        The descent's steps, then one with the parameters that are kept.

    Raises:
        FloatingPointError: the loss of an initialisation is not finite.
    """
    judged = loss.draw(tasks, copied(rng), 1.0).batch

    def judge(theta: Params) -> Iterate:
        with torch.no_grad():
            return Iterate(theta, loss.value(theta, judged, {}).nan_to_num(math.inf, math.inf, math.inf))

    descent = checked(descent, every=0)
    first = before = now = next(descent)
    losses: list[Tensor] = []
    yield first
    for after in descent:
        assert after.loss is not None
        before, now = now, after
        losses.append(after.loss)
        yield now
    if not losses:  # there was no time for a step
        return
    final = judge(now.theta)
    initial = Iterate(first.theta, losses[0]) if comparable else judge(first.theta)
    candidates, doubtful = [final, initial], ~(final.loss <= guard.fall * initial.loss)
    if math.isfinite(guard.rise):
        candidates.append(judge(before.theta))
        doubtful |= rises(losses, guard.rise) | (candidates[-1].loss < final.loss)
    rows = doubtful.nonzero()[:, 0]
    if not len(rows):
        yield now._replace(guarded=doubtful)
        return
    best = functools.reduce(_lower, candidates)
    some = {key: value[rows] for key, value in best.theta.items()}
    further = fallback(some, tasks.select(rows), picked(copied(rng), rows))
    best = _lower(best, judge({key: value.index_copy(0, rows, further[key]) for key, value in best.theta.items()}))
    yield now._replace(packed=best.theta, unpack=same, guarded=best.loss < final.loss)


def rises(losses: list[Tensor], factor: float) -> Tensor:
    """Whether losses rise, in the second half of the steps, above so many times the lowest before them, [T].

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
