"""Parts of photographs that show something else than the material: they alone are left out, and a line says so."""

import re

import pytest
import torch
from torch import Tensor

from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.flash import texel_positions
from metapp.appearance.svbrdf_maps import Maps
from metapp.apps.svbrdf_nonstationary.flashes import FLASH_NUMBERS, decode_flash, render_photos
from metapp.apps.svbrdf_nonstationary.multi_photo import newton
from metapp.apps.svbrdf_nonstationary.multi_photo.obstructions import remove_obstructions
from metapp.apps.svbrdf_nonstationary.multi_photo.recipe import of_several
from metapp.learning.app import stack_tasks
from metapp.learning.task import Task
from tests.apps.multi_photo.test_parallax import SIDE, photographs
from tests.apps.multi_photo.test_several_photos import general, relief
from tests.recipe_apps import presenter_of

DISTANCE = (texel_positions(SIDE, SIDE) - torch.tensor([0.3, -0.2])[:, None, None]).norm(dim=0)
DISC, WIDE_DISC = DISTANCE < 0.22, DISTANCE < 0.42
APP = of_several(SIDE, SIDE)
OBJECTS = {"finger": torch.tensor([0.16, 0.08, 0.06]), "coin": torch.tensor([0.05, 0.04, 0.02]), "shadow": None}


def obstruct(photos: Tensor, name: str, numbers: list[int]) -> Tensor:
    """Photographs of which some show an object, or a shadow, in place of the material."""
    obstructed, colour = photos.clone(), OBJECTS[name]
    for number in numbers:
        seen = photos[number] * 0.3 if colour is None else colour[:, None, None].expand_as(photos[number])
        obstructed[number] = torch.where(DISC, seen, photos[number])
    return obstructed


def as_task(photos: Tensor, places: Tensor) -> Task:
    display = (linear_to_srgb(photos) * 255).round().to(torch.uint8)
    return Task("relief", {"photo": display[0], "others": display[1:], "places": places})


@pytest.mark.parametrize("name", OBJECTS)
@pytest.mark.parametrize("numbers", [[1], [0, 3]])
def test_objects_and_shadows_in_some_photographs_are_found_and_filled(name: str, numbers: list[int]) -> None:
    photos, places = photographs(1.0)
    obstructed = obstruct(photos, name, numbers)
    filled, material = remove_obstructions(obstructed, places)
    for number in range(len(photos)):
        left_out = material[number, 0] == 0
        if number in numbers:
            assert left_out[DISC].float().mean() > 0.9
            assert left_out[~WIDE_DISC].float().mean() == 0
            error, error_before = (
                (part[number] - photos[number])[:, DISC].abs().mean() for part in (filled, obstructed)
            )
            assert error < 0.3 * error_before
        else:
            assert not left_out.any()
        assert torch.equal(filled[number][:, ~left_out], obstructed[number][:, ~left_out])


@pytest.mark.parametrize("numbers", [[1], [0, 3]])
def test_what_is_brighter_than_others_predict_stays(numbers: list[int]) -> None:
    photos, places = photographs(1.0)
    brighter = photos.clone()
    for number in numbers:
        brighter[number] = torch.where(DISC, (photos[number] * 4).clamp(max=1), photos[number])
    filled, material = remove_obstructions(brighter, places)
    assert filled is brighter
    assert (material == 1).all()


@pytest.mark.parametrize("roughness", [0.1, 0.2, 0.35])
def test_highlights_of_polished_stone_stay(roughness: float) -> None:
    _, places = photographs(1.0)
    veins = 0.05 + 0.3 * relief(SIDE).diffuse
    normal = torch.zeros(1, 3, SIDE, SIDE)
    normal[:, 2] = 1
    stone = Maps(veins, torch.full_like(veins, 0.04), torch.full_like(veins[:, :1], roughness), normal)
    flashes = decode_flash(torch.zeros(1, len(places), FLASH_NUMBERS), places[None])
    photos = render_photos(stone, flashes)[0].clamp(0, 1)
    assert (photos.amax((1, 2, 3)) > 2 * photos.mean((1, 2, 3))).any()  # highlights are seen
    filled, material = remove_obstructions(photos, places)
    assert filled is photos
    assert (material == 1).all()


@pytest.mark.parametrize("slope", [0.0, 1.0])
def test_photographs_of_the_material_alone_or_too_few_stay_unchanged(slope: float) -> None:
    photos, places = photographs(slope)
    for unchanged, at in (
        (photos, places),
        (obstruct(photos, "finger", [1])[:4], places[:4]),
        (torch.cat([photos[:4], obstruct(photos, "finger", [4])[4:]])[..., ::4, ::4], places),
    ):
        filled, material = remove_obstructions(unchanged, at)
        assert filled is unchanged
        assert (material == 1).all()


def test_losses_and_steps_do_not_depend_on_what_hides_the_material() -> None:
    photos, places = photographs(1.0)
    batch = {key: value[None] for key, value in APP.prepare(as_task(obstruct(photos, "coin", [2]), places)).items()}
    assert (batch["shows_material"] == 0).any()
    other = batch | {"photos": torch.where(batch["shows_material"] > 0, batch["photos"], 0.9)}
    maps = torch.zeros(1, 9, SIDE, SIDE)
    flashes = {"flash": torch.zeros(1, 4, 5), "falloff": torch.zeros(1, 1)}
    theta = {"maps": maps, **flashes, "prior": torch.cat([maps, maps], 1)}
    settings = APP.sight.settings({}, maps)
    assert torch.equal(APP.loss(theta, batch, {}), APP.loss(theta, other, {}))
    steps, other_steps = (newton.gauss_newton_change(theta, of, settings) for of in (batch, other))
    for key, step in steps.items():
        assert step.isfinite().all()
        assert torch.equal(step, other_steps[key])


def test_a_line_says_which_part_of_which_photograph_is_left_out() -> None:
    photos, places = photographs(1.0)
    tasks = [as_task(photos, places), as_task(obstruct(photos, "finger", [1, 3]), places)]
    stacked = stack_tasks(APP, tasks, torch.device("cpu"))
    theta = general(APP, stacked)
    clean, obstructed = presenter_of(APP).quality_warnings(theta, stacked)
    (clause,) = [line for line in obstructed if "left out" in line]
    assert not any("left out" in line for line in clean)
    part, cause = r"([\d.]+) % of photo", "where others disagree: an object or a shadow"
    shares = re.fullmatch(rf"{part} 2 and {part} 4 left out, {cause}\?", clause).groups()
    assert all(DISC.float().mean() <= float(share) / 100 <= WIDE_DISC.float().mean() for share in shares)
