"""Several photographs of one material: photometric stereo in closed form, the loss, all paradigms on small maps."""

import itertools
import re
from dataclasses import replace

import pytest
import torch
from torch import Generator, Tensor

from data_tools.readers.svbrdf_task import make_svbrdf_task, render_flash_photo
from data_tools.synthetic.svbrdf_nonstationary import synthetic_tasks
from metapp.appearance.flash import camera_distance, directions_to_point, texel_positions
from metapp.appearance.svbrdf_maps import Maps, pack_maps, unpack_maps
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.flashes import FLASH_NUMBERS, decode_flash, render_photos
from metapp.apps.svbrdf_nonstationary.maps import CHANNELS, decode_maps, decode_photo, encode_maps
from metapp.apps.svbrdf_nonstationary.multi_photo import stereo
from metapp.apps.svbrdf_nonstationary.multi_photo.photo_sets import draw_photo_sets
from metapp.apps.svbrdf_nonstationary.multi_photo.recipe import SEVERAL, of_several
from metapp.apps.svbrdf_nonstationary.places import held_places
from metapp.learned_rules import rule_of
from metapp.learning.app import stack_tasks
from metapp.learning.learn import MetaParameters
from metapp.learning.task import Params, Task, Tasks
from metapp.paradigms import PARADIGMS
from metapp.paradigms.methods import descend_tasks, make_method
from metapp.storage.parameters import check_params
from tests.apps.test_svbrdf_nonstationary import material
from tests.recipe_apps import presenter_of

SIDE, COUNT = 16, 3


def several(seed: int, count: int = COUNT) -> Task:
    """A task of so many photos, from known places."""
    maps, places = material(seed), held_places(1, count, Generator().manual_seed(seed))[0][0]
    photos = [render_flash_photo(maps, place, float((place[2] / camera_distance()) ** 2), place) for place in places]
    task = make_svbrdf_task(f"material-{seed}", maps, photo=photos[0])
    return task._replace(
        data=task.data | {"others": torch.stack(photos[1:]), "places": places[:, None].repeat(1, 2, 1)}
    )


@pytest.fixture
def app() -> SvbrdfNonstationary:
    return of_several(SIDE, SIDE)


@pytest.fixture
def tasks(app: SvbrdfNonstationary) -> Tasks:
    return stack_tasks(app, [several(seed) for seed in range(2)])


def general(app: SvbrdfNonstationary, tasks: Tasks) -> Params:
    """Parameters that an untrained General predicts."""
    with torch.no_grad():
        return app.encode(app.init_encoder(Generator().manual_seed(0)), app.encoder_input(tasks, Generator()))


def relief(side: int) -> Maps:
    """A Lambertian material of smooth relief, slopes up to 0.4 about a mean of 0."""
    x, y = torch.meshgrid(*(2 * [torch.linspace(0, 2 * torch.pi, side + 1)[:-1]]), indexing="xy")
    slopes = 0.4 * torch.stack([(2 * x).sin() * y.cos(), (x + y).cos()])[None]
    normal = torch.cat([slopes, torch.ones(1, 1, side, side)], 1)
    diffuse = 0.3 + 0.2 * torch.stack([x.sin(), y.cos(), (x - y).sin()])[None]
    none = torch.zeros(1, 3, side, side)
    return Maps(diffuse, none, none[:, :1] + 0.5, normal / normal.norm(dim=1, keepdim=True))


PLACES = torch.tensor([[0.0, 0, 2.4], [1.2, 0.3, 2.2], [-0.9, 0.9, 2.5], [-0.3, -1.3, 2.0], [0.8, -0.7, 3.0]])


