"""Tasks for the tests of learning."""

from collections.abc import Callable

import pytest
import torch
from torch import Generator, Tensor

from metapp.learning.task import Tasks
from tests.learning.parabolas import NAMES


@pytest.fixture
def tasks(rng: Generator) -> Tasks:
    """Parabolas about five centres, float64."""
    centres = torch.randn(len(NAMES), 3, generator=rng, dtype=torch.float64)
    return Tasks(NAMES, {"c": centres}, torch.arange(len(NAMES)))


@pytest.fixture
def randn() -> Callable[..., Tensor]:
    """Draws standard normal float64 of a shape."""
    rng = Generator().manual_seed(5)
    return lambda *shape: torch.randn(*shape, generator=rng, dtype=torch.float64)
