"""The guard of learned rules: a fit that fails goes on by a plain Adam.

A learned rule promises nothing on a task unlike those that it was trained on. Safeguarded learned optimisation (Heaton
et al. 2023) keeps a learned step if the loss falls, and falls back to a plain one where it does not.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import torch
from torch import Tensor

from metapp.learning.adjoint import Loss, StepsOf, UpdateRule, torch_steps
from metapp.learning.learn import DescentState, check_finite_losses, descend, final_item
from metapp.learning.random_tensors import Rng, clone_rng
from metapp.learning.recipe import Guard
from metapp.learning.rules import append_axes, fixed_adam
from metapp.learning.task import Params, Tasks


def descend_with_guard(
    params: Params,
    rule: UpdateRule,
    tasks: Tasks,
    loss: Loss,
    *,
    rng: Rng,
    guard: Guard,
    steps: int,
    steps_of: StepsOf = torch_steps,
) -> Iterator[DescentState]:
    """Steps of a learned rule, then of Adam for doubtful fits; the result has the lowest visible loss of each task.

    The initialisation, the rule's result and Adam's result are compared on one batch, by the plain loss: neither other
    samples nor learned loss parameters make one look better.

    Args:
        params: the initialisations, [T, ...].
        rule: the learned rule.
        tasks: T of them.
        loss: of the rule's steps; each task has its own parameters.
        rng: source of the rule's draws, one for all tasks or one for each; the guard draws from copies.
        guard: which fits are doubtful, and their Adam.
        steps: number of the rule's steps, and of Adam's.
        steps_of: maker of the steps.

    Yields:
        The rule's steps, then one more with the result.

    Raises:
        FloatingPointError: the loss of an initialisation is not finite.
    """
    batch = loss.draw(tasks, clone_rng(rng), 1.0).batch

    def visible(theta: Params) -> Tensor:
        with torch.no_grad():
            return loss.value(theta, batch, {}).nan_to_num(math.inf, math.inf, math.inf)

    losses: list[Tensor] = []
    for end in check_finite_losses(
        descend(params, rule, tasks, loss, steps=steps, rng=rng, steps_of=steps_of), every=0
    ):
        losses += [] if end.loss is None else [end.loss]
        yield end
    first, after = visible(params), visible(end.theta)
    best, lowest = _lower(end.theta, after, params, first)
    doubtful = ~(after <= guard.fall * first)
    if math.isfinite(guard.rise):
        doubtful |= _rises(losses, guard.rise)
    if rows := doubtful.nonzero()[:, 0].tolist():
        theta = {key: value[rows] for key, value in best.items()}
        adam = fixed_adam(guard.adam, theta, steps)
        plain = Loss(loss.draw, loss.value)  # Adam follows the gradient, whatever the rule follows
        own = clone_rng(rng)
        own = tuple(own[row] for row in rows) if isinstance(own, tuple) else own
        further = final_item(
            descend(theta, adam, tasks.select(rows), plain, steps=steps, rng=own, steps_of=steps_of)
        ).theta
        further = {key: value.index_put((doubtful,), further[key]) for key, value in best.items()}
        best, lowest = _lower(best, lowest, further, visible(further))
    yield end._replace(theta=best, guarded=lowest < after)


def _rises(losses: list[Tensor], factor: float) -> Tensor:
    """Losses that rise, in the second half of the steps, above so many times the lowest before, bool [T].

    Learned rules often climb early, on their way to something better.
    """
    stacked = torch.stack(losses)
    above = stacked[1:] > factor * stacked.cummin(0).values[:-1]
    return above[max(len(losses) // 2 - 1, 0) :].any(0)


def _lower(theta: Params, loss: Tensor, other: Params, other_loss: Tensor) -> tuple[Params, Tensor]:
    """The parameters and loss [T] of the lower loss, task by task; the first if they are equal."""
    wins = other_loss < loss
    lower = {key: torch.where(append_axes(wins, value), other[key], value) for key, value in theta.items()}
    return lower, torch.where(wins, other_loss, loss)
