"""Random generators, one for all tasks or one for each task, and random tensors on the generator's device.

A generator for each task makes a task's fit independent of the tasks that are fitted beside it.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Generator, Tensor

from metapp.learning.task import Params, Tasks

Rng = Generator | tuple[Generator, ...]  # one generator for all tasks, or one for each task


def draw_uniform(rng: Generator, *shape: int) -> Tensor:
    """Draw uniform numbers in [0, 1); the result has the given shape.

    >>> draw_uniform(Generator().manual_seed(0), 2)
    tensor([0.4963, 0.7682])
    """
    return torch.rand(shape, generator=rng, device=rng.device)


def draw_normal(rng: Generator, *shape: int) -> Tensor:
    """Draw standard normal numbers; the result has the given shape.

    >>> draw_normal(Generator().manual_seed(0), 2)
    tensor([ 1.5410, -0.2934])
    """
    return torch.randn(shape, generator=rng, device=rng.device)


def draw_per_task(draw: Callable[[Tasks, Generator], Params], tasks: Tasks, rng: Rng) -> Params:
    """Draw tensors [T, ...] for T tasks.

    With one generator for each task, a task's numbers do not depend on the other tasks.

    Args:
        draw: a function of tasks and one generator that returns tensors [T, ...] by name.
        tasks: T tasks.
        rng: one generator for all tasks, or one for each.

    >>> tasks = Tasks(("gold", "chalk"), {}, torch.arange(2))
    >>> rng = tuple(Generator().manual_seed(0) for _ in range(2))
    >>> draw_per_task(lambda tasks, rng: {"x": draw_uniform(rng, len(tasks))}, tasks, rng)
    {'x': tensor([0.4963, 0.4963])}
    """
    if isinstance(rng, Generator):
        return draw(tasks, rng)
    draws = [draw(tasks.select([row]), generator) for row, generator in enumerate(rng)]
    return {key: torch.cat([tensors[key] for tensors in draws]) for key in draws[0]}


def clone_rng(rng: Rng) -> Rng:
    """Copy generators, so that the copies will draw the numbers that the originals will draw.

    >>> rng = Generator().manual_seed(0)
    >>> bool(draw_uniform(clone_rng(rng), 1) == draw_uniform(rng, 1))
    True
    """
    if isinstance(rng, Generator):
        return Generator(rng.device).set_state(rng.get_state())
    return tuple(Generator(generator.device).set_state(generator.get_state()) for generator in rng)
