"""Stationary svBRDFs at several octaves: what is compared at each, and that relief keeps its shape."""

from __future__ import annotations

import pytest
import torch
from torch import Generator

from metapp.apps.svbrdf_stationary import APP, FULL, SvbrdfStationary
from metapp.learning.task import Tasks
from metapp.networks.pyramid import enlarged
from tests.apps.octaves import noise_tasks, tiny

TINY = tiny(FULL, 64, 0.5)


@pytest.fixture(scope="module")
def app() -> SvbrdfStationary:
    return APP.at(TINY)


@pytest.fixture(scope="module")
def tasks(app: SvbrdfStationary) -> Tasks:
    return noise_tasks(app, 2)


def test_coarse_stages_leave_out_all_of_the_finest_octave(app: SvbrdfStationary, tasks: Tasks) -> None:
    coarse = app.stage(tasks, 0.49).data
    for name in ("gram", "spectrum"):
        assert sorted(key for key in coarse if key.startswith(name)) == [f"{name}{i}" for i in range(3)]
        assert sorted(key for key in tasks.data if key.startswith(name)) == [f"{name}{i}" for i in range(5)]
    assert app.octave(coarse) == 1


def test_losses_of_both_octaves(app: SvbrdfStationary, tasks: Tasks) -> None:
    rng = Generator().manual_seed(0)
    theta = {key: value.requires_grad_() for key, value in app.init(rng, 2).items()}
    moved: list[set[str]] = []
    for done in (0.0, 0.9):
        loss = app.loss(theta, app.sample(app.stage(tasks, done), rng, 1), {})
        assert loss.shape == (2,)
        grads = torch.autograd.grad(loss.sum(), list(theta.values()), materialize_grads=True)
        moved.append({key.split(".")[0] for key, grad in zip(theta, grads, strict=True) if grad.any()})
    assert moved[1] - moved[0] == {"join0", "draw0", "out0"}


def test_relief_keeps_its_slopes(app: SvbrdfStationary) -> None:
    """Half as many texels a side, half as many texels of height."""
    rng = Generator().manual_seed(0)
    theta = app.init(rng, 1)
    silent = theta | {key: torch.zeros_like(theta[key]) for key in ("out0.kernel", "out0.shift")}
    noise = torch.randn(1, 1, 8, 64, 64, generator=rng)
    small = torch.nn.functional.avg_pool2d(noise[0], 2)[None] * 2
    height, low = app.maps(silent, noise)[1], app.maps(silent, small, 1)[1]
    torch.testing.assert_close(height[0], 2 * enlarged(low[0]))


def test_an_exemplar_is_at_no_distance_from_itself(app: SvbrdfStationary, tasks: Tasks) -> None:
    photos = app.exemplar(tasks.data["image"].float() / 255)[:, None]
    assert app.errors_of(photos, tasks)["error"].max() < 1e-5
