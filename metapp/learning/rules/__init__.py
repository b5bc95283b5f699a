"""Update rules: SGD and Adam with quantities that are fixed or learned, and the table of rules that Meta can learn.

Every quantity stands in `UpdateRule.alpha` with a leading step axis, so that a rate schedule, a rate per step and a
learned rate are the same thing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from metapp.learning.adjoint import UpdateRule
from metapp.learning.app import App
from metapp.learning.recipe import Adam, Training
from metapp.learning.rules.network import move, network_of, networks, no_memory
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
    return UpdateRule(alpha, adam_state, _adam_step(settings.eps))


def outer_adam(training: Training, params: Params) -> UpdateRule:
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


def _like(quantity: Tensor, other: Tensor) -> Tensor:
    """A quantity of fewer axes, with ones appended so that it broadcasts from the left (the task axis)."""
    return quantity.reshape(quantity.shape + (1,) * (other.ndim - quantity.ndim))


def sgd(alpha: Params) -> UpdateRule:
    """theta -= alpha * gradient; `alpha` holds "rate" for all or "rate.<parameter>" for each, any sign."""
    return UpdateRule(alpha, lambda theta: {}, _sgd_step)


def _sgd_step(alpha: Params, theta: Params, grads: Params, state: Params) -> tuple[Params, Params]:
    return {key: theta[key] - _rate(alpha, key, grads[key]) * grads[key] for key in theta}, state


def _rate(alpha: Params, key: str, grad: Tensor) -> Tensor:
    return _like(alpha[f"rate.{key}"] if f"rate.{key}" in alpha else alpha["rate"], grad)


def adam_state(theta: Params) -> Params:
    """Both moments and the running products of the betas, which may differ from step to step."""
    first = next(iter(theta.values()))
    state = {f"m.{key}": torch.zeros_like(value) for key, value in theta.items()}
    state |= {f"v.{key}": torch.zeros_like(value) for key, value in theta.items()}
    return state | {"product1": first.new_ones(()), "product2": first.new_ones(())}


def _adam_directions(
    beta1: Tensor, beta2: Tensor, eps: Tensor | float, grads: Params, state: Params
) -> tuple[Params, Params]:
    after = {"product1": state["product1"] * beta1, "product2": state["product2"] * beta2}
    directions = {}
    for key, grad in grads.items():
        b1, b2 = _like(beta1, grad), _like(beta2, grad)
        first = after[f"m.{key}"] = b1 * state[f"m.{key}"] + (1 - b1) * grad
        second = after[f"v.{key}"] = b2 * state[f"v.{key}"] + (1 - b2) * grad * grad
        unbiased = second / _like(1 - after["product2"], grad)
        # the square root has no derivative at 0, where dead units are
        floor = _like(eps, grad) if isinstance(eps, Tensor) else eps
        directions[key] = first / _like(1 - after["product1"], grad) / ((unbiased + 1e-24).sqrt() + floor)
    return directions, after


def _adam_step(eps: float, decay: float = 0.0) -> Callable:
    def step(alpha: Params, theta: Params, grads: Params, state: Params) -> tuple[Params, Params]:
        if decay:
            grads = {key: grad + decay * theta[key] for key, grad in grads.items()}
        directions, state = _adam_directions(alpha["beta1"], alpha["beta2"], eps, grads, state)
        return {key: theta[key] - _rate(alpha, key, d) * d for key, d in directions.items()}, state

    return step


# Rules that Meta learns


class LearnedRule(NamedTuple):
    """An entry of RULES: what alpha holds at first, and the rule it parametrises.

    Attributes:
        alpha: (application, parameters of one task, steps, first) -> initial quantities [K, ...], which make the rule
            the plain Adam `first` (but for the eps of rules that have none of their own), or SGD of its rate.
        rule: alpha -> UpdateRule.
    """

    alpha: Callable[[App, Params, int, Adam], Params]
    rule: Callable[[Params], UpdateRule]


def _meta_sgd_alpha(app: App, theta: Params, steps: int, first: Adam) -> Params:
    return {f"rate.{key}": torch.full_like(value, first.rate)[None] for key, value in theta.items()}


META_EPS = 1e-6
AVERAGED = 0.4


def _meta_adam_step(alpha: Params, theta: Params, grads: Params, state: Params) -> tuple[Params, Params]:
    beta1, beta2 = torch.sigmoid(alpha["beta1"]), torch.sigmoid(alpha["beta2"])
    rotated = {key: _rotate(alpha, key, grad) for key, grad in grads.items()}
    eps = torch.exp(alpha["eps"]) if "eps" in alpha else META_EPS
    directions, after = _adam_directions(beta1, beta2, eps, rotated, state)
    moved = {}
    for key, direction in directions.items():
        if f"left.{key}" in alpha:
            direction = alpha[f"left.{key}"] @ direction
        if f"right.{key}" in alpha:
            direction = direction @ alpha[f"right.{key}"]
        rate = alpha[f"rate.{key}"]
        if f"pace.{key}" in alpha:
            rate = rate + _like(alpha[f"pace.{key}"], rate)
        # rates are of the axes that bases turn to
        moved[key] = theta[key] - _rotate(alpha, key, torch.exp(rate) * direction, back=True)
        if name := network_of(alpha, key):
            added, after[f"memory.{key}"] = move(alpha, name, theta[key], grads[key], direction, state[f"memory.{key}"])
            moved[key] = moved[key] + added
        if "mean" in alpha:
            before = state[f"mean.{key}"]
            after[f"mean.{key}"] = torch.lerp(before, moved[key], _like(alpha["mean"], before))
            moved[key] = torch.lerp(moved[key], after[f"mean.{key}"], _like(alpha["answer"], before))
    return moved, after


def _rotate(alpha: Params, key: str, value: Tensor, *, back: bool = False) -> Tensor:
    """A gradient [T, out, in, ...] in the bases that alpha holds for its first two axes, or back from there."""
    for name, equation in (("out", "{0}ji,{0}j...->{0}i..."), ("in", "{0}ji,{0}kj...->{0}ki...")):
        if f"{name}.{key}" in alpha:
            basis = alpha[f"{name}.{key}"]
            terms = equation.format("t" if basis.ndim == 3 else "")  # where there is a task axis
            value = torch.einsum(terms, basis.mT if back else basis, value)
    return value


def _meta_adam_alpha(app: App, theta: Params, steps: int, first: Adam) -> Params:
    like = next(iter(theta.values()))
    rates = half_cosine(first.rate, steps, first.final).log()
    alpha = {f"rate.{key}": _like(rates, value[None]).repeat(1, *value.shape) for key, value in theta.items()}
    for name in ("beta1", "beta2"):
        beta = getattr(first, name)
        alpha[name] = torch.full((steps,), math.log(beta / (1 - beta)))
    alpha |= {f"loss.{key}": value for key, value in app.loss_parameters(steps).items()}
    return {key: value.to(like) for key, value in alpha.items()}


def _meta_adam_tied_alpha(app: App, theta: Params, steps: int, first: Adam) -> Params:
    alpha = _meta_adam_alpha(app, theta, steps, first)
    paces = half_cosine(1.0, steps, first.final).log()
    for key, value in theta.items():
        alpha[f"rate.{key}"] = alpha[f"rate.{key}"][:1]
        alpha[f"pace.{key}"] = paces.to(value)
    return alpha


def _meta_encoder_alpha(app: App, theta: Params, steps: int, first: Adam) -> Params:
    alpha = _meta_adam_tied_alpha(app, theta, steps, first)
    return alpha | {"eps": alpha["beta1"].new_tensor([math.log(first.eps)])}


def _meta_mean_alpha(app: App, theta: Params, steps: int, first: Adam) -> Params:
    alpha = _meta_encoder_alpha(app, theta, steps, first)
    return alpha | (averaging(steps, alpha["beta1"]) if not app.deterministic else {})


def averaging(steps: int, like: Tensor) -> Params:
    """`mean` and `answer` [steps]: the last step answers with the running mean over the last AVERAGED of the steps."""
    after = torch.arange(steps) - round((1 - AVERAGED) * steps)
    return {
        "mean": (1 / (1 + after).clamp_min(1)).to(like),
        "answer": (torch.arange(steps) == steps - 1).to(like),
    }


def _meta_lgd_alpha(app: App, theta: Params, steps: int, first: Adam) -> Params:
    alpha = _meta_encoder_alpha(app, theta, steps, first)
    learned = networks(theta, steps, first.rate, periodic=app.periodic)
    return alpha | {key: value.to(alpha["beta1"]) for key, value in learned.items()}


def _meta_basis_alpha(app: App, theta: Params, steps: int, first: Adam) -> Params:
    alpha = _meta_mean_alpha(app, theta, steps, first)
    for key, value in theta.items():
        if value.ndim > 1:
            rows, columns = (torch.eye(n).to(value)[None] for n in value.shape[:2])
            alpha |= {f"out.{key}": rows, f"in.{key}": columns}
    return alpha


def second_moments(alpha: Params, grads: Params) -> Params:
    """Sums of products of a step's gradients [T, out, in, ...], for each basis `out.<key>` and `in.<key>` of alpha.

    Each gradient is brought to length 1, so that tasks weigh alike.
    """
    moments = {}
    for name in alpha:
        axis, _, key = name.partition(".")
        if axis in ("out", "in"):
            length = grads[key].flatten(1).norm(dim=1).clamp_min(1e-20)
            unit = grads[key] / length.reshape(-1, *[1] * (grads[key].ndim - 1))
            rows = unit.movedim(1 if axis == "out" else 2, 0).flatten(1)
            moments[name] = rows @ rows.mT
    return moments


def principal_axes(alpha: Params, moments: Params) -> Params:
    """Alpha with its bases turned to the principal axes of gradients, where Adam's entries depend least on each other.

    That is SOAP (Vyas et al. 2024), but for axes that are learned once, on the training tasks, not anew in each fit,
    which has no time for it.
    """
    return alpha | {name: torch.linalg.eigh(value).eigenvectors[None] for name, value in moments.items()}


def _meta_curvature_alpha(app: App, theta: Params, steps: int, first: Adam) -> Params:
    alpha = _meta_adam_alpha(app, theta, steps, first)
    for key, value in theta.items():
        if value.ndim == 2:
            for side, size in zip(("left", "right"), value.shape, strict=True):
                if size > 1:
                    alpha[f"{side}.{key}"] = torch.eye(size).to(value).repeat(steps, 1, 1)
    return alpha


def _meta_adam(alpha: Params) -> UpdateRule:
    def init(theta: Params) -> Params:
        state = adam_state(theta) | no_memory(alpha, theta)
        # not theta: derivatives are not carried through a state's first values, which the first mean forgets anyway
        means = {f"mean.{key}": torch.zeros_like(value) for key, value in theta.items()}
        return state | (means if "mean" in alpha else {})

    return UpdateRule(alpha, init, _meta_adam_step)


RULES: Mapping[str, LearnedRule] = {
    # Li et al. 2017, the paper's rule: one step size a weight, the same at every step, any sign
    "meta-sgd": LearnedRule(_meta_sgd_alpha, sgd),
    # Adam with rates per weight and step, betas per step, and the quantities of the inner loss
    "meta-adam": LearnedRule(_meta_adam_alpha, _meta_adam),
    # the same with one rate per weight for all steps, times one per parameter tensor and step: as small as meta-sgd's
    "meta-adam-tied": LearnedRule(_meta_adam_tied_alpha, _meta_adam),
    # the same with a learned eps, for recipes that start from General's encoder and train it through the steps
    "meta-encoder": LearnedRule(_meta_encoder_alpha, _meta_adam),
    # the same with the mean of the last parameters as the answer, where samples are random, which lets them scatter
    "meta-mean": LearnedRule(_meta_mean_alpha, _meta_adam),
    # meta-encoder, and a convolutional network that adds to the steps of parameters on a grid
    "meta-lgd": LearnedRule(_meta_lgd_alpha, _meta_adam),
    # meta-mean, in the principal axes of the training tasks' gradients
    "meta-basis": LearnedRule(_meta_basis_alpha, _meta_adam),
    # meta-adam, its step multiplied by learned matrices from both sides (Park & Oliva 2019)
    "meta-curvature": LearnedRule(_meta_curvature_alpha, _meta_adam),
}
