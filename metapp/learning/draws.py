"""Random draws of tasks side by side: all from one generator, or each from its own, as if it were alone."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Generator, Tensor

from metapp.learning.task import Params, Tasks

Rng = Generator | tuple[Generator, ...]


def drawn(draw: Callable[[Tasks, Generator], Params], tasks: Tasks, rng: Rng) -> Params:
    """What is drawn for tasks, tensors [T, ...].

    Args:
        draw: (tasks, generator) -> tensors [T, ...].
        tasks: T of them.
        rng: one generator for all, or one for each: then what a task gets does not depend on those beside it.
    """
    if isinstance(rng, Generator):
        return draw(tasks, rng)
    each = [draw(tasks.select([i]), own) for i, own in enumerate(rng)]
    return {key: torch.cat([one[key] for one in each]) for key in each[0]}


def copied(rng: Rng) -> Rng:
    """Generators that go on as these, which stay as they are."""
    if isinstance(rng, Generator):
        return Generator(rng.device).set_state(rng.get_state())
    return tuple(Generator(own.device).set_state(own.get_state()) for own in rng)


def picked(rng: Rng, rows: Tensor) -> Rng:
    """The generators of some tasks; one for all stays."""
    return rng if isinstance(rng, Generator) else tuple(rng[row] for row in rows.tolist())
