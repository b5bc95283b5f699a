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

from metapp.learning.adjoint import Loss, StepMaker, UpdateRule, torch_steps
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
    make_steps: StepMaker = torch_steps,
) -> Iterator[DescentState]:
    """Descend by a learned rule, then by Adam where a fit is doubtful, and keep the parameters of the lowest loss.

    A fit is doubtful if the loss of its result is not finite or exceeds `guard.max_loss_share` times the loss of its
    initialisation, or if its loss rose to `guard.max_rise_factor` times the lowest one in the second half of the steps.
    Then Adam takes as many steps again, from the rule's result or the initialisation, whichever has the lower loss. Of
    initialisation, rule's result and Adam's result, each task keeps the one with the lowest loss.

    Losses are compared as plain losses on one batch, so that no result looks better because of its samples or because
    of learned loss parameters. Rises alone are found in the losses that the rule's steps report.

    Args:
        params: the initialisations, [T, ...].
        rule: the learned rule.
        tasks: T tasks.
        loss: the loss that the rule descends; tasks must not share parameters (`loss.shared` is False).
        rng: the source of the rule's random numbers, one for all tasks or one for each; the guard draws from copies.
        guard: the thresholds by which fits are doubtful, and the Adam that continues these.
        steps: the number of the rule's steps, and of Adam's.
        make_steps: a function that makes the steps of a rule; see :func:`metapp.learning.adjoint.torch_steps`.

    Yields:
        The states of the rule's descent, then one more state with the results: `theta` is what each task keeps, and
        `guarded` is True for tasks whose result is not the rule's.

    Raises:
        FloatingPointError: the loss that the rule's first step sees is not finite: the initialisation itself is bad.
            Losses of later steps are not checked, since the guard replaces what has diverged.
    """
    batch = loss.draw(tasks, clone_rng(rng), 1.0).batch

    def plain_loss(theta: Params) -> Tensor:
        """Return the loss [T] on the common batch, without learned loss parameters; infinite if it is not finite."""
        with torch.no_grad():
            return loss.value(theta, batch, {}).nan_to_num(math.inf, math.inf, math.inf)

    losses: list[Tensor] = []
    # `every=0` checks the loss before the first step alone.
    for state in check_finite_losses(
        descend(params, rule, tasks, loss, steps=steps, rng=rng, make_steps=make_steps), every=0
    ):
        losses += [] if state.loss is None else [state.loss]
        yield state
    first_loss, rule_loss = plain_loss(params), plain_loss(state.theta)
    best, lowest = _select_lower(state.theta, rule_loss, params, first_loss)
    doubtful = rule_loss > guard.max_loss_share * first_loss
    if math.isfinite(guard.max_rise_factor):
        doubtful |= _find_rising(losses, guard.max_rise_factor)
    if rows := doubtful.nonzero()[:, 0].tolist():
        theta = {key: value[rows] for key, value in best.items()}
        adam = fixed_adam(guard.adam, theta, steps)
        # The loss of a rule with the part `solve` or `newton` gives steps something else in place of a gradient (normal
        # equations, Gauss-Newton changes). Adam needs the gradient, which a plain loss gives.
        gradient_loss = Loss(loss.draw, loss.value)
        adam_rng = clone_rng(rng)
        adam_rng = tuple(adam_rng[row] for row in rows) if isinstance(adam_rng, tuple) else adam_rng
        continued = final_item(
            descend(theta, adam, tasks.select(rows), gradient_loss, steps=steps, rng=adam_rng, make_steps=make_steps)
        ).theta
        continued = {key: value.index_put((doubtful,), continued[key]) for key, value in best.items()}
        best, lowest = _select_lower(best, lowest, continued, plain_loss(continued))
    yield state._replace(theta=best, guarded=lowest < rule_loss)


def _find_rising(losses: list[Tensor], factor: float) -> Tensor:
    """Find fits whose loss rises in the second half of their steps.

    The loss rises if it exceeds `factor` times the lowest loss before it. Rises in the first half do not count: learned
    rules often climb early, on their way to something better.

    Args:
        losses: the loss [T] before each step.
        factor: the factor by which a loss must exceed the lowest one.

    Returns:
        True for fits whose loss rises, bool [T].
    """
    loss_curves = torch.stack(losses)
    # Row i tells whether the loss before step i + 1 is too high: a loss has none before it at step 0, which has no row.
    is_above = loss_curves[1:] > factor * loss_curves.cummin(0).values[:-1]
    first_row = max(len(losses) // 2 - 1, 0)  # the row of step len(losses) // 2, where the second half begins
    return is_above[first_row:].any(0)


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
