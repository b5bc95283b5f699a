"""Descent with nothing learned: SGD, Adam's moments, Adam with fixed settings, and the Adam of the outer loop.

All settings stand in `UpdateRule.alpha` with a leading step axis, so that a schedule of rates, a rate per step and a
learned rate are the same thing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from metapp.learning.adjoint import UpdateRule
from metapp.learning.recipe import Adam, OuterLoop
from metapp.learning.task import Params


def half_cosine(first: float, steps: int, final: float = 1.0, warmup: int = 0, hold: float = 0.0) -> Tensor:
    """Rates [steps]: linear warm-up to `first`, constant for a share `hold` of the steps, then half a cosine down.

    The last rate is near `first * final`.

    >>> half_cosine(1.0, 3, final=0.0)
    tensor([1.0000, 0.7500, 0.2500])
    """
    i = torch.arange(max(steps, 1), dtype=torch.float32)
    decay = max(warmup, round(hold * steps))  # the first step of the decay
    progress = ((i - decay) / max(steps - decay, 1)).clamp(0, 1)
    rates = final + (1 - final) * 0.5 * (1 + torch.cos(math.pi * progress))
    return first * rates * ((i + 1) / (warmup + 1)).clamp(max=1)


def fixed_adam(settings: Adam, theta: Params, steps: int) -> UpdateRule:
    """Plain Adam (Kingma & Ba 2015) for Overfit, Finetune and QuickFT.

    >>> fixed_adam(Adam(0.1), {"x": torch.zeros(1)}, steps=2).alpha["rate"]
    tensor([0.1000, 0.1000])
    """
    device = next(iter(theta.values())).device
    rate = half_cosine(settings.rate, steps, settings.final).to(device)
    alpha = {"rate": rate, "beta1": _one(settings.beta1, device), "beta2": _one(settings.beta2, device)}
    return UpdateRule(alpha, adam_state, AdamStep(settings.eps))


def outer_adam(training: OuterLoop, params: Params) -> UpdateRule:
    """Adam for the outer loop: a rate by part of the tree, warm-up, half-cosine decay, weight decay."""
    device = next(iter(params.values())).device
    alpha = {"beta1": _one(0.9, device), "beta2": _one(0.999, device)}
    for key in params:
        prefix = max((part for part in training.rates if key.startswith(part)), key=len)
        rates = half_cosine(training.rates[prefix], training.steps, training.final, training.warmup, training.hold)
        alpha[f"rate.{key}"] = rates.to(device)
    return UpdateRule(alpha, adam_state, AdamStep(1e-8, training.decay))


def _one(value: float, device: torch.device) -> Tensor:
    return torch.full((1,), value, device=device)


def append_axes(value: Tensor, other: Tensor) -> Tensor:
    """A tensor of fewer axes, with ones appended so that it broadcasts from the left (the task axis).

    >>> append_axes(torch.zeros(2), torch.zeros(2, 3, 4)).shape
    torch.Size([2, 1, 1])
    """
    return value.reshape(value.shape + (1,) * (other.ndim - value.ndim))


def sgd(alpha: Params) -> UpdateRule:
    """theta -= alpha * gradient; `alpha` holds "rate" for all or "rate.<parameter>" for each, any sign."""
    return UpdateRule(alpha, lambda theta: {}, sgd_step)


def sgd_step(alpha: Params, theta: Params, grads: Params, state: Params) -> tuple[Params, Params]:
    """A step of `sgd`.

    >>> sgd_step({"rate": torch.tensor(0.5)}, {"x": torch.tensor([1.0])}, {"x": torch.tensor([2.0])}, {})
    ({'x': tensor([0.])}, {})
    """
    return {key: theta[key] - _rate(alpha, key, grads[key]) * grads[key] for key in theta}, state


def _rate(alpha: Params, key: str, grad: Tensor) -> Tensor:
    return append_axes(alpha[f"rate.{key}"] if f"rate.{key}" in alpha else alpha["rate"], grad)


def adam_state(theta: Params) -> Params:
    """Both moments and the running products of the betas, which may differ from step to step.

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
    """Adam's directions, before any rate, and its moments after that."""
    after = {"product1": state["product1"] * beta1, "product2": state["product2"] * beta2}
    shares = beta1, 1 - beta1, 1 - after["product1"], beta2, 1 - beta2, 1 - after["product2"]
    directions = {}
    for key, grad in grads.items():
        b1, new1, sum1, b2, new2, sum2 = (append_axes(share, grad) for share in shares)
        first = after[f"m.{key}"] = b1 * state[f"m.{key}"] + new1 * grad
        second = after[f"v.{key}"] = b2 * state[f"v.{key}"] + new2 * grad * grad
        # the square root has no derivative at 0, where dead units are
        floor = append_axes(eps, grad) if isinstance(eps, Tensor) else eps
        directions[key] = first / sum1 / ((second / sum2 + 1e-24).sqrt() + floor)
    return directions, after


@dataclass(frozen=True)
class AdamStep:
    """A step of Adam; called as `UpdateRule.step`.

    Attributes:
        eps: added to the root of the second moment.
        decay: weight decay (L2), added to the gradient.

    >>> theta, settings = {"x": torch.zeros(1)}, {"beta1": torch.tensor(0.9), "beta2": torch.tensor(0.999)}
    >>> AdamStep(1e-8)({"rate": torch.tensor(0.1), **settings}, theta, {"x": torch.tensor([5.0])}, adam_state(theta))[0]
    {'x': tensor([-0.1000])}
    """

    eps: float
    decay: float = 0.0

    def __call__(self, alpha: Params, theta: Params, grads: Params, state: Params) -> tuple[Params, Params]:
        """One step."""
        if self.decay:
            grads = {key: grad + self.decay * theta[key] for key, grad in grads.items()}
        directions, state = adam_directions(alpha["beta1"], alpha["beta2"], self.eps, grads, state)
        return {key: theta[key] - _rate(alpha, key, d) * d for key, d in directions.items()}, state
