"""Stationary svBRDFs at several octaves: what is compared at each, and that relief keeps its shape."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Generator, Tensor

from metapp.apps.svbrdf_stationary import SvbrdfStationary
from metapp.apps.svbrdf_stationary.presentation import SvbrdfStationaryPresentation
from metapp.apps.svbrdf_stationary.recipes import FULL
from metapp.learning.task import Params, Task, Tasks
from metapp.networks.layers import enlarged
from tests.apps.octaves import noise_tasks, tiny

TINY = tiny(FULL, 64, 0.5)


@pytest.fixture(scope="module")
def app() -> SvbrdfStationary:
    return SvbrdfStationary(TINY.setup)


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


def test_files_and_surface_are_of_the_same_maps_made_once(
    app: SvbrdfStationary, tasks: Tasks, monkeypatch: pytest.MonkeyPatch
) -> None:
    theta = {key: value[0] for key, value in app.init(Generator().manual_seed(0), 1).items()}
    make, sizes, task = app.maps, [], Task("noise", {})

    def maps(theta: Params, noise: Tensor) -> Any:
        sizes.append(tuple(noise.shape[-2:]))
        return make(theta, noise)

    monkeypatch.setattr(type(app), "maps", staticmethod(maps))
    shown = SvbrdfStationaryPresentation(app, (32, 48))
    files, surface = shown.files(theta, task), shown.surface(theta, task)
    assert sizes == [(32, 48)]
    assert torch.equal(files["roughness"].pixels.permute(2, 0, 1), surface.maps.roughness)
    other = shown.surface({**theta, "z": -theta["z"]}, task)
    assert len(sizes) == 2
    assert not torch.equal(other.base, surface.base)
