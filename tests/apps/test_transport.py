"""Transport: splines, the flow, its table, the encoder and what an application promises beside the common contract."""

import math
from typing import Any

import numpy as np
import pytest
import torch
from torch import Generator, Tensor

from data_tools.synthetic.cornell import random_scene
from metapp.apps.transport import spline
from metapp.apps.transport.app import Transport
from metapp.apps.transport.flow import Flow
from metapp.apps.transport.guide import make_guide_table
from metapp.apps.transport.path_fits import FlowDensity
from metapp.learning.app import stack_tasks
from metapp.learning.task import Params, Task, Tasks
from metapp.rendering.paths.path_space import Tracer

FLOW = Flow(rows=4, columns=4, code=3, hidden=8, bins=5, film_bins=8, blobs=6)


def rng(seed: int = 0) -> Generator:
    return Generator().manual_seed(seed)


def numbers(bins: int, count: int, scale: float = 1.5, seed: int = 0) -> Tensor:
    """Draw the parameters of `count` splines, float64 [3 K + 1, count]."""
    return scale * torch.randn(spline.count_numbers(bins), count, generator=rng(seed), dtype=torch.float64)


def bent_flow(flow: Flow, seed: int = 0, scale: float = 0.5) -> Params:
    """Parameters of a flow that is far from the identity, float64, task axis 1."""
    generator = rng(seed)
    start = flow.init(generator, 1)
    gains = {"z": flow.gain, "film.x": flow.film_gain, "film.y": flow.film_gain}
    scales = {key: scale / gains.get(key, 1.0) for key in start}
    return {
        key: value.double() + scales[key] * torch.randn(value.shape, generator=generator)
        for key, value in start.items()
    }


# Splines


def test_a_spline_goes_up_from_0_to_1() -> None:
    places = torch.linspace(0, 1, 2001, dtype=torch.float64)
    for seed in range(5):
        one = numbers(6, 1, scale=3.0, seed=seed)
        masses = spline.cumulative_mass(spline.decode_splines(one), places)
        assert float(masses[0]) == pytest.approx(0, abs=1e-12)
        assert float(masses[-1]) == pytest.approx(1, abs=1e-12)
        assert (masses.diff() > 0).all()


def test_derivatives_of_the_log_density_are_those_of_differences() -> None:
    """First and second ones, in all numbers: what exact second order rests on."""
    many = numbers(4, 6).requires_grad_()
    places = torch.rand(6, generator=rng(3), dtype=torch.float64)
    assert torch.autograd.gradcheck(lambda n: spline.log_density(n, places), many)
    assert torch.autograd.gradgradcheck(lambda n: spline.log_density(n, places), many)


# The flow


def test_a_flow_is_the_identity_at_first() -> None:
    flow = Flow()
    theta = flow.init(rng(), 3)
    points = torch.rand(3, 4, 50, generator=rng(1))
    for part in flow.log_density(theta, points):
        torch.testing.assert_close(part, torch.zeros(3, 50), atol=1e-5, rtol=0)


def middles(count: int) -> Tensor:
    """Return the centres of the cells of a grid over the unit square, [1, 2, count * count]."""
    centres = (torch.arange(count, dtype=torch.float64) + 0.5) / count
    return torch.stack(torch.meshgrid(centres, centres, indexing="ij")).flatten(1)[None]


def test_the_density_is_the_jacobian_of_the_chain() -> None:
    flow = FLOW
    theta = bent_flow(flow, scale=0.2)

    def uniform(point: Tensor) -> Tensor:
        """What the chain of splines makes of a point: evenly spread where points have the flow's density."""
        places = point[None, :, None]
        trunk = flow.place_features(theta, places[:, 0], places[:, 1])
        chain = [flow.direction_numbers(theta, i, trunk, places[:, 2 : 2 + i]) for i in range(2)]
        chain = [*flow.film_numbers(theta, places[:, 0]), *chain]
        return torch.cat(
            [spline.cumulative_mass(spline.decode_splines(layer), places[:, i])[0] for i, layer in enumerate(chain)]
        )

    for seed in range(4):
        point = torch.rand(4, generator=rng(seed), dtype=torch.float64)
        jacobian = torch.autograd.functional.jacobian(uniform, point)
        assert torch.equal(jacobian, jacobian.tril())
        film, towards = flow.log_density(theta, point[None, :, None])
        assert float(jacobian[:2, :2].diagonal().log().sum()) == pytest.approx(float(film), abs=1e-5)
        assert float(jacobian[2:, 2:].diagonal().log().sum()) == pytest.approx(float(towards), abs=1e-5)


