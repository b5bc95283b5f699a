"""The state of a preparation: one that was cut off goes on from it and ends as if it had not been."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from metapp.learning.learn import MetaParameters, Step


class TrainState(NamedTuple):
    """The best phi so far, how it came about, and all that the rest of a preparation depends on.

    What comes before its search and its outer steps is done again from the seed.

    Attributes:
        errors: validation errors of the Adams that a search has tried so far, in its order.
        outer: where the outer loop is; None before it begins.
        rng: the state of its generator, uint8; None before the outer loop.
        losses: training losses since the last validation, scalars.
        phi: the best state on the validation tasks.
        validation: its mean error there, as the table prints it; infinite before the first validation.
        best_step: the outer step, or the Adam tried, that it was reached at.
        curve: (step, mean training loss since the last entry, validation error), both as the table prints errors; None
            where there was no training yet.
        done, total: steps of the outer loop, or Adams tried, of so many.
        note: about the validation that was just made; "" where none was.
    """

    errors: tuple[float, ...] = ()
    outer: Step | None = None
    rng: Tensor | None = None
    losses: tuple[Tensor, ...] = ()
    phi: MetaParameters = MetaParameters()
    validation: float = float("inf")
    best_step: int = 0
    curve: tuple[tuple[int, float | None, float], ...] = ()
    done: int = 0
    total: int = 0
    note: str = ""
