"""Rules with nothing learned: SGD, Adam with fixed settings, and the Adam of the outer loop.

All settings are entries of `UpdateRule.alpha` with a leading step axis. A schedule of rates, a rate for each step and
a learned rate are then one thing, which learned rules build on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from metapp.learning.adjoint import UpdateRule
from metapp.learning.recipe import Adam, OuterLoop
from metapp.learning.task import Params


def half_cosine(
    highest_rate: float, steps: int, final_rate_share: float = 1.0, warmup_steps: int = 0, hold_share: float = 0.0
) -> Tensor:
    """Compute rates [steps]: linear warm-up to the highest, a constant part, then half a cosine down to a share of it.

    Args:
        highest_rate: the rate after the warm-up.
        steps: the number of steps.
        final_rate_share: the last rate as a share of the highest.
        warmup_steps: the number of steps of linear warm-up.
        hold_share: the share of the steps before the rate begins to fall.

    >>> half_cosine(1.0, 3, final_rate_share=0.0)
    tensor([1.0000, 0.7500, 0.2500])
    """
    step = torch.arange(max(steps, 1), dtype=torch.get_default_dtype())
    decay_start = max(warmup_steps, round(hold_share * steps))
    progress = ((step - decay_start) / max(steps - decay_start, 1)).clamp(0, 1)
    rates = final_rate_share + (1 - final_rate_share) * 0.5 * (1 + torch.cos(math.pi * progress))
    return highest_rate * rates * ((step + 1) / (warmup_steps + 1)).clamp(max=1)


def fixed_adam(settings: Adam, theta: Params, steps: int) -> UpdateRule:
    """Return a plain Adam (Kingma & Ba 2015), for Overfit, Finetune and QuickFT.

    Args:
        settings: the settings of the Adam.
        theta: parameters, which only tell the device.
        steps: the number of steps, over which the rate falls.

    >>> fixed_adam(Adam(0.1), {"x": torch.zeros(1)}, steps=2).alpha["rate"]
    tensor([0.1000, 0.1000])
    """
    device = next(iter(theta.values())).device
    rate = half_cosine(settings.rate, steps, settings.final_rate_share).to(device)
    alpha = {"rate": rate, "beta1": _constant(settings.beta1, device), "beta2": _constant(settings.beta2, device)}
    return UpdateRule(alpha, adam_state, AdamStep(settings.eps))


def outer_adam(training: OuterLoop, params: Params) -> UpdateRule:
    """Return the Adam of an outer loop, with warm-up, half-cosine decay and weight decay.

    Args:
        training: the settings of the outer loop.
        params: a flat tree of phi; the beginning of a parameter's name selects its rate.
    """
    device = next(iter(params.values())).device
    alpha = {"beta1": _constant(0.9, device), "beta2": _constant(0.999, device)}
    for key in params:
        prefix = max((part for part in training.rates if key.startswith(part)), key=len)
        rates = half_cosine(
            training.rates[prefix],
            training.steps,
            training.final_rate_share,
            training.warmup_steps,
            training.hold_share,
        )
        alpha[f"rate.{key}"] = rates.to(device)
    return UpdateRule(alpha, adam_state, AdamStep(1e-8, training.weight_decay))


def _constant(value: float, device: torch.device) -> Tensor:
    """Return hyperparameters [1] of one value, which all steps share."""
    return torch.full((1,), value, device=device)


def append_axes(value: Tensor, other: Tensor) -> Tensor:
    """Append axes of size 1 to a tensor, so that it broadcasts with `other` from the left (the task axis).

    >>> append_axes(torch.zeros(2), torch.zeros(2, 3, 4)).shape
    torch.Size([2, 1, 1])
    """
    return value.reshape(value.shape + (1,) * (other.ndim - value.ndim))


def sgd(alpha: Params) -> UpdateRule:
    """Return gradient descent, theta -= rate * gradient, with rates of any sign.

    Args:
        alpha: "rate" for all parameters, or "rate.<parameter>" for each.
    """
    return UpdateRule(alpha, lambda theta: {}, sgd_step)


def sgd_step(alpha: Params, theta: Params, grads: Params, state: Params) -> tuple[Params, Params]:
    """Take a step of gradient descent. See :func:`sgd`.

    >>> sgd_step({"rate": torch.tensor(0.5)}, {"x": torch.tensor([1.0])}, {"x": torch.tensor([2.0])}, {})
    ({'x': tensor([0.])}, {})
    """
    return {key: theta[key] - _rate_of(alpha, key, grads[key]) * grads[key] for key in theta}, state


def _rate_of(alpha: Params, key: str, grad: Tensor) -> Tensor:
    """Return the rate of a parameter, with axes appended so that it broadcasts with the gradient."""
    return append_axes(alpha[f"rate.{key}"] if f"rate.{key}" in alpha else alpha["rate"], grad)


def adam_state(theta: Params) -> Params:
    """Return Adam's state before the first step: both moments, and the products of all betas so far.

    The products correct the moments' bias; they are stored because learned betas differ from step to step.

    >>> sorted(adam_state({"x": torch.zeros(1)}))
    ['m.x', 'product1', 'product2', 'v.x']
    """
    first = next(iter(theta.values()))
    state = {f"m.{key}": torch.zeros_like(value) for key, value in theta.items()}
    state |= {f"v.{key}": torch.zeros_like(value) for key, value in theta.items()}
    return state | {"product1": first.new_ones(()), "product2": first.new_ones(())}


def adam_directions(
    beta1: Tensor, beta2: Tensor, eps: Tensor | float, grads: Params, state: Params
) -> tuple[Params, Params]:
    """Compute Adam's normalised directions, before any rate, and Adam's state after this step.

    Args:
        beta1, beta2: the decay factors of the first and the second moment, scalars or [T].
        eps: the number that is added to the root of the second moment, a scalar or [T].
        grads: gradients [T, ...].
        state: the state before this step, from :func:`adam_state`.

    Returns:
        The directions [T, ...], and the new state.
    """
    new_state = {"product1": state["product1"] * beta1, "product2": state["product2"] * beta2}
    shares = beta1, 1 - beta1, 1 - new_state["product1"], beta2, 1 - beta2, 1 - new_state["product2"]
    directions = {}
    for key, grad in grads.items():
        b1, new1, sum1, b2, new2, sum2 = (append_axes(share, grad) for share in shares)
        first = new_state[f"m.{key}"] = b1 * state[f"m.{key}"] + new1 * grad
        second = new_state[f"v.{key}"] = b2 * state[f"v.{key}"] + new2 * grad * grad
        # without 1e-24 the square root has no derivative at 0, which second moments of dead units are
        floor = append_axes(eps, grad) if isinstance(eps, Tensor) else eps
        directions[key] = first / sum1 / ((second / sum2 + 1e-24).sqrt() + floor)
    return directions, new_state


@dataclass(frozen=True)
class AdamStep:
    """The step of Adam, called like `UpdateRule.step`.

    Attributes:
        eps: the number that is added to the root of the second moment.
        weight_decay: weight decay (L2), which is added to the gradient.

    >>> theta, settings = {"x": torch.zeros(1)}, {"beta1": torch.tensor(0.9), "beta2": torch.tensor(0.999)}
    >>> AdamStep(1e-8)({"rate": torch.tensor(0.1), **settings}, theta, {"x": torch.tensor([5.0])}, adam_state(theta))[0]
    {'x': tensor([-0.1000])}
    """

    eps: float
    weight_decay: float = 0.0

    def __call__(self, alpha: Params, theta: Params, grads: Params, state: Params) -> tuple[Params, Params]:
        """Take a step; arguments and results are described at :class:`metapp.learning.adjoint.UpdateRule`."""
        if self.weight_decay:
            grads = {key: grad + self.weight_decay * theta[key] for key, grad in grads.items()}
        directions, state = adam_directions(alpha["beta1"], alpha["beta2"], self.eps, grads, state)
        return {
            key: theta[key] - _rate_of(alpha, key, direction) * direction for key, direction in directions.items()
        }, state
