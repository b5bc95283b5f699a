"""Parameters and noise for the generator that a test file calls NETWORK."""

from __future__ import annotations

import pytest
import torch
from torch import Generator, Tensor

from metapp.learning.task import Params
from tests.networks.precise import double


@pytest.fixture
def theta(request: pytest.FixtureRequest, rng: Generator) -> Params:
    return double(request.module.NETWORK.init(rng, 3))


@pytest.fixture
def noise(rng: Generator) -> Tensor:
    return torch.randn(3, 2, 2, 16, 24, generator=rng, dtype=torch.float64)
