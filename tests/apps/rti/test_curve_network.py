"""Maps from light curves: least squares where the network adds nothing, and a loss that true maps minimise."""

import pytest
import torch

from metapp.appearance.distant_lamps import render_lit
from metapp.appearance.flash import camera_distance, render_maps, texel_positions
from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_nonstationary.rti.curve_network import answer_of
from metapp.apps.svbrdf_nonstationary.rti.light_curves import curve_weights, read_texels
from metapp.apps.svbrdf_nonstationary.rti.lit_sight import SMOOTHING, LitSight
from metapp.apps.svbrdf_nonstationary.rti.recipe import RTI
from metapp.learning.app import stack_tasks
from metapp.learning.task import Task
from tests.apps.rti.scenes import dome, lit_task, photograph, wavy_maps

APP = RTI.app


def as_texels(maps: Maps) -> Maps:
    return Maps(*(part[None].flatten(2)[..., None] for part in maps))


def mean_angle_degrees(first: torch.Tensor, second: torch.Tensor) -> float:
    return float(torch.rad2deg((first * second).sum(1).clamp(-1, 1).acos()).mean())


def test_least_squares_find_matt_texels_beside_shadows_and_highlights() -> None:
    lamps, maps = dome(40), wavy_maps(16)
    photos = photograph(maps, lamps)
    photos[5::10] = 0  # shadows
    photos[3::10] = 255  # highlights
    reading = read_texels(photos.flatten(2)[None], lamps[None], curve_weights(lamps)[None])
    normal = torch.nn.functional.normalize(
        torch.cat([reading.slopes, torch.ones_like(reading.slopes[:, :1])], 1), dim=1
    )
    assert mean_angle_degrees(normal, maps.normal.flatten(1)[None]) < 0.7
    torch.testing.assert_close(reading.albedo[0], maps.diffuse.flatten(1), atol=0.01, rtol=0.03)


def test_a_network_whose_last_layer_is_zero_answers_least_squares() -> None:
    task = lit_task()
    tasks = stack_tasks(APP, [task])
    theta = APP.init(torch.Generator().manual_seed(0), 1)
    errors = APP.errors(theta, tasks)
    assert float(errors["normal"]) < 0.7
    assert float(errors["diffuse"]) < 0.02


def test_distant_lamps_light_as_very_distant_flashes() -> None:
    maps, lamp, far = wavy_maps(8, 0.2, 0.4), dome(5)[2], 1e4
    near = render_maps(
        maps, texel_positions(8, 8), far * lamp, torch.tensor([0.0, 0, far]), intensity=(far / camera_distance()) ** 2
    )
    lit = render_lit(as_texels(maps), lamp[None, None])[0, 0]
    torch.testing.assert_close(lit, near.flatten(1), atol=2e-3, rtol=2e-3)


def test_true_maps_have_the_least_loss_whatever_the_gains() -> None:
    task, maps, sight = lit_task(specular=0.04), wavy_maps(16, 0.04), LitSight()
    tasks = stack_tasks(APP, [task])
    seen = sight.gather(tasks)
    true_loss = float(sight.loss(answer_of(as_texels(maps)), seen, {}))
    assert true_loss < 0.1 * SMOOTHING
    darker = Maps(0.8 * maps.diffuse, 0.8 * maps.specular, maps.roughness, maps.normal)
    assert float(sight.loss(answer_of(as_texels(darker)), seen, {})) < 5 * SMOOTHING * 0.1
    flat = maps._replace(normal=torch.tensor([0.0, 0, 1])[:, None, None].expand_as(maps.normal))
    assert float(sight.loss(answer_of(as_texels(flat)), seen, {})) > 10 * true_loss


def test_texels_that_are_black_in_all_photographs_show_nothing() -> None:
    task, sight = lit_task(), LitSight()
    black = task.data["lit"].clone()
    black[..., :4] = 0
    seen = sight.gather(stack_tasks(APP, [Task("hole", task.data | {"lit": black})]))
    theta = as_texels(wavy_maps(16))
    wrong = Maps(theta.diffuse.clone(), *theta[1:])
    wrong.diffuse.view(1, 3, 16, 16)[..., :4] = 1
    losses = [float(sight.loss(answer_of(maps), seen, {})) for maps in (theta, wrong)]
    assert losses[0] == losses[1]


def test_steps_see_random_texels_under_all_lamps() -> None:
    tasks = stack_tasks(APP, [lit_task()])
    seen = LitSight().sample(tasks, torch.Generator().manual_seed(1), 10)
    assert seen.colours.shape == (1, 20, 3, 10)
    expected = tasks.data["colours"][0][..., seen.numbers[0]]
    assert torch.equal(seen.colours[0], expected)


def test_training_sees_turned_and_exposed_domes_that_agree_with_their_maps() -> None:
    tasks = stack_tasks(APP, [lit_task(side=48, lamps=40), lit_task(side=48, lamps=40, specular=0.04)])
    augmented = APP.augment(tasks, torch.Generator().manual_seed(3))
    seen, truth = APP.sight.gather(augmented), APP.judge.require(augmented)
    normal, diffuse, roughness, specular = truth.maps.flatten(2)[..., None].split((3, 3, 1, 3), 1)
    true_loss = APP.sight.loss(answer_of(Maps(diffuse, specular, roughness, normal)), seen, {})
    turned = Maps(diffuse, specular, roughness, normal * torch.tensor([-1.0, -1, 1])[:, None, None])
    turned_loss = APP.sight.loss(answer_of(turned), seen, {})
    assert bool((true_loss < 0.25 * turned_loss).all()), (true_loss, turned_loss)


@pytest.mark.parametrize("side", [8, 16, 24])
def test_maps_are_answered_at_any_size(side: int) -> None:
    theta = {name: value[0] for name, value in APP.init(torch.Generator().manual_seed(0), 1).items()}
    maps = APP.decode(theta, lit_task(), torch.zeros(1, 3, side, side)).maps
    expected = torch.nn.functional.normalize(
        torch.nn.functional.interpolate(wavy_maps(16).normal[None], (side, side), mode="bilinear", antialias=True),
        dim=1,
    )
    assert mean_angle_degrees(maps.normal.flatten(2), expected.flatten(2)) < 1


@pytest.mark.parametrize("missing", ["lit", "lamps"])
def test_other_tasks_are_refused(missing: str) -> None:
    task = lit_task()
    with pytest.raises(ValueError, match="no photos under lamps, expected"):
        APP.prepare(Task("flash", {name: value for name, value in task.data.items() if name != missing}))
