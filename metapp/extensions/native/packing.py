"""The arguments of steps in C: flat parameters theta [T, P], and a rule's hyperparameters in few tensors.

Packing is differentiable, so that gradients of packed tensors go back to each parameter and hyperparameter. This module
knows which parts of rules have a form in C, but not the C library. Shapes: T tasks, P numbers of a task's parameters,
K steps that have hyperparameters of their own.
"""

from __future__ import annotations

import functools
import math
from collections import UserDict
from collections.abc import Sequence
from typing import Any, cast

import torch
from torch import Tensor
from typing_extensions import override

from metapp.learning.adjoint import RuleStep
from metapp.learning.rules import META_EPS, LearnedRule, Part
from metapp.learning.rules.descent import AdamStep, sgd_step
from metapp.learning.rules.parts import AdamDirections, Curvature, LossParameters, Rates
from metapp.learning.task import Params

# parts of learned rules that have a form in C
C_RULE_PARTS = (Rates, AdamDirections, LossParameters, Curvature)


class FlatParameters(UserDict[str, Tensor]):
    """A dictionary of parameters [T, ...] that lie side by side in one tensor; views are made when first read.

    Attributes:
        parameter_order: the order and shapes of the parameters in the tensor.
        flat: the tensor, [T, P], dense.
    """

    def __init__(self, parameter_order: ParameterOrder, flat: Tensor) -> None:
        self.parameter_order, self.flat = parameter_order, flat

    @override
    def __or__(self, other: Any) -> Any:
        """Return a plain dictionary of these parameters and others, which win."""
        return {**self.data, **other}

    @override
    def __ror__(self, other: Any) -> Any:
        """Return a plain dictionary of other parameters and these, which win."""
        return {**other, **self.data}

    @functools.cached_property
    @override
    def data(self) -> Params:  # type: ignore[override]
        """The parameters by name, [T, ...], views of the flat tensor."""
        columns = self.flat.split(list(self.parameter_order.sizes.values()), 1)
        named_shapes = self.parameter_order.shapes.items()
        return {name: values.view(-1, *shape) for (name, shape), values in zip(named_shapes, columns, strict=True)}


class ParameterOrder:
    """The order and the shapes of one task's parameters in a flat theta.

    Args:
        theta: parameters [T, ...], whose names, order and shapes count.

    Attributes:
        shapes: the shape of each parameter, without the task axis.
        sizes: the number of numbers of each parameter.
        size: the number of numbers of all parameters, P.
    """

    def __init__(self, theta: Params) -> None:
        self.shapes = {key: tuple(value.shape[1:]) for key, value in theta.items()}
        self.sizes = {key: math.prod(shape) for key, shape in self.shapes.items()}
        self.size = sum(self.sizes.values())

    def flatten(self, theta: Params) -> Tensor:
        """Return parameters [T, ...] side by side in one dense tensor [T, P]."""
        flat: Tensor | None = getattr(theta, "flat", None)
        return torch.cat([theta[key].flatten(1) for key in self.shapes], 1) if flat is None else flat

    def unflatten(self, flat: Tensor) -> Params:
        """Return the parameters [T, ...] that lie side by side in a tensor [T, P]."""
        return cast("Params", FlatParameters(self, flat))

    def flatten_weights(self, alpha: Params, prefix: str) -> Tensor:
        """Return hyperparameters that each weight has for itself side by side.

        Args:
            alpha: hyperparameters, `<prefix><parameter>` [K, ...] or [K, T, ...].
            prefix: beginning of their names, such as "rate.".

        Returns:
            One number for each weight, [K, T or 1, P].
        """
        return torch.cat(
            [_add_task_axis(alpha[prefix + key], len(shape)).flatten(2) for key, shape in self.shapes.items()], -1
        )


