"""The fastest engine there is for a loss and a rule."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

from torch import Tensor

from metapp.engine import in_c
from metapp.engine.compiled import Compiled, can_compile
from metapp.learning.adjoint import Engine, Loss, Stepper, UpdateRule
from metapp.learning.task import Params


@dataclass(frozen=True)
class Fastest(Engine):
    """Steps in C where the loss and the rule are to be had there, else by torch.

    Attributes:
        compiles: whether steps by torch are so many that compiling them pays; without a tool chain they are not.
    """

    compiles: bool = False

    def stepper(self, rule: UpdateRule, loss: Loss, theta: Params, order: int = 1) -> Stepper:
        """Steps in C, else by torch."""
        return in_c.stepper(rule, loss, theta, order) or self.by_torch.stepper(rule, loss, theta, order)

    def value(self, loss: Loss, theta: Params, batch: Any) -> Tensor:
        """A loss [T] in C, else by torch; differentiable once in theta."""
        losses = in_c.value(loss, theta, batch)
        return self.by_torch.value(loss, theta, batch) if losses is None else losses

    @functools.cached_property
    def by_torch(self) -> Engine:
        """What takes all other steps."""
        kind = Compiled if self.compiles and can_compile() else Engine
        return kind(self.tasks_at_once)


FASTEST = Fastest()
