"""Steps of update rules on given gradients, and what they leave."""

from __future__ import annotations

import torch

from metapp.learning.adjoint import UpdateRule, at_step
from metapp.learning.task import Params

STEPS = 12


def run(rule: UpdateRule, theta: Params, grads: list[Params]) -> list[Params]:
    """The parameters after each step."""
    state, path = rule.init(theta), []
    for i, grad in enumerate(grads):
        theta, state = rule.step(at_step(rule.alpha, i), theta, grad, state)
        path.append(theta)
    return path


def assert_same(actual: list[Params], expected: list[Params]) -> None:
    # rates and betas are float32
    for i, (one, other) in enumerate(zip(actual, expected, strict=True)):
        for key, value in other.items():
            assert torch.allclose(one[key], value, rtol=1e-5, atol=1e-7), f"step {i}, {key}"


def assert_equal(actual: list[Params], expected: list[Params]) -> None:
    """To the last bit."""
    for i, (one, other) in enumerate(zip(actual, expected, strict=True)):
        for key, value in other.items():
            assert torch.equal(one[key], value), f"step {i}, {key}"


def one_task(theta: Params) -> Params:
    """Parameters, or gradients, of the first task, without task axis."""
    return {key: value[0] for key, value in theta.items()}
