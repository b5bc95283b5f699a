"""The guard of learned rules: a fit that fails goes on from its best iterate by a plain Adam.

A learned rule promises nothing on a task unlike those that it was trained on. Safeguarded learned optimisation (Heaton
et al. 2023) keeps what it does where the loss falls, and falls back to a rule that descends where it does not.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import torch
from torch import Tensor

from metapp.learning.adjoint import Loss, UpdateRule
from metapp.learning.deadline import Deadline
from metapp.learning.draws import Rng, copied, picked
from metapp.learning.learn import Watch, learn
from metapp.learning.recipe import Adam, Guard
from metapp.learning.rules import fixed_adam, like
from metapp.learning.task import Params, Tasks


class Guarded(NamedTuple):
    """Fits, and on which tasks the guard acted.

    Attributes:
        theta: the parameters, [T, ...].
        acted: bool [T]: whether they are not what the rule itself gave.
    """

    theta: Params
    acted: Tensor


class Seen(NamedTuple):
    """An iterate and its visible loss, [T]; infinite where it is not finite."""

    theta: Params
    loss: Tensor


class Path:
    """What a descent passes: the parameters before its last step, and the loss of each task before each step."""

    def __init__(self, start: Params) -> None:
        self.before = start
        self.losses: list[Tensor] = []

    def watch(self, step: int, theta: Params, loss: Tensor) -> None:
        """Keep what `learn` tells."""
        self.before = theta
        self.losses.append(loss)

    def rises(self, factor: float) -> Tensor:
        """Whether losses rise, in the second half of the steps, above so many times the lowest before them, [T].

        Learned rules often climb early, on their way to something better.
        """
        losses = torch.stack(self.losses)
        above = losses[1:] > factor * losses.cummin(0).values[:-1]
        return above[max(len(losses) // 2 - 1, 0) :].any(0)


def unguarded(theta: Params) -> Guarded:
    """Fits that need no guard, or have none."""
    first = next(iter(theta.values()))
    return Guarded(theta, torch.zeros(len(first), dtype=torch.bool, device=first.device))


def learn_guarded(
    params: Params,
    rule: UpdateRule,
    tasks: Tasks,
    loss: Loss,
    *,
    steps: int,
    rng: Rng,
    guard: Guard,
    watch: Watch | None = None,
    deadline: Deadline | None = None,
) -> Guarded:
    """Descend by a learned rule; where that fails, go on by Adam, and keep what has the lowest visible loss.

    A task's iterates are compared on one batch, the first step's, by the plain loss: neither other samples nor learned
    loss parameters make one look better. Nothing depends on the data but whether there are doubtful tasks at the end.

    Args:
        params: the initialisations, [T, ...].
        rule: the learned rule.
        tasks: T of them.
        loss: what to descend; each task has its own parameters.
        steps: of the rule, and of Adam on doubtful tasks.
        rng: source of the rule's draws, one for all tasks or one for each; the guard draws from copies.
        guard: which fits are doubtful, and the Adam that these go on by.
        watch: as of `learn`, of the rule's steps.
        deadline: of all steps, if there is one.

    Raises:
        FloatingPointError: the loss of an initialisation is not finite.
    """
    judged, path = loss.draw(tasks, copied(rng)).batch, Path(params)

    def look(step: int, theta: Params, value: Tensor) -> None:
        path.watch(step, theta, value)
        if watch is not None:
            watch(step, theta, value)

    def seen(theta: Params) -> Seen:
        with torch.no_grad():
            return Seen(theta, loss.value(theta, judged, {}).nan_to_num(math.inf, math.inf, math.inf))

    enough = deadline.reached if deadline else None
    found = learn(params, rule, tasks, loss, steps=steps, rng=rng, watch=look, check_every=0, enough=enough)
    if not path.losses:  # there was no time for a step
        return unguarded(params)
    last = seen(found)
    comparable = loss.stage(tasks, 0.0) is tasks and not any(key.startswith("loss.") for key in rule.alpha)
    first = Seen(params, path.losses[0]) if comparable else seen(params)
    candidates, doubtful = [last, first], ~(last.loss <= guard.fall * first.loss)
    if math.isfinite(guard.rise):
        candidates.append(seen(path.before))
        doubtful |= path.rises(guard.rise) | (candidates[-1].loss < last.loss)
    rows = doubtful.nonzero()[:, 0]
    if not len(rows):
        return Guarded(last.theta, doubtful)
    best = functools.reduce(_lower, candidates)
    further = _by_adam(guard.adam, best.theta, rows, tasks, loss, steps, picked(copied(rng), rows), deadline)
    best = _lower(best, seen(further))
    return Guarded(best.theta, best.loss < last.loss)


def _by_adam(
    adam: Adam,
    theta: Params,
    rows: Tensor,
    tasks: Tasks,
    loss: Loss,
    steps: int,
    rng: Rng,
    deadline: Deadline | None,
) -> Params:
    """Parameters [T, ...] of which those of some tasks, `rows`, went on by a plain Adam."""
    some, steps = {key: value[rows] for key, value in theta.items()}, deadline.plan(steps) if deadline else steps
    rule = fixed_adam(adam, some, steps)
    enough = deadline.reached if deadline else None
    further = learn(some, rule, tasks.select(rows), loss, steps=steps, rng=rng, check_every=0, enough=enough)
    return {key: value.index_copy(0, rows, further[key]) for key, value in theta.items()}


def _lower(one: Seen, other: Seen) -> Seen:
    """Of two iterates, task by task, the one with the lower loss; the first where that is the same."""
    wins = other.loss < one.loss
    theta = {key: torch.where(like(wins, value), other.theta[key], value) for key, value in one.theta.items()}
    return Seen(theta, torch.where(wins, other.loss, one.loss))
