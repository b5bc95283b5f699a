"""Suns of environment maps in closed form: where, how much light, how wide; and the network beside them."""

import math

import pytest
import torch
from torch import Generator, Tensor
from torch.nn.functional import normalize

from metapp.appearance.latlong import mean_luminance, solid_angles, texel_directions
from metapp.apps.illumination.app import Illumination
from metapp.apps.illumination.ball_sight import BallSight
from metapp.apps.illumination.lighting import LightField
from metapp.apps.illumination.map_sight import MapSight
from metapp.apps.illumination.suns import MAX_SUN_RAD, SUN_COUNT, add_suns, find_suns, join_suns, split_suns
from metapp.learning.app import stack_tasks
from metapp.learning.task import Task
from metapp.networks.field import LocalField
from metapp.paradigms.trainings import encoder_prediction

pytestmark = pytest.mark.usefixtures("second_scene")
HEIGHT, WIDTH = 64, 128


def sky(*lights: tuple[Tensor, float, float]) -> Tensor:
    """A smooth sky with lights: direction, share of all light, standard deviation along one axis (rad)."""
    towards, area = texel_directions(HEIGHT, WIDTH), solid_angles(HEIGHT, WIDTH)
    light = 0.3 + 0.1 * towards
    for direction, share, deviation in lights:
        lobe = ((torch.einsum("c,chw->hw", direction, towards) - 1) / deviation**2).exp()
        light = light + share * 4 * math.pi * lobe / (lobe * area).sum() * torch.tensor([1.2, 1.0, 0.7])[:, None, None]
    return light / mean_luminance(light)


def towards(x: float, y: float, z: float) -> Tensor:
    return normalize(torch.tensor([x, y, z], dtype=torch.float32), dim=0)


@pytest.mark.parametrize("direction", [(0.3, 0.5, 0.8), (0.02, 0.4, -0.9), (-0.2, -0.1, 0.4)])
def test_suns_are_found_with_their_position_and_width(direction: tuple[float, float, float]) -> None:
    at = towards(*direction)
    (found,) = find_suns(sky((at, 8.0, 0.03))[None])
    assert (found[:, 3] > 0).tolist() == [True, False, False]
    assert float(found[0, :3] @ at) > math.cos(math.radians(0.3))
    assert float((found[0, 6] / 2).sqrt()) == pytest.approx(0.03, rel=0.15)  # its dim border is the network's


@pytest.mark.parametrize("row", [3, 20, 40])
@pytest.mark.parametrize("column", [0, 50, 127])
def test_a_sun_of_one_texel_is_exact(row: int, column: int) -> None:
    light = sky()
    light[:, row, column] = torch.tensor([2000.0, 1600.0, 1200.0])
    light /= mean_luminance(light)
    suns = find_suns(light[None])
    result = add_suns(torch.rand(1, 3, HEIGHT, WIDTH), suns)[0]
    torch.testing.assert_close(result[:, row, column], light[:, row, column], rtol=1e-3, atol=0)
    # the network counts all round it
    network = light.clone()
    network[:, row, column] = 0
    torch.testing.assert_close(add_suns(network[None], suns)[0], light, rtol=2e-3, atol=1e-3)


def test_suns_keep_their_light_whatever_the_network_predicts() -> None:
    light = sky((towards(0.3, 0.5, 0.8), 0.4, 0.02), (towards(-0.6, 0.3, -0.5), 0.2, 0.03))
    suns, area = find_suns(light[None]), solid_angles(HEIGHT, WIDTH)
    assert (suns[0, :, 3] > 0).sum() == 2
    lights, without = suns[0, :, 3:6].sum(0), torch.tensor([1.0, 1, 1, 0, 0, 0, 1, 1, 1, 1])
    for network in (torch.zeros_like(light), light):
        around = add_suns(network[None], suns)[0] - add_suns(network[None], suns * without)[0]
        torch.testing.assert_close((around * area).sum((1, 2)), lights, rtol=1e-3, atol=0)


def test_wide_and_dim_lights_are_left_to_the_network() -> None:
    assert not find_suns(sky((towards(0, 1, 1), 0.9, 1.5 * MAX_SUN_RAD))[None]).any()
    assert not find_suns(sky((towards(0, 1, 1), 0.01, 0.05))[None]).any()
    light = sky()[None]
    torch.testing.assert_close(add_suns(light, find_suns(light)), light)


def test_brightest_suns_are_found_up_to_the_allowed_number() -> None:
    corners = [towards(x, 0.4, z) for x, z in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
    shares = [0.1, 0.25, 0.15, 0.2]
    (found,) = find_suns(sky(*((at, share, 0.02) for at, share in zip(corners, shares, strict=True)))[None])
    assert SUN_COUNT == 3
    for sun, at in zip(found, (corners[1], corners[3], corners[2]), strict=True):
        assert float(sun[:3] @ at) > 0.999


def test_suns_are_found_before_fits_and_stay_fixed(rng: Generator) -> None:
    field = LocalField(32, 64, rows=4, columns=8, code=3, hidden=8, layers=2)
    light = sky((towards(0.3, 0.5, 0.8), 0.5, 0.02))
    task = Task("sky", {"map": light, "photos": torch.full((1, 3, 64, 64), 99, dtype=torch.uint8)})
    app = Illumination(LightField(field), MapSight())
    tasks = stack_tasks(app, [task])
    how, encoder = encoder_prediction(app), app.init_encoder(rng)
    predicted, theta = (variant.encode(encoder, variant.encoder_input(tasks, rng)) for variant in (app, how))
    assert not [key for key in predicted if key.startswith("suns")]  # General sees the photograph alone
    torch.testing.assert_close(join_suns(theta), tasks.data["suns"])
    assert theta.keys() - predicted.keys() == app.task_parameters(tasks).keys() == split_suns(tasks.data["suns"]).keys()
    leaves = {key: value.detach().requires_grad_() for key, value in theta.items()}
    loss = app.loss(leaves, app.sample(tasks, rng, 1), {}).sum()
    grads = torch.autograd.grad(loss, list(leaves.values()), allow_unused=True)
    moved = {key for key, grad in zip(leaves, grads, strict=True) if grad is not None and grad.any()}
    assert "z" in moved
    assert not [key for key in moved if key.startswith("suns")]
    larger = app.decoder.resize(128, 256)(theta).maps  # a sun stays as wide and bright as it is
    at = float(mean_luminance(larger)), float(mean_luminance(app.decoder(theta).maps))
    assert at[0] == pytest.approx(at[1], rel=0.05)
    photo = Illumination(LightField(field), BallSight())
    encoder_input = encoder_prediction(photo).encoder_input(stack_tasks(photo, [task]), rng)
    assert not [key for key in encoder_prediction(photo).encode(encoder, encoder_input) if key.startswith("suns")]
