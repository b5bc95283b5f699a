"""Illumination: the network of a map, the encoder's views of a photograph, losses, protocols and outputs."""

from dataclasses import replace

import pytest
import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.latlong import mean_luminance, texel_directions
from metapp.appearance.photograph import develop, photograph_spheres, render_material_spheres
from metapp.apps.illumination.app import Illumination
from metapp.apps.illumination.ball_encoder import unwrap_photos
from metapp.apps.illumination.ball_sight import BallSight, SeenBall
from metapp.apps.illumination.lighting import (
    BALL_AND_CAMERA_GAIN,
    BALL_AND_CAMERA_NUMBERS,
    BALL_ROUGHNESSES,
    LightField,
    Lighting,
    decode_ball_and_camera,
)
from metapp.apps.illumination.map_augmentation import (
    LAMP_COUNT,
    add_lamps,
    mix_maps,
    regrade_maps,
    tint_maps,
    turn_maps,
)
from metapp.apps.illumination.map_sight import MapSight
from metapp.apps.illumination.mirror import CLIPPED_LIGHT_FACTOR
from metapp.apps.illumination.radiance_losses import describe_maps
from metapp.learning.app import stack_tasks
from metapp.learning.task import Batch, Params, Task, Tasks
from metapp.networks.field import LocalField
from metapp.rendering.second_scene.relighting import relight
from tests.recipe_apps import asset_of

pytestmark = pytest.mark.usefixtures("second_scene")
FIELD = LocalField(8, 16, rows=4, columns=8, code=3, hidden=8, layers=2)
REFERENCE, PHOTO = (Illumination(LightField(FIELD), sight) for sight in (MapSight(), BallSight()))


def lamps(seed: int, height: int = 64) -> Tensor:
    """A smooth map [3, height, 2 height] of mean luminance 1."""
    generator = Generator().manual_seed(seed)
    towards = torch.nn.functional.normalize(torch.randn(3, 3, generator=generator), dim=1)
    colours = torch.rand(3, 3, generator=generator)
    near = torch.einsum("lc,chw->lhw", towards, texel_directions(height, 2 * height))
    light = 0.2 + torch.einsum("lhw,lc->chw", (4 * (near - 0.5)).exp(), colours)
    return light / mean_luminance(light)


def task_of(light: Tensor, name: str = "lamps") -> Task:
    photos = photograph_spheres(light.expand(2, -1, -1, -1), Generator().manual_seed(1))
    photos = (photos * 255).round().to(torch.uint8)
    return Task(name, {"map": light, "scale": torch.tensor(3.0), "photos": photos})


@pytest.fixture
def app() -> Illumination:
    return REFERENCE


@pytest.fixture
def tasks(app: Illumination) -> Tasks:
    return stack_tasks(app, [task_of(lamps(seed), f"lamps-{seed}") for seed in range(4)])


def app_with_fixed_maps(app: Illumination, maps: Tensor) -> Illumination:
    """The application whose fits have these maps [T, 3, H, W], whatever the parameters of their networks."""

    class FixedMaps(LightField):
        @override
        def __call__(self, theta: Params, seen: object = None) -> Lighting:
            return super().__call__(theta)._replace(maps=maps)

    return replace(app, decoder=FixedMaps(app.decoder.network))


def exact(app: Illumination, tasks: Tasks) -> tuple[Illumination, Params]:
    """The application whose fits have the tasks' maps, and parameters of as many fits."""
    return app_with_fixed_maps(app, tasks.data["map"][tasks.rows]), app.init(Generator().manual_seed(0), len(tasks))


def photo_batch(photos: Tensor) -> Batch:
    """What fits see of photographs of spheres that are no mirrors."""
    return BallSight().observe(describe_maps(torch.zeros(len(photos), 3, 8, 16)), photos)._asdict()


# What the encoder sees


def test_a_ball_is_unwrapped_to_what_it_mirrors_and_faces() -> None:
    # what a perfect mirror shows at a pixel is the map where it reflects the view
    size = 64
    centre = (torch.arange(size) + 0.5) * (2 / size) - 1
    x, y = centre.expand(size, size), -centre[:, None].expand(size, size)
    z = (1 - x * x - y * y).clamp_min(0).sqrt()
    reflected = torch.stack([2 * z * x, 2 * z * y, 2 * z * z - 1])
    seen = unwrap_photos(0.5 * reflected[None] + 0.5, 16, 32)[0, :3] * 2  # [-1, 1], as 0.5 is taken off
    towards = texel_directions(16, 32)
    front = towards[2] > -0.6
    assert (seen - towards)[:, front].abs().max() < 0.12
    assert (seen - towards)[:, front].abs().mean() < 0.03  # it looks 3 % inside of where that is
    # what faces is looked up where it faces
    normals = torch.stack([x, y, torch.zeros(size, size)])
    seen = unwrap_photos(0.5 * normals[None] + 0.5, 16, 32)[0, 3:6] * 2
    front = towards[2] > 0.1
    assert (seen - towards)[:2, front].abs().max() < 0.05