def pack_hyperparameters(step: RuleStep, alpha: Params, parameter_order: ParameterOrder) -> Params | None:
    """Pack the hyperparameters of a rule into the tensors that steps in C read.

    Args:
        step: the step of the rule.
        alpha: the rule's hyperparameters [K, ...], or [K, T, ...] if each task has its own.
        parameter_order: the order of parameters in a flat theta.

    Returns:
        "rate" [K, T or 1, P or 1]; if the rule has them, "adam" [K, T or 1, 3], both betas and eps; "matrices"
        [K, T or 1, M], the left and the right matrix of each parameter, in order; "loss.<name>". None if the rule does
        more than a step in C can.
    """
    if isinstance(step, LearnedRule):
        has_c_form = all(type(part) in C_RULE_PARTS for part in step.parts)
        return _pack_parts(step.parts, alpha, parameter_order) if has_c_form else None
    if step is sgd_step:
        return _pack_rates(alpha, parameter_order)
    if isinstance(step, AdamStep) and not step.weight_decay:
        beta1, beta2 = (_add_task_axis(alpha[name], 0) for name in ("beta1", "beta2"))
        adam = torch.stack([beta1, beta2, torch.full_like(beta1, step.eps)], -1)
        return _pack_rates(alpha, parameter_order) | {"adam": adam}
    return None


def _add_task_axis(value: Tensor, axes: int) -> Tensor:
    """Return a hyperparameter with a task axis, [K, T, ...], where T is 1 if tasks share the hyperparameter.

    Args:
        value: the hyperparameter, [K, ...] or [K, T, ...].
        axes: the number of its axes beside those of steps and tasks.
    """
    if value.ndim == axes + 1:
        return value.unsqueeze(1)
    return value if value.requires_grad or value.stride(1) else value[:, :1]


def _pack_rates(alpha: Params, parameter_order: ParameterOrder) -> Params:
    """Return the rate of all weights, or the rates that each weight has for itself, as "rate"."""
    is_shared = "rate" in alpha
    rate = _add_task_axis(alpha["rate"], 0)[..., None] if is_shared else parameter_order.flatten_weights(alpha, "rate.")
    return {"rate": rate}


def _pack_parts(parts: Sequence[Part], alpha: Params, parameter_order: ParameterOrder) -> Params:
    """Pack the hyperparameters of a learned rule's parts; loss parameters have a task axis, as always in a step."""
    packed = {key: _add_task_axis(value, value.ndim - 2) for key, value in alpha.items() if key.startswith("loss.")}
    for part in parts:
        if isinstance(part, Rates):
            packed |= _pack_rates_of_form(part.form, alpha, parameter_order)
        elif isinstance(part, AdamDirections):
            betas = [torch.sigmoid(_add_task_axis(alpha[name], 0)) for name in ("beta1", "beta2")]
            is_learned = part.learns_eps
            eps = torch.exp(_add_task_axis(alpha["eps"], 0)) if is_learned else betas[0].new_full((1, 1), META_EPS)
            packed["adam"] = torch.stack([*betas, eps.expand_as(betas[0])], -1)
        elif isinstance(part, Curvature):
            names = (f"{side}.{key}" for key in parameter_order.shapes for side in ("left", "right"))
            matrices = [_add_task_axis(alpha[name], 2).flatten(2) for name in names if name in alpha]
            packed["matrices"] = torch.cat(matrices, -1)
    return packed


def _pack_rates_of_form(form: str, alpha: Params, parameter_order: ParameterOrder) -> Params:
    """Return the rates that a learned rule has for each weight, as "rate"; `form` is the form of :class:`Rates`."""
    if form == "signed":
        return _pack_rates(alpha, parameter_order)
    log_rates = parameter_order.flatten_weights(alpha, "rate.")
    if form == "paced":
        paces = [_add_task_axis(alpha[f"pace.{key}"], 0)[..., None] for key in parameter_order.shapes]
        sizes = parameter_order.sizes.values()
        weight_paces = [pace.expand(-1, -1, size) for pace, size in zip(paces, sizes, strict=True)]
        log_rates = log_rates + torch.cat(weight_paces, -1)
    return {"rate": torch.exp(log_rates)}
