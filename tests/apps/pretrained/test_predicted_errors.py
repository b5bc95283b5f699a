"""The error that General predicts for its maps: its likelihood is greatest at the true scale."""

from dataclasses import replace

import pytest
import torch
from torch import Generator

from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.encoder import BASE_TEXELS
from metapp.apps.svbrdf_nonstationary.pretrained.ensemble_maps import PARTS
from metapp.apps.svbrdf_nonstationary.pretrained.feature_judge import (
    FeatureJudge,
    laplace_scales,
    negative_log_likelihood,
)
from metapp.learning.task import Tasks

CHANNELS = (3, 3, 1, 3)  # of each map


def test_the_likelihood_is_greatest_at_the_scale_of_the_differences(rng: Generator) -> None:
    """Differences of a Laplace distribution of scale 0.1: the scale that gradient descent finds is 0.1."""
    uniform = torch.rand(1, sum(CHANNELS), BASE_TEXELS, BASE_TEXELS, generator=rng) - 0.5
    off = -0.1 * uniform.sign() * (1 - 2 * uniform.abs()).clamp_min(1e-6).log()
    log = torch.full((1, len(PARTS), 1, 1), -1.0, requires_grad=True)
    adam = torch.optim.Adam([log], 0.05)
    for _ in range(200):
        deviation = log.expand(1, len(PARTS), BASE_TEXELS, BASE_TEXELS)
        loss = negative_log_likelihood(off.split(CHANNELS, 1), deviation).sum()
        adam.zero_grad()
        loss.backward()
        adam.step()
    scales = laplace_scales(log.detach().expand(1, len(PARTS), BASE_TEXELS, BASE_TEXELS))
    torch.testing.assert_close(scales, torch.full_like(scales, 0.1), rtol=0.05, atol=0)


@pytest.mark.usefixtures("random_vgg_in_cache")
def test_the_likelihood_moves_the_predicted_error_alone(app: SvbrdfNonstationary, tasks: Tasks, rng: Generator) -> None:
    windows = app.augment(tasks, rng)
    start = app.encode(app.init_encoder(rng), app.encoder_input(windows, rng))
    theta = {key: value.detach().requires_grad_() for key, value in start.items()}
    batch, grads = app.outer_sample(windows, rng, 1), []
    for judge in (FeatureJudge(), FeatureJudge(likelihood_weight=0.0)):
        loss = replace(app, judge=judge).outer_loss(theta, batch, {}).sum()
        grads.append(torch.autograd.grad(loss, list(theta.values()), materialize_grads=True))
    for key, grad, other in zip(theta, *grads, strict=True):
        assert torch.equal(grad, other) == (key != "deviation"), key


@pytest.mark.usefixtures("random_vgg_in_cache")
def test_steps_leave_the_predicted_error(app: SvbrdfNonstationary, tasks: Tasks, rng: Generator) -> None:
    theta = app.encode(app.init_encoder(rng), app.encoder_input(tasks, rng))
    leaves = {key: value.detach().requires_grad_() for key, value in theta.items()}
    loss = app.loss(leaves, app.sample(tasks, rng, 1), {}).sum()
    grads = dict(zip(leaves, torch.autograd.grad(loss, list(leaves.values()), materialize_grads=True), strict=True))
    assert not grads["deviation"].any()
    assert grads["z"].any()
    assert theta.keys() - app.postprocess(theta).keys() == {"deviation"}
