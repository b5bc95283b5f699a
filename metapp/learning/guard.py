"""The guard of learned rules: plain Adam goes on from a doubtful fit or its initialisation, whichever is better.

A learned rule promises nothing on a task unlike its training tasks. Safeguarded learned optimisation (Heaton et al.
2023) keeps a learned step if the loss falls, and replaces it by a plain step otherwise. Here a whole fit is judged, at
its end. The guard sees nothing but what the fit itself may observe.
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
    """Descend by a learned rule, then by Adam where a fit is doubtful, and keep the lowest loss of each task.

    The initialisation, the rule's result and Adam's result are compared by the plain loss on one batch, so that no
    result looks better because of its samples or because of learned loss parameters.

    Args:
        params: the initialisations, [T, ...].
        rule: the learned rule.
        tasks: T tasks.
        loss: the loss that the rule descends; each task has parameters for itself.
        rng: the source of the rule's random numbers, one for all tasks or one for each; the guard draws from copies.
        guard: which fits are doubtful, and the Adam that continues them.
        steps: the number of the rule's steps, and of Adam's.
        steps_of: a function that makes the steps of a rule; see :func:`metapp.learning.adjoint.torch_steps`.

    Yields:
        The states of the rule's descent, then one more state with the results.

    Raises:
        FloatingPointError: the loss of an initialisation is not finite.
    """
    batch = loss.draw(tasks, clone_rng(rng), 1.0).batch

    def plain_loss(theta: Params) -> Tensor:
        """Return the loss [T] on the common batch, without learned loss parameters; infinite if it is not finite."""
        with torch.no_grad():
            return loss.value(theta, batch, {}).nan_to_num(math.inf, math.inf, math.inf)

    losses: list[Tensor] = []
    for state in check_finite_losses(
        descend(params, rule, tasks, loss, steps=steps, rng=rng, steps_of=steps_of), every=0
    ):
        losses += [] if state.loss is None else [state.loss]
        yield state
    first_loss, rule_loss = plain_loss(params), plain_loss(state.theta)
    best, lowest = _select_lower(state.theta, rule_loss, params, first_loss)
    doubtful = ~(rule_loss <= guard.max_loss_share * first_loss)
    if math.isfinite(guard.max_rise_factor):
        doubtful |= _find_rising(losses, guard.max_rise_factor)
    if rows := doubtful.nonzero()[:, 0].tolist():
        theta = {key: value[rows] for key, value in best.items()}
        adam = fixed_adam(guard.adam, theta, steps)
        # a rule such as `solve` follows other things than the gradient, Adam does not
        gradient_loss = Loss(loss.draw, loss.value)
        adam_rng = clone_rng(rng)
        adam_rng = tuple(adam_rng[row] for row in rows) if isinstance(adam_rng, tuple) else adam_rng
        continued = final_item(
            descend(theta, adam, tasks.select(rows), gradient_loss, steps=steps, rng=adam_rng, steps_of=steps_of)
        ).theta
        continued = {key: value.index_put((doubtful,), continued[key]) for key, value in best.items()}
        best, lowest = _select_lower(best, lowest, continued, plain_loss(continued))
    yield state._replace(theta=best, guarded=lowest < rule_loss)


def _find_rising(losses: list[Tensor], factor: float) -> Tensor:
    """Return which fits rise in the second half of their steps, bool [T].

    A fit rises if a loss exceeds `factor` times the lowest loss before it. The first half is not looked at: learned
    rules often climb early, on their way to something better.
    """
    curves = torch.stack(losses)
    above = curves[1:] > factor * curves.cummin(0).values[:-1]
    return above[max(len(losses) // 2 - 1, 0) :].any(0)


def _select_lower(theta: Params, loss: Tensor, other: Params, other_loss: Tensor) -> tuple[Params, Tensor]:
    """Select the parameters and the loss with the lower loss, task by task.

    Args:
        theta: parameters [T, ...], which are selected where losses are equal.
        loss: their loss [T].
        other: other parameters [T, ...].
        other_loss: the loss [T] of the other parameters.

    Returns:
        The selected parameters [T, ...], and their loss [T].
    """
    is_lower = other_loss < loss
    lower = {key: torch.where(append_axes(is_lower, value), other[key], value) for key, value in theta.items()}
    return lower, torch.where(is_lower, other_loss, loss)
