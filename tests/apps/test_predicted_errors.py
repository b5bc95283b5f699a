"""The error that General predicts of its maps: a likelihood that has its maximum at the true scale."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Generator

from data_tools.readers.svbrdf_task import svbrdf_task
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary, field_of
from metapp.apps.svbrdf_nonstationary.encoder import BASE, PARTS, scales, surprise
from metapp.learning.app import stack
from metapp.learning.task import Params, Task, Tasks
from tests.apps.test_svbrdf_nonstationary import material

CHANNELS = (3, 3, 1, 3)  # of each map


@pytest.fixture
def app() -> SvbrdfNonstationary:
    return SvbrdfNonstationary(field_of(64, 8), encoder_width=4, sure=True, protocol="photo")


@pytest.fixture
def tasks(app: SvbrdfNonstationary) -> Tasks:
    made: list[Task] = [svbrdf_task(f"made-{i}", material(i, 64)) for i in range(3)]
    return stack(app, made)


def predicted(app: SvbrdfNonstationary, tasks: Tasks, rng: Generator) -> Params:
    return app.encode(app.init_encoder(rng), app.condition(tasks, rng))


def test_the_likelihood_is_greatest_at_the_scale_of_the_differences(rng: Generator) -> None:
    """Differences of a Laplace distribution of scale 0.1: the scale that gradient descent finds is 0.1."""
    uniform = torch.rand(1, sum(CHANNELS), BASE, BASE, generator=rng) - 0.5
    off = -0.1 * uniform.sign() * (1 - 2 * uniform.abs()).clamp_min(1e-6).log()
    log = torch.full((1, len(PARTS), 1, 1), -1.0, requires_grad=True)
    adam = torch.optim.Adam([log], 0.05)
    for _ in range(200):
        theta = {"deviation": log.expand(1, len(PARTS), BASE, BASE)}
        loss = surprise(off.split(CHANNELS, 1), theta).sum()
        adam.zero_grad()
        loss.backward()
        adam.step()
    theta = {"deviation": log.detach().expand(1, len(PARTS), BASE, BASE)}
    torch.testing.assert_close(scales(theta), torch.full_like(scales(theta), 0.1), rtol=0.05, atol=0)


def test_the_likelihood_moves_the_predicted_error_alone(app: SvbrdfNonstationary, tasks: Tasks, rng: Generator) -> None:
    theta = {key: value.detach().requires_grad_() for key, value in predicted(app, tasks, rng).items()}
    batch = app.sample(tasks, rng, 1)
    without = replace(app, sure=False)
    grads, others = (
        torch.autograd.grad(each.outer_loss(theta, batch, {}).sum(), list(theta.values()), materialize_grads=True)
        for each in (app, without)
    )
    for key, grad, other in zip(theta, grads, others, strict=True):
        assert torch.equal(grad, other) == (key != "deviation"), key


def test_steps_leave_the_predicted_error(app: SvbrdfNonstationary, tasks: Tasks, rng: Generator) -> None:
    theta = predicted(app, tasks, rng)
    leaves = {key: value.detach().requires_grad_() for key, value in theta.items()}
    loss = app.loss(leaves, app.sample(tasks, rng, 1), {}).sum()
    grads = dict(zip(leaves, torch.autograd.grad(loss, list(leaves.values()), materialize_grads=True), strict=True))
    assert not grads["deviation"].any()
    assert grads["z"].any()
