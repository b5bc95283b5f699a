"""Flat parameters theta [T, P], and what a loss and a rule offer to be computed on them by steps in C (`fused`)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import torch
from torch import Tensor

from metapp.learning.task import Params


class Layout(NamedTuple):
    """The order and the shapes of one task's parameters in a flat theta."""

    shapes: tuple[tuple[str, tuple[int, ...]], ...]

    @classmethod
    def of(cls, theta: Params) -> Layout:
        """The layout of parameters [T, ...]."""
        return cls(tuple((key, tuple(value.shape[1:])) for key, value in theta.items()))

    @property
    def sizes(self) -> list[int]:
        """How many numbers each parameter has."""
        return [math.prod(shape) for _, shape in self.shapes]

    def flat(self, theta: Params) -> Tensor:
        """Parameters [T, ...] side by side, [T, P]."""
        return torch.cat([theta[key].flatten(1) for key, _ in self.shapes], 1)

    def tree(self, flat: Tensor) -> Params:
        """The inverse of `flat`; views."""
        parts = flat.split(self.sizes, 1)
        return {key: part.view(-1, *shape) for (key, shape), part in zip(self.shapes, parts, strict=True)}

    def hyperparameters(self, alpha: Params, prefix: str) -> Tensor:
        """One number for each weight, `<prefix><parameter>` [K, ...] or [K, T, ...]: [K, T or 1, P]."""
        return torch.cat([own(alpha[prefix + key], len(shape)).flatten(2) for key, shape in self.shapes], -1)


def own(value: Tensor, axes: int) -> Tensor:
    """A hyperparameter of so many axes, [K, ...] or [K, T, ...], as [K, T, ...], T being 1 where tasks share it."""
    if value.ndim == axes + 1:
        return value.unsqueeze(1)
    return value if value.requires_grad or value.stride(1) else value[:, :1]


class FusedLoss(NamedTuple):
    """A loss of flat parameters theta [T, P], float32, and its derivatives.

    Attributes:
        names: of the parameters, in theta's order.
        gradient: (theta, batch, learned) -> (gradient [T, P], loss of each task [T]).
        product: (theta, batch, learned, along [T, P]) -> the derivatives of the sum of gradient * along in theta, and
            in each learned parameter.
    """

    names: tuple[str, ...]
    gradient: Callable[[Tensor, Any, Params], tuple[Tensor, Tensor]]
    product: Callable[[Tensor, Any, Params, Tensor], tuple[Tensor, Params]]


class Packing(NamedTuple):
    """How steps in C read a rule's hyperparameters.

    Attributes:
        gather: (alpha, layout) -> the same numbers in few tensors [K, T or 1, ...]; None where the rule does more than
            a step in C can.
        quantities: what `gather` gave -> "rate" [K, T or 1, P or 1] and, where the rule has them, "adam"
            [K, T or 1, 3], both betas and eps; "matrices" [K, T or 1, M], each parameter's left and right one, in
            order; "loss.<name>".
    """

    gather: Callable[[Params, Layout], Params | None]
    quantities: Callable[[Params], Params] = lambda gathered: gathered


def no_fused(theta: Params) -> FusedLoss | None:
    """Say that a loss is not to be had in C."""
    return None