def test_stereo_is_exact_on_lambertian_texels() -> None:
    """Slopes are exact but for the ridge, which draws them to 0 by the share that it states."""
    maps, places = relief(32), PLACES[None, :, None].expand(1, 5, 2, 3)
    wi, squared = directions_to_point(places[:, :, 1], texel_positions(32, 32))
    white = wi[:, :, 2:] * places[:, :, 1, 2, None, None, None].square() / squared
    flash = torch.zeros(1, 5, FLASH_NUMBERS)
    brightness = render_photos(maps, decode_flash(flash, places)).mean(2, keepdim=True) / white
    expected = maps.normal[:, :2] / maps.normal[:, 2:]
    ones = torch.ones_like(brightness)
    level, slopes, _, unknown = stereo.photometric_stereo(brightness, wi[:, :, :2] / wi[:, :, 2:], ones, 0 * ones)
    assert unknown.max() < 0.1
    bound = 0.4 * unknown.sum(1, keepdim=True) + 0.02  # and slopes above STEEPEST_SLOPE are less steep
    assert ((slopes - expected).abs() < bound).all()
    body = maps.diffuse.mean(1, keepdim=True) * maps.normal[:, 2:]
    torch.testing.assert_close(level, body, rtol=0.03, atol=0)
    reading = stereo.read_stereo(render_photos(maps, decode_flash(flash, places)), places)
    cosine = torch.nn.functional.cosine_similarity(reading.maps[:, :2].flatten(), expected.flatten(), 0)
    assert float(cosine) > 0.98  # exposures and lobes are looked for, too


def test_exposures_of_photographs_are_solved() -> None:
    maps, places = relief(32), PLACES[None, :, None].expand(1, 5, 2, 3)
    gains = torch.tensor([0.4, -0.3, 0.0, -0.4, 0.3])
    photos = 0.5 * render_photos(maps, decode_flash(torch.zeros(1, 5, FLASH_NUMBERS), places))
    plain, changed = (
        stereo.read_stereo(measured, places) for measured in (photos, photos * gains.exp()[:, None, None, None])
    )
    torch.testing.assert_close(changed.gains - plain.gains, gains[None], rtol=0, atol=0.01)
    torch.testing.assert_close(changed.maps[:, :2], plain.maps[:, :2], rtol=0, atol=0.03)


def test_the_order_of_photographs_does_not_matter(app: SvbrdfNonstationary, tasks: Tasks) -> None:
    seen, encoder = app.sight.gather(tasks), app.init_encoder(Generator().manual_seed(0))
    one = app.encode(encoder, app.encoder.select_input(seen))
    loss = app.loss(one, seen._asdict(), {})
    for order in map(list, itertools.permutations(range(COUNT))):
        ordered = {key: getattr(seen, key)[:, order] for key in ("photos", "shows_material", "places")}
        reordered = seen._replace(**ordered)
        other = app.encode(encoder, app.encoder.select_input(reordered))
        torch.testing.assert_close(other["maps"], one["maps"], rtol=1e-3, atol=1e-3)
        torch.testing.assert_close(other["flash"], one["flash"][:, :, order], rtol=1e-3, atol=1e-3)
        same = one | {"flash": one["flash"][:, :, order]}
        torch.testing.assert_close(app.loss(same, reordered._asdict(), {}), loss)


def truth(tasks: Tasks) -> Tensor:
    """RAW numbers of the tasks' own maps."""
    return encode_maps(unpack_maps(tasks.data["maps"]))


def test_true_maps_from_true_places_have_the_least_loss(app: SvbrdfNonstationary, tasks: Tasks) -> None:
    batch = app.sample(tasks, Generator(), 1)
    theta = {"maps": truth(tasks), "flash": torch.zeros(2, FLASH_NUMBERS, COUNT), "falloff": torch.zeros(2, 1)}
    torch.testing.assert_close(
        decode_maps(theta["maps"]).normal, unpack_maps(tasks.data["maps"]).normal, rtol=0, atol=1e-3
    )
    least = app.loss(theta, batch, {})
    assert (least / SIDE**2 < 0.03).all()  # the maps are the photos' means, and 8 bits
    for axis, off in ((0, 1.0), (2, 1.0), (3, 1.0)):
        moved = theta["flash"].clone()
        moved[:, axis, 1] = off
        assert (app.loss(theta | {"flash": moved}, batch, {}) > least).all(), axis
    prior = theta | {"prior": torch.cat([theta["maps"], torch.zeros_like(theta["maps"])], 1)}
    without_others = app.sight.settings({}, theta["maps"]) | {"curl": torch.full((2,), -30.0)}
    torch.testing.assert_close(app.loss(prior, batch, without_others), least)
    away = prior | {"prior": prior["prior"] + 1}
    assert (app.loss(away, batch, {}) > least).all()