# The table


def test_a_table_is_the_flow_in_cells() -> None:
    theta = {key: value[0].float() for key, value in bent_flow(FLOW, scale=0.2).items()}
    table = make_guide_table(FLOW, theta, places=8, cells=32, power=1.0)
    torch.testing.assert_close(table.masses.sum(1), torch.ones(64), atol=1e-5, rtol=0)
    place = torch.tensor([5.5 / 8, 2.5 / 8])
    square = middles(32).float()
    single = {key: value[None] for key, value in theta.items()}
    _, directions = FLOW.log_density(single, torch.cat([place[None, :, None].expand(1, 2, 1024), square], 1))
    found = table.density(place.expand(1024, 2), square[0].T)
    assert float((found - directions[0].exp()).abs().mean()) < 0.02
    root = make_guide_table(FLOW, theta, places=8, cells=32, power=0.5)
    torch.testing.assert_close(root.masses.sum(1), torch.ones(64), atol=1e-5, rtol=0)
    ratio = root.masses.square() / table.masses
    torch.testing.assert_close(ratio, ratio[:, :1].expand_as(ratio), rtol=1e-3, atol=0)


def test_samples_of_a_table_follow_the_stated_density() -> None:
    """Also as its numbers say: of 200,000 draws as many fall into each cell as its mass is, within 5 deviations.

    So a guide leaves means over draws, over their density, as they are.
    """
    theta = {key: value[0].float() for key, value in bent_flow(FLOW).items()}
    table = make_guide_table(FLOW, theta, places=4, cells=8)
    torch.manual_seed(0)
    count = 200_000
    for x, y in ((0.6, 0.3), (0.1, 0.9)):
        place = torch.tensor([x, y]).expand(count, 2)
        drawn, density = table.sample(place)
        assert drawn.min() >= 0
        assert drawn.max() < 1
        torch.testing.assert_close(density, table.density(place, drawn))
        cell = (drawn * 8).long()
        seen = torch.bincount(cell[:, 0] * 8 + cell[:, 1], minlength=64) / count
        mass = table.masses[int(4 * y) * 4 + int(4 * x)]
        torch.testing.assert_close(density, 64 * mass[cell[:, 0] * 8 + cell[:, 1]])
        assert ((seen - mass).abs() < 5 * (mass / count).sqrt() + 1e-5).all()
        within = drawn.double() * 8 % 1
        eighths = (
            torch.stack([torch.bincount((8 * coordinates).long(), minlength=8) for coordinates in within.T]) / count
        )
        assert ((eighths - 1 / 8).abs() < 5 * math.sqrt(1 / 8 / count)).all()
    film = torch.rand(count, 2)
    drawn, density = table.sample(film)
    torch.testing.assert_close(density, table.density(film, drawn))


# The application


def room(seed: int, count: int = 4096) -> Task:
    """Samples with a lamp on the film and, elsewhere, directions towards it; a picture of where they are."""
    generator = rng(seed)
    lamp = 0.2 + 0.6 * torch.rand(2, generator=generator)
    points = torch.rand(2 * count, 4, generator=generator)
    lit = torch.rand(2 * count, generator=generator) < 0.3
    points[lit, :2] = lamp + 0.05 * (torch.rand(int(lit.sum()), 2, generator=generator) - 0.5)
    near = (lamp - points[:, :2]) * 0.5 + 0.5
    points[~lit, 2:] = (near + 0.05 * torch.randn(2 * count, 2, generator=generator)).clamp(0, 0.9999)[~lit]
    film = (points[:, :2] * 8).long()
    image = torch.bincount(film[:, 1] * 8 + film[:, 0], minlength=64).float().reshape(8, 8) / (2 * count / 64)
    data = {"samples": points[:count], "held_out": points[count:], "image": image.expand(3, 8, 8).clone()}
    return Task(f"room-{seed}", data)