# Losses and protocols


def test_the_true_map_has_no_loss(app: Illumination, tasks: Tasks) -> None:
    app, theta = exact(app, tasks)
    batch = app.sample(tasks, Generator(), 1)
    assert app.loss(theta, batch, {}).max() < 1e-5
    assert app.errors(theta, tasks)["map"].max() < 1e-5
    initial = app.initial_loss_parameters(1)
    smoothed = app.loss(theta, batch, {key: value[0].expand(4) for key, value in initial.items()})
    assert smoothed.abs().max() < 1e-5


def test_the_true_map_sphere_and_camera_look_like_the_photo(tasks: Tasks, rng: Generator) -> None:
    photo, theta = exact(PHOTO, tasks)
    theta |= {"body": 0.5 / BALL_AND_CAMERA_GAIN * torch.randn(4, BALL_AND_CAMERA_NUMBERS, generator=rng)}
    material, camera = decode_ball_and_camera(BALL_AND_CAMERA_GAIN * theta["body"])
    seen = develop(render_material_spheres(tasks.data["map"], material, 64, BALL_ROUGHNESSES), camera).clamp_max(1)
    batch = photo_batch((seen * 255).round())  # black around the sphere
    assert photo.loss(theta, batch, {}).max() < 0.005  # rounding, and means of display values
    darker = {**theta, "body": theta["body"] - torch.eye(BALL_AND_CAMERA_NUMBERS)[7] / BALL_AND_CAMERA_GAIN}
    assert photo.loss(darker, batch, {}).min() > 0.05


def test_clipped_parts_of_a_photo_may_have_any_brightness(tasks: Tasks) -> None:
    photo = PHOTO
    theta = photo.init(Generator().manual_seed(0), 4)
    batch = photo_batch(torch.full((4, 3, 64, 64), 255.0))
    bright = {**theta, "body": theta["body"] + 12 / BALL_AND_CAMERA_GAIN * torch.eye(BALL_AND_CAMERA_NUMBERS)[7]}
    assert photo.loss(bright, batch, {}).max() < 1e-4
    dark = {**theta, "body": theta["body"] - 4 / BALL_AND_CAMERA_GAIN * torch.eye(BALL_AND_CAMERA_NUMBERS)[7]}
    assert photo.loss(dark, batch, {}).min() > 0.05


def test_fits_see_the_map_or_the_photo_by_protocol(tasks: Tasks) -> None:
    small, reference, photo = REFERENCE.init(Generator().manual_seed(0), 4), REFERENCE, PHOTO
    batch = reference.outer_sample(tasks, Generator(), 1)
    ball = batch | photo_batch(batch["photo"])
    for app, batch_of_app, seen, unseen in ((reference, batch, "map", "photo"), (photo, ball, "photo", "map")):
        before = app.loss(small, batch_of_app, {})
        torch.testing.assert_close(app.loss(small, {**batch_of_app, unseen: batch[unseen] * 0}, {}), before)
        assert not torch.allclose(app.loss(small, {**batch_of_app, seen: batch[seen] * 0}, {}), before)
    torch.testing.assert_close(
        mean_luminance(photo.prediction(small, SeenBall(**photo_batch(batch["photo"])))), torch.ones(4)
    )
    brighter = {
        **small,
        "out.shift": small["out.shift"] + 1,
        "body": small["body"] - torch.eye(BALL_AND_CAMERA_NUMBERS)[7] / BALL_AND_CAMERA_GAIN,
    }
    torch.testing.assert_close(
        photo.outer_loss(brighter, ball, {}), photo.outer_loss(small, ball, {})
    )  # nobody could tell
    assert not torch.allclose(reference.loss(brighter, batch, {}), reference.loss(small, batch, {}))


# Mirrors


def mirror_ball_task(light: Tensor, clip: float = 1e9) -> Task:
    """A task whose mirror shows the front half of the sphere, up to a radiance, at twice the map's scale."""
    task, towards = task_of(light), texel_directions(*light.shape[1:])
    front, clips = (towards[2] > 0).float(), (light.amax(0) > clip).float()
    shares = torch.stack([front * (1 - clips), front * clips])
    return task._replace(data=task.data | {"seen": 2 * light.clamp(max=clip), "certain": shares})


def test_a_mirror_is_taken_as_it_is_and_fits_in_its_unit(rng: Generator) -> None:
    app, light = PHOTO, lamps(2)
    tasks = stack_tasks(app, [mirror_ball_task(light)])
    theta, front = app.init(rng, 1), texel_directions(8, 16)[2] > 0
    prediction, target = app.prediction(theta, app.sight.gather(tasks))[0], tasks.data["map"][0]
    # the rest is the network's, but for its scale
    for ratio in ((prediction / target)[:, front], (prediction / app.decoder(theta).maps[0])[:, ~front]):
        torch.testing.assert_close(ratio, ratio.mean().expand(3, 64), rtol=1e-4, atol=0)
    app, theta = exact(app, tasks)
    torch.testing.assert_close(
        app.prediction(theta, app.sight.gather(tasks)), tasks.data["map"] / mean_luminance(tasks.data["map"])
    )
    assert app.loss(theta, app.sample(tasks, rng, 1), {}).max() < 1e-5  # at whatever scale


