"""The arguments of steps in C: flat parameters theta [T, P], and a rule's hyperparameters in few tensors.

All of it is differentiable, so that gradients of packed tensors go back to each parameter and hyperparameter.
"""

from __future__ import annotations

import functools
import math
from collections import UserDict
from typing import Any, cast

import torch
from torch import Tensor

from metapp.learning.adjoint import RuleStep
from metapp.learning.rules import META_EPS, LearnedRule, Part
from metapp.learning.rules.descent import AdamStep, sgd_step
from metapp.learning.rules.parts import (
    Betas,
    Curvature,
    Eps,
    LossParameters,
    Paces,
    Rates,
    SharedRates,
    SignedRates,
)
from metapp.learning.task import Params

C_RULE_PARTS = {SignedRates, Rates, SharedRates, Paces, Betas, Eps, Curvature, LossParameters}  # parts of rules in C


class FlatParameters(UserDict[str, Tensor]):
    """Parameters by name, [T, ...], that lie side by side in one tensor; views of it are made where they are read.

    Attributes:
        flat: the tensor, [T, P], dense.
    """

    def __init__(self, layout: ParameterOrder, flat: Tensor) -> None:
        self.layout, self.flat = layout, flat

    def __or__(self, other: Any) -> Any:
        """A plain dictionary, as of two of these."""
        return {**self.data, **other}

    def __ror__(self, other: Any) -> Any:
        """The same the other way round."""
        return {**other, **self.data}

    @functools.cached_property
    def data(self) -> Params:  # type: ignore[override]
        """The views."""
        parts = self.flat.split(list(self.layout.sizes.values()), 1)
        return {
            key: part.view(-1, *shape) for (key, shape), part in zip(self.layout.shapes.items(), parts, strict=True)
        }


class ParameterOrder:
    """The order and the shapes of one task's parameters in a flat theta.

    Attributes:
        shapes, sizes: of each parameter, and how many numbers it is.
        size: P, the sum of these.
    """

    def __init__(self, theta: Params) -> None:
        """The layout of parameters [T, ...]."""
        self.shapes = {key: tuple(value.shape[1:]) for key, value in theta.items()}
        self.sizes = {key: math.prod(shape) for key, shape in self.shapes.items()}
        self.size = sum(self.sizes.values())

    def flat(self, theta: Params) -> Tensor:
        """Parameters [T, ...] side by side, [T, P], dense."""
        flat: Tensor | None = getattr(theta, "flat", None)
        return torch.cat([theta[key].flatten(1) for key in self.shapes], 1) if flat is None else flat

    def tree(self, flat: Tensor) -> Params:
        """The inverse of `flat`."""
        return cast("Params", FlatParameters(self, flat))

    def weights(self, alpha: Params, prefix: str) -> Tensor:
        """One number for each weight, `<prefix><parameter>` [K, ...] or [K, T, ...]: [K, T or 1, P]."""
        return torch.cat(
            [_by_task(alpha[prefix + key], len(shape)).flatten(2) for key, shape in self.shapes.items()], -1
        )


def packed(step: RuleStep, alpha: Params, layout: ParameterOrder) -> Params | None:
    """A rule's hyperparameters as steps in C read them.

    Args:
        step: of the rule.
        alpha: its hyperparameters [K, ...], or [K, T, ...] if each task has its own.
        layout: of theta.

    Returns:
        "rate" [K, T or 1, P or 1]; if the rule has them, "adam" [K, T or 1, 3], both betas and eps; "matrices"
        [K, T or 1, M], each parameter's left and right one, in order; "loss.<name>". None if the rule does more
        than a step in C can.
    """
    if isinstance(step, LearnedRule):
        parts = {type(part) for part in step.parts}
        return _packed_parts(parts, alpha, layout) if parts <= C_RULE_PARTS else None
    if step is sgd_step:
        return _rates(alpha, layout)
    if isinstance(step, AdamStep) and not step.decay:
        beta1, beta2 = (_by_task(alpha[name], 0) for name in ("beta1", "beta2"))
        return _rates(alpha, layout) | {"adam": torch.stack([beta1, beta2, torch.full_like(beta1, step.eps)], -1)}
    return None


def _by_task(value: Tensor, axes: int) -> Tensor:
    """A hyperparameter of so many axes, [K, ...] or [K, T, ...], as [K, T, ...], T being 1 if tasks share it."""
    if value.ndim == axes + 1:
        return value.unsqueeze(1)
    return value if value.requires_grad or value.stride(1) else value[:, :1]


def _rates(alpha: Params, layout: ParameterOrder) -> Params:
    """One for all, or one for each weight."""
    one = "rate" in alpha
    return {"rate": _by_task(alpha["rate"], 0)[..., None] if one else layout.weights(alpha, "rate.")}


def _packed_parts(parts: set[type[Part]], alpha: Params, layout: ParameterOrder) -> Params:
    """The hyperparameters of a learned rule's parts; loss parameters have a task axis, as always in a step."""
    packed = {key: _by_task(value, value.ndim - 2) for key, value in alpha.items() if key.startswith("loss.")}
    if SignedRates in parts:
        packed |= _rates(alpha, layout)
    if parts & {Rates, SharedRates}:
        logarithms = layout.weights(alpha, "rate.")
        if Paces in parts:
            paces = [_by_task(alpha[f"pace.{key}"], 0)[..., None] for key in layout.shapes]
            sizes = layout.sizes.values()
            wide = [pace.expand(-1, -1, size) for pace, size in zip(paces, sizes, strict=True)]
            logarithms = logarithms + torch.cat(wide, -1)
        packed["rate"] = torch.exp(logarithms)
    if Betas in parts:
        betas = [torch.sigmoid(_by_task(alpha[name], 0)) for name in ("beta1", "beta2")]
        eps = torch.exp(_by_task(alpha["eps"], 0)) if Eps in parts else betas[0].new_full((1, 1), META_EPS)
        packed["adam"] = torch.stack([*betas, eps.expand_as(betas[0])], -1)
    if Curvature in parts:
        names = (f"{side}.{key}" for key in layout.shapes for side in ("left", "right"))
        matrices = [_by_task(alpha[name], 2).flatten(2) for name in names if name in alpha]
        packed["matrices"] = torch.cat(matrices, -1)
    return packed
