"""Parameters and gradients that update rules are tested on."""

from __future__ import annotations

import pytest
import torch
from torch import Generator

from metapp.apps.brdf.app import Brdf
from metapp.learning.task import Params
from tests.learning.rules.steps import STEPS, one_task

APP = Brdf()


@pytest.fixture
def theta(rng: Generator) -> Params:
    return {key: value.double() for key, value in APP.init(rng, 2).items()}


@pytest.fixture
def start(theta: Params) -> Params:
    """The parameters of one task, without task axis."""
    return one_task(theta)


@pytest.fixture
def single(grads: list[Params]) -> list[Params]:
    """Its gradients."""
    return [one_task(grad) for grad in grads]


@pytest.fixture
def grads(theta: Params, rng: Generator) -> list[Params]:
    """One gradient a step, magnitudes from 1e-3 to 1e3; some weights never get any."""
    draws = [
        {key: torch.randn(value.shape, generator=rng).double() for key, value in theta.items()} for _ in range(STEPS)
    ]
    for i, draw in enumerate(draws):
        for value in draw.values():
            value *= 10.0 ** (i % 7 - 3)
            value.flatten()[0] = 0.0
    return draws