def test_clipped_parts_of_a_mirror_are_at_least_as_bright(rng: Generator) -> None:
    app, light = PHOTO, torch.ones(3, 64, 128)
    light[:, :, 64:72] = 20.0  # the texels of a column of the field's
    light /= mean_luminance(light)
    tasks = stack_tasks(app, [mirror_ball_task(light, clip=2.0)])
    target, batch = tasks.data["map"], app.sample(tasks, rng, 1)
    app, theta = exact(app, tasks)
    torch.testing.assert_close(app.prediction(theta, app.sight.gather(tasks)), target)  # though it was seen as 2
    assert app.loss(theta, batch, {}).max() < 1e-5
    app = app_with_fixed_maps(app, target.clamp(max=1.0))
    assert app.loss(theta, batch, {}).min() > 0.01
    prediction = app.prediction(theta, app.sight.gather(tasks))[0, 0]
    torch.testing.assert_close(
        prediction[4, 8] / prediction[4, 6], CLIPPED_LIGHT_FACTOR * 2 / light[0, 0, 0]
    )  # what is lost usually


# Made-up tasks


def test_variants_are_the_maps_turned_and_mirrored_and_tinted(tasks: Tasks, rng: Generator) -> None:
    maps = tasks.data["map"]
    for found, original in zip(turn_maps(maps, Generator().manual_seed(5)), maps, strict=True):
        candidates = [start.roll(turn, -1) for turn in range(16) for start in (original, original.flip(-1))]
        distances = [float((candidate - found).abs().mean()) for candidate in candidates]
        assert min(distances) == 0 < sorted(distances)[len(distances) // 2]
    # and tinted
    ratio = (tint_maps(maps, rng) / maps).flatten(2)
    torch.testing.assert_close(ratio, ratio[..., :1].expand_as(ratio))
    assert ratio[..., 0].std(1).min() > 0


def test_some_variants_are_regraded_or_mixed(tasks: Tasks, rng: Generator) -> None:
    maps = tasks.data["map"].repeat(8, 1, 1, 1)
    power = (regrade_maps(maps, rng).log() / maps.log()).flatten(1).median(1).values
    assert 6 < (power != 1).sum() < 26
    assert 0.7 < power.min() < power.max() < 1.4
    found = mix_maps(maps, rng)
    distance, other = ((found - originals).flatten(1).norm(dim=1) for originals in (maps, maps.roll(1, 0)))
    torch.testing.assert_close(distance + other, (maps - maps.roll(1, 0)).flatten(1).norm(dim=1))  # in between
    assert 4 < (distance > 0).sum() < 20


def test_some_variants_get_lamps(rng: Generator) -> None:
    dark = torch.zeros(64, 3, 16, 32)
    added = add_lamps(dark, rng)
    bright = (added.amax(1) > 0).flatten(1).sum(1)
    assert 10 < (bright > 0).sum() < 33  # about a third
    assert bright.max() <= 4 * LAMP_COUNT  # each lies between four texels at most
    assert added.amin() == 0
    assert torch.isfinite(added).all()
    columns = torch.cat([add_lamps(dark, rng) for _ in range(8)]).amax((1, 2)) > 0
    assert columns.any(0).all()  # at the seam, too


# Outputs


def test_the_error_is_of_the_second_scene(app: Illumination, tasks: Tasks) -> None:
    app, theta = exact(app, tasks)
    errors = app.errors(theta, tasks)
    assert errors["error"].max() < 1e-5
    # a map's mean luminance is known: 1
    maps = tasks.data["map"]
    assert app_with_fixed_maps(app, 1.1 * maps).errors(theta, tasks)["error"].max() < 1e-5
    others = maps.roll(1, 0)
    found = app_with_fixed_maps(app, 1.1 * others).errors(theta, tasks)["error"]
    expected = (relight(others) - relight(maps)).abs().mean((1, 2, 3))
    assert expected.min() > 0.01
    torch.testing.assert_close(found, expected, rtol=1e-3, atol=0)


def test_maps_are_written_at_the_scale_of_the_input(rng: Generator) -> None:
    app = REFERENCE
    theta = {key: value[0] for key, value in app.init(rng, 1).items()}
    files = asset_of(app, theta, task_of(lamps(0))).pictures()
    fitted = app.decoder({key: value[None] for key, value in theta.items()}).maps[0]
    fitted = fitted / mean_luminance(fitted[None])[0]  # 1, as all that are fitted; 3 is the file's
    torch.testing.assert_close(files["map"].pixels, 3 * fitted.permute(1, 2, 0))
    relit = files["relit"].pixels
    assert relit.shape == (64, 96, 3)
    assert 0 <= relit.min() < relit.max() <= 1
    assert {name: picture.kind for name, picture in files.items()} == {"map": "radiance", "relit": "srgb"}
