"""Maps quilted of a flash photo: the gloss of materials whose truth is known, colours, and that they tile."""

from __future__ import annotations

from typing import cast

import pytest
import torch
from torch import Generator, Tensor

from metapp.appearance.flash import Maps, camera, relightings
from metapp.apps.svbrdf_stationary.app import SvbrdfStationary
from metapp.extensions.baselines import baselines_of
from metapp.extensions.baselines.baseline import Allowed, BaselineFit, Training
from metapp.extensions.baselines.svbrdf_stationary import quilted_maps
from metapp.learning.app import stack
from metapp.learning.task import Task, Tasks
from metapp.networks.exemplar import JUDGED
from tests.quick import app_by

SIZE = 64  # of recipe quick
DIFFUSE, F0, ROUGHNESS = (0.3, 0.2, 0.1), 0.04, 0.3


@pytest.fixture(scope="module")
def app() -> SvbrdfStationary:
    return cast("SvbrdfStationary", app_by("svbrdf_stationary"))


def material(pattern: Tensor | None = None) -> Maps:
    """Flat and even but for a pattern [SIZE, SIZE] that multiplies its diffuse colour."""
    one = torch.ones(1, SIZE, SIZE)
    up = torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(3, SIZE, SIZE)
    colour = torch.tensor(DIFFUSE)[:, None, None] * (one if pattern is None else pattern)
    return Maps(colour, F0 * one, ROUGHNESS * one, up)


def task_of(app: SvbrdfStationary, maps: Maps) -> Task:
    def as_bytes(light: Tensor, view: Tensor) -> Tensor:
        return (255 * app.photograph(maps, light, view)).round().to(torch.uint8)

    relit = torch.stack([as_bytes(*pair) for pair in relightings().values()])
    return Task("known", {"image": as_bytes(camera(), camera()), "relit": relit})


def quilting(app: SvbrdfStationary, tasks: Tasks, seed: int = 0) -> BaselineFit:
    (baseline,) = [baseline for baseline in baselines_of(app) if baseline.name == "quilting"]
    allowed = Allowed(64, 1)
    return baseline.prepare(Training(app, []), allowed).fit(tasks, Generator().manual_seed(seed), allowed)


def waves(period: float) -> Tensor:
    wave = torch.sin(torch.arange(SIZE) * (2 * torch.pi / period))
    return 1 + 0.3 * wave[:, None] * wave


def test_a_flat_even_material_comes_back_with_its_colour_and_gloss(app: SvbrdfStationary) -> None:
    tasks = stack(app, [task_of(app, material())])
    fitted = quilting(app, tasks)
    maps = fitted.answer()
    assert maps.diffuse.shape == (1, JUDGED, 3, SIZE, SIZE)
    torch.testing.assert_close(maps.diffuse.mean((0, 1, 3, 4)), torch.tensor(DIFFUSE), rtol=0.1, atol=0)
    assert float(maps.diffuse.std((3, 4)).max()) < 0.01
    assert float(maps.roughness.mean()) == pytest.approx(ROUGHNESS, rel=0.12)
    assert float(maps.specular.mean()) == pytest.approx(F0, rel=0.5)
    assert float(maps.normal[..., 2, :, :].min()) > 0.999
    errors = app.errors_of(maps, tasks)
    assert errors["brightness"] < 0.01
    assert errors["relit"] < 0.1
    assert (fitted.numbers, fitted.size) == (3 * SIZE * SIZE + 5, 3 * SIZE * SIZE + 20)


def test_maps_tile_and_go_on_across_their_edges(app: SvbrdfStationary) -> None:
    tasks = stack(app, [task_of(app, material(waves(9.7)))])  # no whole number of waves
    diffuse = quilting(app, tasks).answer().diffuse
    for axis in (-1, -2):
        steps = (diffuse - diffuse.roll(1, axis)).abs().mean((0, 1, 2, -1 if axis == -2 else -2))
        assert float(steps[0]) < 1.5 * float(steps[1:].mean())


def test_the_same_seed_makes_the_same_maps(app: SvbrdfStationary) -> None:
    noise = torch.rand(SIZE, SIZE, generator=Generator().manual_seed(0))
    tasks = stack(app, [task_of(app, material(0.5 + noise))])
    photo, light = tasks.data["image"].float() / 255, tasks.data["light"]
    first, same, other = (quilted_maps(photo, light, Generator().manual_seed(seed)) for seed in (0, 0, 1))
    torch.testing.assert_close(first, same)
    assert not torch.equal(first.diffuse, other.diffuse)
    mean = [float(maps.diffuse.mean()) for maps in (first, other)]
    assert mean == pytest.approx([sum(DIFFUSE) / 3] * 2, rel=0.1)
