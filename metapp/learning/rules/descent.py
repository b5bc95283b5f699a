"""Descent with nothing learned: SGD, Adam's moments, Adam with fixed settings, and the Adam of the outer loop.

All settings stand in `UpdateRule.alpha` with a leading step axis, so that a schedule of rates, a rate per step and a
learned rate are the same thing.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from metapp.learning.adjoint import UpdateRule
from metapp.learning.flat import Layout, Packing, own
from metapp.learning.recipe import Adam, OuterLoop
from metapp.learning.task import Params


def half_cosine(first: float, steps: int, final: float = 1.0, warmup: int = 0) -> Tensor:
    """Rates [steps]: linear warm-up to `first`, then half a cosine down to `first * final`."""
    i = torch.arange(max(steps, 1), dtype=torch.float32)
    progress = ((i - warmup) / max(steps - warmup, 1)).clamp(0, 1)
    rates = final + (1 - final) * 0.5 * (1 + torch.cos(math.pi * progress))
    return first * rates * ((i + 1) / (warmup + 1)).clamp(max=1)


def fixed_adam(settings: Adam, theta: Params, steps: int) -> UpdateRule:
    """Plain Adam (Kingma & Ba 2015) for Overfit, Finetune and QuickFT."""
    device = next(iter(theta.values())).device
    rate = half_cosine(settings.rate, steps, settings.final).to(device)
    alpha = {"rate": rate, "beta1": _one(settings.beta1, device), "beta2": _one(settings.beta2, device)}
    packing = Packing(functools.partial(_gathered_adam, settings.eps))
    return UpdateRule(alpha, adam_state, _adam_step(settings.eps), packing=packing)


def outer_adam(training: OuterLoop, params: Params) -> UpdateRule:
    """Adam for the outer loop: a rate by part of the tree, warm-up, half-cosine decay, weight decay."""
    device = next(iter(params.values())).device
    alpha = {"beta1": _one(0.9, device), "beta2": _one(0.999, device)}
    for key in params:
        prefix = max((part for part in training.rates if key.startswith(part)), key=len)
        rates = half_cosine(training.rates[prefix], training.steps, training.final, training.warmup)
        alpha[f"rate.{key}"] = rates.to(device)
    return UpdateRule(alpha, adam_state, _adam_step(1e-8, training.decay))


def _one(value: float, device: torch.device) -> Tensor:
    return torch.full((1,), value, device=device)


def like(value: Tensor, other: Tensor) -> Tensor:
    """A tensor of fewer axes, with ones appended so that it broadcasts from the left (the task axis)."""
    return value.reshape(value.shape + (1,) * (other.ndim - value.ndim))


def sgd(alpha: Params) -> UpdateRule:
    """theta -= alpha * gradient; `alpha` holds "rate" for all or "rate.<parameter>" for each, any sign."""
    return UpdateRule(alpha, lambda theta: {}, _sgd_step, packing=Packing(_gathered_rates))


def _sgd_step(alpha: Params, theta: Params, grads: Params, state: Params) -> tuple[Params, Params]:
    return {key: theta[key] - _rate(alpha, key, grads[key]) * grads[key] for key in theta}, state


def _gathered_rates(alpha: Params, layout: Layout) -> Params:
    """Rates as steps in C want them."""
    return {"rate": own(alpha["rate"], 0)[..., None] if "rate" in alpha else layout.hyperparameters(alpha, "rate.")}


def _gathered_adam(eps: float, alpha: Params, layout: Layout) -> Params:
    """Rates, betas and eps as steps in C want them."""
    betas = [own(alpha[name], 0) for name in ("beta1", "beta2")]
    return _gathered_rates(alpha, layout) | {"adam": torch.stack([*betas, torch.full_like(betas[0], eps)], -1)}


def _rate(alpha: Params, key: str, grad: Tensor) -> Tensor:
    return like(alpha[f"rate.{key}"] if f"rate.{key}" in alpha else alpha["rate"], grad)


def adam_state(theta: Params) -> Params:
    """Both moments and the running products of the betas, which may differ from step to step."""
    first = next(iter(theta.values()))
    state = {f"m.{key}": torch.zeros_like(value) for key, value in theta.items()}
    state |= {f"v.{key}": torch.zeros_like(value) for key, value in theta.items()}
    return state | {"product1": first.new_ones(()), "product2": first.new_ones(())}


def adam_directions(
    beta1: Tensor, beta2: Tensor, eps: Tensor | float, grads: Params, state: Params
) -> tuple[Params, Params]:
    """Adam's directions, before any rate, and its moments after that."""
    after = {"product1": state["product1"] * beta1, "product2": state["product2"] * beta2}
    directions = {}
    for key, grad in grads.items():
        b1, b2 = like(beta1, grad), like(beta2, grad)
        first = after[f"m.{key}"] = b1 * state[f"m.{key}"] + (1 - b1) * grad
        second = after[f"v.{key}"] = b2 * state[f"v.{key}"] + (1 - b2) * grad * grad
        unbiased = second / like(1 - after["product2"], grad)
        # the square root has no derivative at 0, where dead units are
        floor = like(eps, grad) if isinstance(eps, Tensor) else eps
        directions[key] = first / like(1 - after["product1"], grad) / ((unbiased + 1e-24).sqrt() + floor)
    return directions, after


def _adam_step(eps: float, decay: float = 0.0) -> Callable[..., Any]:
    def step(alpha: Params, theta: Params, grads: Params, state: Params) -> tuple[Params, Params]:
        if decay:
            grads = {key: grad + decay * theta[key] for key, grad in grads.items()}
        directions, state = adam_directions(alpha["beta1"], alpha["beta2"], eps, grads, state)
        return {key: theta[key] - _rate(alpha, key, d) * d for key, d in directions.items()}, state

    return step
