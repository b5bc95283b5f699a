"""Fixtures for tests of learning: tasks with parabolas as losses, and random tensors."""

from collections.abc import Callable

import pytest
import torch
from torch import Generator, Tensor

from metapp.learning.task import Tasks
from tests.learning.parabolas import NAMES


@pytest.fixture
def tasks(rng: Generator) -> Tasks:
    """Five tasks, each with the random centre [3] of a parabola, float64."""
    centres = torch.randn(len(NAMES), 3, generator=rng, dtype=torch.float64)
    return Tasks(NAMES, {"c": centres}, torch.arange(len(NAMES)))


@pytest.fixture
def randn() -> Callable[..., Tensor]:
    """Return a function that draws a standard normal float64 tensor of a shape."""
    rng = Generator().manual_seed(5)
    return lambda *shape: torch.randn(*shape, generator=rng, dtype=torch.float64)