@pytest.fixture
def app() -> Transport:
    return Transport(FlowDensity(FLOW))


@pytest.fixture
def tasks(app: Transport) -> Tasks:
    return stack_tasks(app, [room(seed) for seed in range(4)])


def test_errors_are_of_held_out_samples_and_add_up(app: Transport, tasks: Tasks) -> None:
    theta = {key: value.repeat(4, *[1] * (value.ndim - 1)).float() for key, value in bent_flow(FLOW).items()}
    errors = app.errors(theta, tasks)
    held_out = {"samples": tasks.data["held_out"], "image": tasks.data["image"]}
    torch.testing.assert_close(errors["error"], errors["film"] + errors["directions"])
    torch.testing.assert_close(errors["error"], app.loss(theta, held_out, {}))


def test_untrained_encoder_predicts_the_pictures_density(app: Transport, tasks: Tasks) -> None:
    encoder = app.init_encoder(rng())
    theta = app.encode(encoder, app.encoder_input(tasks, rng()))
    centres = (torch.arange(8) + 0.5) / 8
    y, x = (values.flatten() for values in torch.meshgrid(centres, centres, indexing="ij"))
    points = torch.stack([x, y, x, y]).expand(4, 4, 64)
    film = FLOW.log_density(theta, points)[0].exp().reshape(4, 8, 8)
    image = tasks.data["image"][:, 0]
    for found, expected in zip(film, image, strict=True):
        assert float(torch.corrcoef(torch.stack([found.flatten(), expected.flatten()]))[0, 1]) > 0.98


def test_variants_are_mirrored_or_not(app: Transport, tasks: Tasks) -> None:
    variants = app.augment(tasks.select([0, 1, 2, 3, 0, 1, 2, 3]), rng(2))
    seen = set()
    for i in range(8):
        plain, variant = tasks.data["samples"][i % 4], variants.data["samples"][i]
        same = torch.equal(plain, variant)
        turned = torch.stack([1 - plain[:, 0], plain[:, 1], 1 - plain[:, 2], plain[:, 3]], 1)
        assert same or torch.allclose(turned, variant, atol=1e-6)
        picture = tasks.data["image"][i % 4]
        picture = picture if same else picture.flip(2)
        assert float((variants.data["image"][i] / picture.clamp_min(1e-6)).log().abs().mean()) < 0.5
        seen.add(same)
    assert seen == {True, False}
    assert variants.data["samples"].max() < 1


def mirror_scene(scene: dict[str, Any]) -> dict[str, Any]:
    """Return the scene with left and right exchanged."""
    flip = np.diag([-1.0, 1.0, 1.0, 1.0])

    def turn(value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        return {k: (flip @ np.array(v) @ flip).tolist() if k == "to_world" else turn(v) for k, v in value.items()}

    return {**turn(scene), "sensor": scene["sensor"]}


def test_the_tracer_mirrors_scenes_as_variants_do() -> None:
    """What leaves the first surface towards a light carries the same in both."""
    for seed in (1, 2):
        scene, points = random_scene(seed), torch.rand(2**15, 4, generator=rng(seed))
        turned = torch.where(torch.tensor([True, False, True, False]), 1 - points, points)
        plain, other = (
            Tracer(traced_scene, depth=2).trace_radiance(where, rng())
            for traced_scene, where in ((scene, points), (mirror_scene(scene), turned))
        )
        lit = plain.sum(1) > 0
        assert lit.sum() > 100
        assert float(((plain - other).abs().sum(1) < 1e-3 * plain.sum(1))[lit].float().mean()) > 0.98
