"""What a preparation leads to, and how far it is: one that was cut off goes on and ends as if it had not been."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from torch import Tensor

from metapp.learning.learn import MetaParameters, Progress


class Prepared(NamedTuple):
    """A trained start and how it came about.

    Attributes:
        start: the best state on the validation tasks.
        validation: its mean error there, as the table prints it.
        step: the outer step it was reached at.
        curve: (step, mean training loss since the last entry, validation error), both as the table prints errors; None
            where there was no training yet.
    """

    start: MetaParameters
    validation: float
    step: int
    curve: list[tuple[int, float | None, float]]


class Interrupted(KeyboardInterrupt):
    """Training was interrupted; carries what it had reached."""

    def __init__(self, prepared: Prepared) -> None:
        super().__init__()
        self.prepared = prepared


class Outer(NamedTuple):
    """Where the outer steps are, before one of them.

    Attributes:
        progress: parameters and the state of their rule.
        rng: the state of the generator, uint8.
        best: the best state so far and the curve.
        losses: training losses since the last look at validation tasks, scalars.
    """

    progress: Progress
    rng: Tensor
    best: Prepared
    losses: tuple[Tensor, ...]


class Reached(NamedTuple):
    """How far a preparation is; what comes before its search and its outer steps is done again from the seed.

    Attributes:
        looks: the errors that a search has found so far, in its order.
        outer: where the outer steps are; None before the first.
    """

    looks: tuple[float, ...] = ()
    outer: Outer | None = None


Keep = Callable[[Reached], object]


def forget(reached: Reached) -> None:
    """A Keep that keeps nothing."""