def test_gradients_are_those_of_finite_differences(app: SvbrdfNonstationary, tasks: Tasks) -> None:
    batch = {key: value.double() for key, value in app.sample(tasks.select([0]), Generator(), 1).items()}
    batch |= {
        "photos": batch["photos"][..., :4, :4].clamp_max(0.9),
        "shows_material": batch["shows_material"][..., :4, :4],
    }
    theta = {key: value.double() for key, value in general(app, tasks.select([0])).items()}
    theta = {key: value[..., :4, :4] if key in ("maps", "prior") else value for key, value in theta.items()}
    noise = torch.randn(theta["maps"].shape, generator=Generator().manual_seed(0), dtype=torch.float64)
    loss_parameters = {key: value.double() for key, value in app.initial_loss_parameters(1).items()}
    moving = [theta["maps"] + 0.1 * noise, theta["flash"].clone(), theta["falloff"] + 0.3]

    def loss(maps: Tensor, flash: Tensor, falloff: Tensor) -> Tensor:
        return app.loss(theta | {"maps": maps, "flash": flash, "falloff": falloff}, batch, loss_parameters)

    assert torch.autograd.gradcheck(loss, [values.requires_grad_() for values in moving])


@pytest.mark.parametrize("count", [2, 5, 9])
def test_all_paradigms_fit_any_number_of_photographs(app: SvbrdfNonstationary, count: int) -> None:
    """Each fit has a lower loss than its initialisation, and none moves the prior."""
    tasks = stack_tasks(app, [several(0, count)])
    recipe = replace(SEVERAL, app=app, steps=3, overfit_steps=5, finetune_steps=4)
    encoder = app.init_encoder(Generator().manual_seed(0))
    random = {key: value[0] for key, value in app.init(Generator(), 1).items()}
    alpha = rule_of(SEVERAL.rule).initial_alpha(app, random, 3, recipe.quickft)
    phis = {"overfit": MetaParameters(), "meta": MetaParameters(alpha=alpha, encoder=encoder)}
    batch = app.sample(tasks, Generator(), 1)
    for name in PARADIGMS:
        method = make_method(name, app, recipe, phis.get(name, MetaParameters(encoder=encoder)))
        steps = list(descend_tasks(method, tasks, Generator()))
        first, last = steps[0].theta, steps[-1].theta
        assert last["maps"].shape == (1, sum(CHANNELS), SIDE, SIDE)
        assert last["flash"].shape == (1, FLASH_NUMBERS, count)
        assert (len(steps) > 1) == (name != "general")
        if name != "general":
            assert (app.loss(last, batch, {}) < app.loss(first, batch, {})).all(), name
        assert ("prior" in last) == (name != "overfit")
        if "prior" in last:
            assert torch.equal(last["prior"], first["prior"])
        assert set(app.postprocess(last)) == {"maps", "flash", "falloff"}


def test_overfit_begins_with_the_roughness_that_photographs_tell(app: SvbrdfNonstationary) -> None:
    for roughness in (0.25, 0.7):
        maps = relief(SIDE)._replace(specular=torch.full((1, 3, SIDE, SIDE), 0.04))
        maps = maps._replace(roughness=torch.full((1, 1, SIDE, SIDE), roughness))
        places = PLACES[:, None].expand(5, 2, 3)
        photos = (render_photos(maps, decode_flash(torch.zeros(1, 5, FLASH_NUMBERS), places[None]))[0]).clamp(0, 1)
        known = pack_maps(Maps(*(part[0] for part in maps)))
        shown = (photos.clamp_min(0) ** (1 / 2.2) * 255).round().to(torch.uint8)
        task = make_svbrdf_task("relief", known, photo=shown[0])
        tasks = stack_tasks(app, [task._replace(data=task.data | {"others": shown[1:], "places": places})])
        found = decode_maps(app.task_parameters(tasks)["maps"]).roughness
        assert float((found - roughness).abs().max()) < 0.12


