"""Random draws: generators, one for all tasks or one for each, and tensors on their device."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Generator, Tensor

from metapp.learning.task import Params, Tasks

Rng = Generator | tuple[Generator, ...]  # of tasks: one for all, or one for each


def draw_uniform(rng: Generator, *shape: int) -> Tensor:
    """Uniform numbers in [0, 1), of a shape.

    >>> uniform(Generator().manual_seed(0), 2)
    tensor([0.4963, 0.7682])
    """
    return torch.rand(shape, generator=rng, device=rng.device)


def draw_normal(rng: Generator, *shape: int) -> Tensor:
    """Standard normal numbers, of a shape.

    >>> normal(Generator().manual_seed(0), 2)
    tensor([ 1.5410, -0.2934])
    """
    return torch.randn(shape, generator=rng, device=rng.device)


def draw_per_task(draw: Callable[[Tasks, Generator], Params], tasks: Tasks, rng: Rng) -> Params:
    """Tensors [T, ...] drawn for T tasks; with a generator for each, none depends on the other tasks.

    Args:
        draw: (tasks, generator) -> tensors [T, ...].
        tasks: T of them.
        rng: one generator, or one for each task.

    >>> tasks = Tasks(("gold", "chalk"), {}, torch.arange(2))
    >>> rng = tuple(Generator().manual_seed(0) for _ in range(2))
    >>> draw_per_task(lambda tasks, rng: {"x": uniform(rng, len(tasks))}, tasks, rng)
    {'x': tensor([0.4963, 0.4963])}
    """
    if isinstance(rng, Generator):
        return draw(tasks, rng)
    draws = [draw(tasks.select([i]), own) for i, own in enumerate(rng)]
    return {key: torch.cat([part[key] for part in draws]) for key in draws[0]}


def clone_rng(rng: Rng) -> Rng:
    """Copies of generators, in the same state.

    >>> rng = Generator().manual_seed(0)
    >>> bool(uniform(clone_rng(rng), 1) == uniform(rng, 1))
    True
    """
    if isinstance(rng, Generator):
        return Generator(rng.device).set_state(rng.get_state())
    return tuple(Generator(own.device).set_state(own.get_state()) for own in rng)
