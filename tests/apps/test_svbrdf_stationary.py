"""Stationary svBRDFs: windows, maps, the light of a photo, and that a highlight stays out of the maps."""

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Generator, Tensor

from metapp.appearance.colour import DISPLAY_GAMMA, radiance_to_display, srgb_to_linear
from metapp.appearance.flash import camera_position, relighting_positions, render_maps, texel_positions
from metapp.appearance.height_fields import normal_from_height
from metapp.appearance.svbrdf_maps import Maps, map_statistics
from metapp.apps.exemplar.exemplar_codec import FILE_SIDE_TIMES
from metapp.apps.exemplar.octaves import Octaves
from metapp.apps.svbrdf_stationary.app import SvbrdfStationary, compose_svbrdf
from metapp.apps.svbrdf_stationary.flash_statistics import FLASH_FALLOFF, GLOSS_PRIOR_WEIGHT, FlashStatistics
from metapp.apps.svbrdf_stationary.material_codec import encode_gloss
from metapp.apps.svbrdf_stationary.recipes import FULL, PAPER, QUICK
from metapp.apps.svbrdf_stationary.true_maps import GLOSS_WEIGHT, ROUGHNESS_WEIGHT, TRUTH_WEIGHT
from metapp.apps.svbrdf_stationary.windows import WINDOWS_PER_SIDE, grams_in_windows
from metapp.learning.app import stack_tasks
from metapp.learning.learn import learn, task_loss
from metapp.learning.recipe import Adam
from metapp.learning.rules import fixed_adam
from metapp.learning.task import Params, Task, Tasks
from metapp.networks.generators import UNet
from tests.recipe_apps import asset_of, presenter_of

SIZE = 32
TINY = compose_svbrdf(UNet(4, 3, noise=4, code=4, outputs=6), Octaves(SIZE, SIZE, ("relu1_1",)))
KEPT = compose_svbrdf(TINY.decoder.network, TINY.decoder.octaves, expects_gloss=True)
WINDOWS = range(WINDOWS_PER_SIDE * WINDOWS_PER_SIDE)


def seeded(seed: int = 0) -> Generator:
    return Generator().manual_seed(seed)


def draw_noise(*counts: int) -> Tensor:
    return torch.randn(*counts, TINY.decoder.noise_channels, SIZE, SIZE, generator=seeded())