def test_maps_of_finer_photographs_take_their_detail_as_diffuse_colour(app: SvbrdfNonstationary, tasks: Tasks) -> None:
    theta = {key: value[:1] for key, value in general(app, tasks).items()}
    even = torch.full((1, 3, 2 * SIDE, 2 * SIDE), 0.3)
    striped = even.clone()
    striped[..., ::2] *= 1.5
    one, other = (app.decoder.make_maps(theta, photo) for photo in (even, striped))
    assert one.diffuse.shape == (1, 3, 2 * SIDE, 2 * SIDE)
    assert torch.equal(one.normal, other.normal)
    assert ((other.diffuse / one.diffuse)[..., ::2] > 1.1).all()
    assert ((other.diffuse / one.diffuse)[..., 1::2] < 0.95).all()


def test_highlights_are_doubted_that_clip_in_all_photographs(app: SvbrdfNonstationary, tasks: Tasks) -> None:
    photos = tasks.data["photos"].clamp_max(0.5).clone()
    photos[0, 0] = 1
    stacked = replace(tasks, data=tasks.data | {"photos": photos, "photo": photos[:, 0]})
    theta = general(app, stacked)
    presenter = presenter_of(app)
    assert not any("clipped" in line for lines in presenter.quality_warnings(theta, stacked) for line in lines)
    maps = app.decoder.make_maps(theta, photos[:, 0])
    assert all(map(torch.equal, app.prediction(theta, app.sight.gather(stacked)), maps))
    photos[1, :, :, 4:8, 4:8] = 1
    none, clipped = presenter.quality_warnings(theta, stacked)
    (clause,) = [line for line in clipped if "clipped" in line]
    assert not any("clipped" in line for line in none)
    assert clause == "6.2 % of all photos is clipped, so F0 is a lower bound (a darker exposure shows more)"


@pytest.mark.parametrize(("slope", "is_flat"), [(0.5, False), (0.01, True)])
def test_nearly_flat_surfaces_and_unexplained_photographs_are_said(
    app: SvbrdfNonstationary, tasks: Tasks, slope: float, is_flat: bool
) -> None:
    stacked, maps, places = tasks.select([0]), truth(tasks)[:1], tasks.data["places"][:1]
    maps[:, :2] = slope * torch.randn(maps[:, :2].shape, generator=Generator().manual_seed(0))
    theta = {"maps": maps, "flash": torch.zeros(1, FLASH_NUMBERS, COUNT), "falloff": torch.zeros(1, 1)}
    photos = render_photos(decode_maps(maps), decode_flash(theta["flash"].mT, places)).clamp(0, 0.9)
    dimmed = photos.clone()
    dimmed[:, 1, :, :, : SIDE // 2] *= 0.5
    for shown, is_unexplained in ((photos, False), (dimmed, True)):
        (lines,) = presenter_of(app).quality_warnings(theta, replace(stacked, data=stacked.data | {"photos": shown}))
        assert any("nearly flat" in line for line in lines) == is_flat
        assert any("over wide areas" in line for line in lines) == is_unexplained


@pytest.mark.parametrize(("noise", "is_said"), [(0.002, False), (0.05, True)])
def test_photographs_that_differ_from_texel_to_texel_are_said(
    app: SvbrdfNonstationary, tasks: Tasks, noise: float, is_said: bool
) -> None:
    stacked, maps, places = tasks.select([0]), truth(tasks)[:1], tasks.data["places"][:1]
    theta = {"maps": maps, "flash": torch.zeros(1, FLASH_NUMBERS, COUNT), "falloff": torch.zeros(1, 1)}
    photos = render_photos(decode_maps(maps), decode_flash(theta["flash"].mT, places)).clamp(0, 0.9)
    # a chequered change, which the means over wide areas do not see
    signs = 1 - 2 * (torch.arange(SIDE)[:, None] + torch.arange(SIDE)).remainder(2)
    changed = replace(stacked, data=stacked.data | {"photos": photos * (1 + noise * signs)})
    (lines,) = presenter_of(app).quality_warnings(theta, changed)
    assert any("texel to texel" in line for line in lines) == is_said


def test_tasks_of_different_numbers_are_not_fitted_together(app: SvbrdfNonstationary) -> None:
    alone = Task("wall", {"photo": several(0).data["photo"]})
    for other in (several(1, 2), alone):
        with pytest.raises(ValueError, match=r"photos \(.*expected \(3, 3, 16, 16\) like material-0; convert both"):
            stack_tasks(app, [several(0), other])
    data = several(0).data
    for broken in (data | {"places": data["places"][:2]}, {key: data[key] for key in ("photo", "others")}):
        with pytest.raises(ValueError, match=r"leaf: 3 photos and [02] places, expected as many"):
            app.prepare(Task("leaf", broken))


def test_drawn_photos_are_those_of_the_places(rng: Generator) -> None:
    """The first is the one of sets of one photo; measured places explain the others nearly, others do not."""
    (one,), (five,) = (list(synthetic_tasks("train", 1, photos=count)) for count in (1, 5))
    assert all(torch.equal(one.data[key], five.data[key]) for key in ("photo", "maps"))
    assert set(one.data) == {"photo", "maps"}
    maps, places = five.data["maps"].float()[None], five.data["places"]
    assert five.data["others"].shape == (4, 3, 128, 128)
    drawn, measured = draw_photo_sets(maps, 5, rng)
    for photos, of in ((decode_photo(five.data["others"]), places[1:]), (drawn[0, 1:], measured[0, 1:])):

        def off(place: Tensor, photos: Tensor = photos) -> Tensor:
            seen = render_photos(unpack_maps(maps), decode_flash(torch.zeros(1, 4, FLASH_NUMBERS), place[None]))[
                0
            ].clamp(0, 1)
            return (seen - photos).abs().mean((1, 2, 3))

        mirrored = of * torch.tensor([-1.0, -1.0, 1.0])
        assert off(of).mean() < 0.7 * off(mirrored).mean()


def test_some_drawn_cameras_stand_still_under_lights_around_them(rng: Generator) -> None:
    maps = next(iter(synthetic_tasks("train", 1))).data["maps"].float()[None, :, :16, :16].expand(64, -1, -1, -1)
    photos, places = draw_photo_sets(maps, 4, rng)
    assert photos.shape == (64, 4, 3, 16, 16)
    assert torch.isfinite(photos).all()
    cameras, flashes = places.unbind(2)
    stands_still = (cameras == cameras[:, :1]).all(-1).all(-1)
    assert 2 <= int(stands_still.sum()) <= 24
    assert torch.equal(cameras[~stands_still], flashes[~stands_still])  # the flash is measured at the lens
    distances = flashes[stands_still].norm(dim=-1)
    torch.testing.assert_close(distances, distances[:, :1].expand(-1, 4))
    assert (flashes[..., 2] > 0).all()


def test_fits_of_any_number_of_photographs_are_those_of_the_network(app: SvbrdfNonstationary, tasks: Tasks) -> None:
    """So are fits that were saved before flashes had a fall-off; damaged ones are refused in one line."""
    theta = {key: value[0] for key, value in app.postprocess(general(app, tasks)).items()}
    others = {key: value[..., :1] if key == "flash" else value for key, value in theta.items()}
    for accepted in (theta, others, {key: theta[key] for key in ("maps", "flash")}):
        check_params(accepted, app, "wall")
    for key, value, problem in (
        ("flash", None, "tensor 'flash' is missing, expected float [4, N]"),
        ("flash", theta["flash"][:, 0], "tensor 'flash' is float32 [4], expected float [4, N]"),
        ("flash", theta["flash"][:3], f"tensor 'flash' is float32 [3, {COUNT}], expected float [4, N]"),
        ("flash", theta["flash"] * torch.nan, "tensor 'flash' holds NaN or infinite values, expected finite ones"),
        ("falloff", torch.zeros(COUNT), f"tensor 'falloff' is float32 [{COUNT}], expected float [1]"),
    ):
        damaged = {name: tensor for name, tensor in (theta | {key: value}).items() if tensor is not None}
        with pytest.raises(ValueError, match=f"^wall: {re.escape(problem)}; fit anew\\.$"):
            check_params(damaged, app, "wall")
    task = several(0)
    photo = decode_photo(task.data["photo"])[None]
    assert len(app.decode(theta, task, photo).flash_of_each_photo()) == COUNT
    with pytest.raises(
        ValueError, match=r"^material-0: a fit with 1 flashes, expected 3, one for each photo; fit anew"
    ):
        app.decode(others, task, photo)