def glossy(seed: int, size: int = SIZE) -> Maps:
    """A material [1, .., size, size] of two colours in small patches, as shiny as varnish."""
    patches = (torch.rand(1, 1, size // 2, size // 2, generator=seeded(seed)) < 0.5).float()
    patches = patches.repeat_interleave(2, -1).repeat_interleave(2, -2)
    colours = torch.tensor([[0.05, 0.1, 0.2], [0.3, 0.25, 0.1]])[..., None, None]
    ones = torch.ones(1, 1, size, size)
    return Maps(torch.lerp(*colours, patches), 0.3 * ones, 0.35 * ones, normal_from_height(0.2 * patches))


def photo_of(maps: Maps, place: tuple[float, float]) -> Tensor:
    """uint8 [3, size, size], with light and camera above a place of the patch."""
    above = camera_position() + torch.tensor([*place, 0.0])
    shown = radiance_to_display(
        render_maps(maps, texel_positions(*maps.diffuse.shape[-2:]), above, above, falloff=FLASH_FALLOFF)
    )
    return (255 * shown[0]).round().to(torch.uint8)


PLACES = ((0.0, 0.0), (0.3, -0.2), (-0.3, 0.25))


@pytest.fixture(scope="module")
def sources() -> list[Task]:
    return [Task(f"varnish-{i}", {"image": photo_of(glossy(i), place)}) for i, place in enumerate(PLACES)]


@pytest.fixture(scope="module")
def tasks(sources: list[Task]) -> Tasks:
    return stack_tasks(TINY, sources)


def with_statistics(statistics: FlashStatistics) -> SvbrdfStationary:
    """Return TINY with other statistics, which it sees and judges by."""
    return replace(TINY, sight=replace(TINY.sight, statistics=statistics), judge=statistics)


def flat(app: SvbrdfStationary, *raw: float, count: int = 1) -> Params:
    """Parameters of a generator that makes the same everywhere: what its six outputs are before any range."""
    theta = app.init(seeded(), count)
    shift = torch.tensor(raw).expand(count, 6)
    return theta | {"out.kernel": torch.zeros_like(theta["out.kernel"]), "out.shift": shift}


# Windows


def test_windows_cover_the_picture_and_fade_towards_their_edges() -> None:
    """How much each place counts in each window: half as wide as the picture, from edge to edge."""
    counts = []
    for window in WINDOWS:
        maps = torch.ones(1, 1, 16, 24, dtype=torch.float64, requires_grad=True)
        counts.append(torch.autograd.grad(grams_in_windows(maps, [window]).sum(), maps)[0][0, 0])
    weights = torch.stack(counts) / 2  # of a square
    assert (weights.amax(0) > 0).all()
    torch.testing.assert_close(weights.sum((1, 2)), torch.ones(9, dtype=torch.float64))
    for window, weight in enumerate(weights):
        row, column = divmod(window, WINDOWS_PER_SIDE)
        inside = torch.zeros(16, 24, dtype=torch.bool)
        inside[4 * row : 4 * row + 8, 6 * column : 6 * column + 12] = True
        assert torch.equal(weight > 0, inside)
        assert weight[4 * row + 3, 6 * column + 5] == weight.max()
        assert weight[4 * row, 6 * column] < 0.1 * weight.max()
    # together they weigh the picture: least at its rim, which no other window knows
    assert weights.sum(0)[4:12, 6:18].min() > 0.5 * weights.sum(0).max()


# What is compared


def test_a_photo_is_at_no_distance_from_itself(sources: list[Task], tasks: Tasks) -> None:
    theta = TINY.init(seeded(), 3)
    photos = torch.stack([task.data["image"] for task in sources]).float()[:, None] / 255

    def showing(pictures: Tensor) -> SvbrdfStationary:
        class ShownStatistics(FlashStatistics):
            @staticmethod
            def photograph(maps: Maps, light: Tensor, view: Tensor) -> Tensor:
                return pictures.expand(-1, maps.diffuse.shape[1], -1, -1, -1)

        return with_statistics(ShownStatistics(TINY.decoder.octaves))

    app = showing(photos)
    assert app.loss(theta, app.sample(tasks, seeded(), 2), {}).max() < 1e-5
    found = app.errors(theta, tasks)
    assert set(found) == {"error", "spectrum", "brightness"}
    assert all(value.max() < 1e-5 for value in found.values())

    # another photo's: the highlight is elsewhere
    assert showing(photos.roll(1, 0)).errors(theta, tasks)["error"].min() > 0.1
    # windows know where the light is, spectra do not
    turned = showing(photos.flip(-1)).errors(theta, tasks)
    assert (turned["error"][1:] > 0.2).all()
    brighter = showing(photos.sqrt()).errors(theta, tasks)["brightness"]
    torch.testing.assert_close(brighter, (photos.sqrt() - photos).mean((1, 2, 3, 4)), rtol=0.01, atol=0)


# The light


def test_light_position_is_found_from_the_highlight(sources: list[Task], tasks: Tasks) -> None:
    """Found in the photo, and put there, above the camera's plane, whenever a fit is compared with it or shown."""
    lights = tasks.data["light"]
    torch.testing.assert_close(lights[:, :2], torch.tensor(PLACES), rtol=0, atol=0.1)
    torch.testing.assert_close(lights[:, 2], camera_position()[2].expand(3))
    used = []

    class NotedStatistics(FlashStatistics):
        @staticmethod
        def photograph(maps: Maps, light: Tensor, view: Tensor) -> Tensor:
            used.append((light, view))
            return FlashStatistics.photograph(maps, light, view)

    app = with_statistics(NotedStatistics(TINY.decoder.octaves))
    theta = app.init(seeded(), 3)
    app.loss(theta, app.sample(tasks.select([1, 2, 0]), seeded(), 2), {})
    app.errors(theta, tasks)
    presenter_of(app).preview({key: value[0] for key, value in theta.items()}, sources[1])
    for (light, view), expected in zip(used, (lights[[1, 2, 0], None], lights[:, None], lights[1]), strict=False):
        torch.testing.assert_close(light, expected)
        assert torch.equal(light, view)


# Maps


@pytest.mark.parametrize("scale", [0.0, 1.0, 30.0])
def test_maps_stay_in_their_ranges(scale: float) -> None:
    app, theta = TINY, TINY.init(seeded(), 2)
    theta["out.kernel"] = scale * theta["out.kernel"]
    maps, height, *_ = app.decoder.generate(theta, draw_noise(2, 3))
    leading = (2, 3)
    assert [tuple(picture.shape) for picture in (*maps, height)] == [
        (*leading, channels, SIZE, SIZE) for channels in (3, 1, 1, 3, 1)
    ]
    assert 0 <= maps.diffuse.min() <= maps.diffuse.max() <= 1
    assert 0 <= maps.specular.min() <= maps.specular.max() <= 1
    assert 0.1 <= maps.roughness.min() <= maps.roughness.max() <= 1
    torch.testing.assert_close(maps.normal.norm(dim=2), torch.ones(*leading, SIZE, SIZE))
    assert (maps.normal[:, :, 2] > 0).all()
    picture = app.judge.photograph(maps, camera_position(), camera_position())
    assert picture.isfinite().all()
    assert 0 <= picture.min() <= picture.max() <= 1
    if scale == 0:
        assert maps.specular.unique().item() == pytest.approx(0.05, abs=0.01)  # of most things that are not metal
        assert maps.diffuse.unique().item() == pytest.approx(0.5**2.2)


# What a fit makes


def test_files_are_maps_that_tile_and_other_lights(sources: list[Task]) -> None:
    app = TINY
    theta = {key: value[0] for key, value in app.init(seeded(), 1).items()}
    pictures = asset_of(app, theta, sources[0]).pictures()
    files = {name: picture.pixels for name, picture in pictures.items()}
    names = ["diffuse", "specular", "roughness", "normal", "height"]
    assert list(files) == [*names, *(f"lit_from_{name}" for name in relighting_positions())]
    side = FILE_SIDE_TIMES * SIZE
    channels = {"specular": 1, "roughness": 1, "height": 1}
    assert {name: tuple(picture.shape) for name, picture in files.items()} == {
        name: (side, side, channels.get(name, 3)) for name in files
    }
    kinds = {"roughness": "data", "normal": "data", "height": "height"}  # all else are colours
    assert {name: picture.kind for name, picture in pictures.items()} == {
        name: kinds.get(name, "srgb") for name in files
    }
    torch.testing.assert_close((files["normal"] * 2 - 1).norm(dim=2), torch.ones(side, side))
    # what a user loads as maps is what was rendered
    normal = (files["normal"] * 2 - 1).permute(2, 0, 1)
    maps = Maps(
        srgb_to_linear(files["diffuse"]).permute(2, 0, 1),
        srgb_to_linear(files["specular"]).permute(2, 0, 1),
        files["roughness"].permute(2, 0, 1),
        normal,
    )
    for name, (light, view) in relighting_positions().items():
        shown = app.judge.photograph(maps, light, view).permute(1, 2, 0)
        torch.testing.assert_close(files[f"lit_from_{name}"], shown, rtol=0, atol=2e-3)
    # maps tile, also normals, which look at their neighbours
    for name in names:
        for axis in (0, 1):
            differences = (files[name] - files[name].roll(1, axis)).abs().movedim(axis, 0).flatten(1).mean(1)[::4]
            assert 0.5 < differences[0] / differences[1:].mean() < 1.6, name


@pytest.mark.parametrize("factor", [0.0, 1.0, 2.0])
def test_slopes_and_heights_are_shown_times_a_factor(sources: list[Task], factor: float) -> None:
    """Files, surfaces and previews are scaled.

    The fit that is compared with the photo is not; a factor of 1 changes nothing.
    """
    theta = {key: value[0] for key, value in TINY.init(seeded(), 1).items()}
    plain, steeper = presenter_of(TINY), presenter_of(TINY, {"relief": factor})
    assets = [asset_of(TINY, theta, sources[0], options) for options in ({}, {"relief": factor})]
    before, after = (asset.linear_maps() for asset in assets)
    torch.testing.assert_close(after["height"], factor * before["height"])
    slopes = [maps["normal"][..., :2] / maps["normal"][..., 2:] for maps in (before, after)]
    torch.testing.assert_close(slopes[1], factor * slopes[0])
    shown = assets[1].pictures()["normal"].pixels
    torch.testing.assert_close(shown, after["normal"] * 0.5 + 0.5)
    fits = [presenter.preview(theta, sources[0]) for presenter in (plain, steeper)]
    same = {name for name, picture in fits[0].items() if torch.equal(picture, fits[1][name])}
    moved = {"normal", "height", *(f"lit_from_{name}" for name in relighting_positions())}
    assert same >= fits[0].keys() - moved
    assert ("normal" in same) == (factor == 1)
    assert steeper.remarks(theta, sources[0]) == plain.remarks(theta, sources[0]) != {"mean_tilt_degrees": 0}


def test_the_highlight_moves_with_light_and_viewer(sources: list[Task]) -> None:
    """The highlight of a flat material is where light and viewer mirror each other."""
    app = TINY
    theta = {key: value[0] for key, value in flat(app, -3.0, -3.0, -3.0, -2.5, -1.5, 0.0).items()}
    pictures = asset_of(app, theta, sources[0]).pictures()
    files = {name: picture.pixels for name, picture in pictures.items()}
    assert files["height"].max() == 0
    places = texel_positions(FILE_SIDE_TIMES * SIZE, FILE_SIDE_TIMES * SIZE).flatten(1)
    found = {}
    for name, (light, view) in relighting_positions().items():
        picture = files[f"lit_from_{name}"].mean(2).flatten()
        assert picture.max() < 1
        found[name] = places[:, picture.argmax()]
        mirror = (light[:2] * view[2] + view[:2] * light[2]) / (light[2] + view[2])
        torch.testing.assert_close(found[name], mirror, rtol=0, atol=0.08)
    assert found["left"][0] < -0.3
    assert found["above"][1] > 0.3


def test_references_under_other_lights_are_compared(sources: list[Task]) -> None:
    app = TINY
    theta = flat(app, 0.5, -0.5, 0.0, 0.5, -1.0, 0.0)
    maps, place = app.decoder.generate(theta, draw_noise(1, 1)).prediction, camera_position()
    whole = Maps(*(part[0] for part in maps))

    def as_bytes(light: Tensor, view: Tensor) -> Tensor:
        return (255 * app.judge.photograph(whole, light, view)[0]).round().to(torch.uint8)

    image = as_bytes(place, place)
    relit = torch.stack([as_bytes(light, view) for light, view in relighting_positions().values()])
    task = Task("flat", {"image": image, "relit": relit})
    found = app.errors(theta, stack_tasks(app, [task]))
    assert found["relit"].shape == (1,)
    assert found["relit"] < 0.02
    other = app.errors(flat(app, 0.5, -0.5, 0.0, 2.5, 1.0, 0.0), stack_tasks(app, [task]))
    assert other["relit"] > 0.1
    assert "relit" not in app.errors(theta, stack_tasks(app, sources[:1]))
    assert "relit" not in app.augment(stack_tasks(app, [task]), seeded()).data


def test_the_outer_loss_knows_the_truth_where_a_task_has_it(sources: list[Task]) -> None:
    app = TINY
    theta = app.init(seeded(), 1)
    noise = draw_noise(1, 1)
    statistics = map_statistics(app.decoder.generate(theta, noise).prediction)[0]
    image = sources[0].data["image"]

    def loss_of(truth: Tensor) -> Tensor:
        tasks = stack_tasks(app, [Task("known", {"image": image, "truth": truth})])
        return app.outer_loss(theta, app.outer_sample(tasks, seeded(), 1) | {"noise": noise}, {})

    unequal = torch.cat([statistics.expand(2, -1, -1) + 0.5, statistics])  # of other sizes than the network's
    others = torch.full((2, 6), 0.1)
    others[0, 3:5] = 0  # mean specular and roughness, which count by their logits, too
    there, off = loss_of(unequal), loss_of(unequal + others)
    torch.testing.assert_close(off - there, torch.tensor([0.1 * TRUTH_WEIGHT * 10 / 12]))
    for channel, share in ((3, lambda shown: shown**DISPLAY_GAMMA), (4, lambda roughness: (roughness - 0.1) / 0.9)):
        more = torch.zeros(2, 6)
        more[0, channel] = 0.1
        logits = [torch.logit(share(truth[-1, 0, channel])) for truth in (unequal, unequal + more)]
        expected = 0.1 * TRUTH_WEIGHT / 12 + GLOSS_WEIGHT * (logits[1] - logits[0]).abs()
        found = loss_of(unequal + more) - there
        torch.testing.assert_close(found, expected[None], atol=0.01, rtol=0)  # maps vary a little


def test_prior_adds_the_mean_square_deviation_from_usual_maps(sources: list[Task]) -> None:
    """Maps of one value each: its part of the loss is the mean square of what is off, and quick fits have none."""
    tasks = stack_tasks(KEPT, sources[:1])
    found = []
    for specular, roughness in ((0.0, 0.0), (0.5, 0.0), (0.0, -1.5)):
        theta = flat(KEPT, 0.5, -0.5, 0.0, specular, roughness, 0.0)
        batch = KEPT.sample(tasks, seeded(), 1)
        found.append(KEPT.loss(theta, batch, {}) - TINY.loss(theta, batch, {}))
    torch.testing.assert_close(
        torch.cat(found), GLOSS_PRIOR_WEIGHT * torch.tensor([0.0, 0.25, ROUGHNESS_WEIGHT * 2.25])
    )
    apps: list[Any] = [recipe.app for recipe in (QUICK, PAPER, FULL)]
    assert [app.decoder.expects_gloss for app in apps] == [False, False, True]


def test_true_maps_are_permuted_with_their_channels(sources: list[Task]) -> None:
    truth = torch.arange(36.0).view(3, 2, 6) / 36
    tasks = stack_tasks(TINY, [Task("known", {"image": sources[0].data["image"], "truth": truth})])
    unturned = torch.tensor([False])
    found = TINY.judge.vary_truth(tasks, unturned, unturned, torch.tensor([[2, 0, 1]]))["truth"][0]
    torch.testing.assert_close(found, truth[..., [2, 0, 1, 3, 4, 5]])
    assert TINY.augment(tasks, seeded()).data["truth"].shape == (1, 3, 2, 6)
    # photographs without it go beside those with it
    known = Task("known", {**sources[0].data, "truth": truth})
    for both in ([known, sources[1]], [sources[1], known]):
        assert "truth" not in stack_tasks(TINY, both).data


def test_variants_are_photos_with_lights_of_their_own(tasks: Tasks) -> None:
    """Mirrored and transposed, never cropped: the light stays as far from the centre, and in the picture."""
    app, lights = TINY, []
    for seed in range(12):
        variants = app.augment(tasks.select([1]), seeded(seed))
        lights.append(variants.data["light"][0, :2])
        assert set(variants.data) == set(tasks.data) - {"image"}
    found = torch.stack(lights)
    torch.testing.assert_close(found.norm(dim=1), tasks.data["light"][1, :2].norm().expand(12), rtol=0.1, atol=0.01)
    assert (found[:, 0] > 0.1).any()
    assert (found[:, 0] < -0.1).any()
    torch.testing.assert_close(variants.data["pooled"].sum(), tasks.data["pooled"][1].sum(), rtol=1e-3, atol=0)


def test_fits_expect_the_gloss_that_general_predicts(sources: list[Task]) -> None:
    """Uniform maps of any gloss are as expected where General made them, and no step moves what is expected."""
    tasks, rng = stack_tasks(KEPT, sources[:1]), seeded()
    predicted = flat(KEPT, 0.5, -0.5, 0.0, 0.5, -1.5, 0.0)
    encoder = KEPT.init_encoder(rng)
    assert "decoder.gloss" not in encoder
    encoder |= {f"decoder.{key}": value[0] for key, value in predicted.items() if key not in ("z", "gloss")}
    unclear = KEPT.encoder_input(tasks, rng) | {"shine": torch.tensor([[0.0, 3.0, 2.0]])}
    theta = KEPT.encode(encoder, unclear)
    torch.testing.assert_close(theta["gloss"], torch.tensor([[0.5, -1.5]]))
    batch = KEPT.sample(tasks, seeded(), 1)
    torch.testing.assert_close(KEPT.loss(theta, batch, {}), TINY.loss(theta, batch, {}))
    moved = learn(theta, fixed_adam(Adam(0.1), theta, 3), tasks, task_loss(KEPT, 1), steps=3, rng=rng)
    assert torch.equal(moved["gloss"], theta["gloss"])
    assert not torch.equal(moved["out.shift"], theta["out.shift"])
    assert "gloss" not in TINY.encode(encoder, KEPT.encoder_input(tasks, rng))


@pytest.mark.parametrize("specular_before", [0.5, -12.0])  # a General whose specular is 3e-7 everywhere, too
def test_a_clear_highlight_says_the_gloss_that_fits_begin_with(specular_before: float) -> None:
    """Fits of polished stone begin with the photo's gloss, and fits of cloth with General's."""
    ones, up = torch.ones(1, 1, 128, 128), torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(1, 3, 128, 128)
    photos = [
        photo_of(Maps(0.2 * ones.expand(1, 3, -1, -1), specular * ones, roughness * ones, up), (0.0, 0.0))
        for specular, roughness in ((0.04, 0.25), (0.04, 0.8))
    ]
    tasks = stack_tasks(KEPT, [Task(str(i), {"image": photo}) for i, photo in enumerate(photos)])
    encoder = KEPT.init_encoder(seeded())
    predicted = flat(KEPT, 0.5, -0.5, 0.0, specular_before, -1.5, 0.0)
    encoder |= {f"decoder.{key}": value[0] for key, value in predicted.items() if key not in ("z", "gloss")}
    theta = KEPT.encode(encoder, KEPT.encoder_input(tasks, seeded()))
    maps = KEPT.decoder.generate(theta, draw_noise(1, 1).expand(2, -1, -1, -1, -1)).prediction
    polished, cloth = maps.roughness.mean((1, 2, 3, 4)).tolist()
    assert polished == pytest.approx(0.25, rel=0.2)
    assert cloth == pytest.approx(0.1 + 0.9 * float(torch.sigmoid(torch.tensor(-1.5))))
    assert float(maps.specular[0].mean()) == pytest.approx(0.04, rel=0.5)
    again = theta["gloss"] - torch.stack(
        [encoded.mean((1, 2, 3, 4)) for encoded in encode_gloss(maps.specular, maps.roughness)], -1
    )
    assert float(again.abs().max()) < 1e-3
