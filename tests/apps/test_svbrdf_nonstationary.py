"""Non-stationary svBRDFs: what is seen of a photo, views, variants, losses, protocols and outputs."""

import math
from dataclasses import replace

import pytest
import torch
from torch import Generator, Tensor
from torch.nn.functional import adaptive_avg_pool2d, avg_pool2d, interpolate, normalize

from data_tools.readers.svbrdf_task import make_svbrdf_task, render_flash_photo
from metapp.appearance.colour import srgb_to_linear
from metapp.appearance.flash import camera_distance, texel_positions
from metapp.appearance.height_fields import normal_from_height
from metapp.appearance.svbrdf_maps import Maps, pack_maps, unpack_maps
from metapp.apps.svbrdf_nonstationary.app import FINEST_PX, SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.encoder import PhotoEncoder, PhotoUNet
from metapp.apps.svbrdf_nonstationary.field_judge import BLOTS_WEIGHT, STEEPNESS_WEIGHT, FieldJudge
from metapp.apps.svbrdf_nonstationary.field_maps import FieldMaps, field_of
from metapp.apps.svbrdf_nonstationary.flashes import FLASH_NUMBERS, decode_flash, render_photo
from metapp.apps.svbrdf_nonstationary.map_judge import JUDGED_LIGHTS, fixed_pairs
from metapp.apps.svbrdf_nonstationary.maps import draw_mirroring_pairs, draw_oblique_pairs, pixel_inputs
from metapp.apps.svbrdf_nonstationary.maps_sight import FITTED_LIGHTS, MapsSight
from metapp.apps.svbrdf_nonstationary.photo_sight import PhotoSight, SeenPhoto
from metapp.apps.svbrdf_nonstationary.recipes import PHOTO_RECIPES, REFERENCE_RECIPES
from metapp.apps.svbrdf_nonstationary.variants import (
    CROP_SIDES,
    DIELECTRIC_F0,
    FAR_FLASH_SHARE,
    _crop,
    _turn,
    draw_photos,
    mix_materials,
    polish,
    recolour,
    restyle,
)
from metapp.learning.app import stack_tasks
from metapp.learning.task import Params, Task, Tasks
from tests.recipe_apps import presenter_of

SIDE = 16
FIELD = field_of(SIDE, hidden=8)._replace(code=3)
REFERENCE, PHOTO = (
    SvbrdfNonstationary(FieldMaps(FIELD), sight, FieldJudge(), PhotoEncoder(2)) for sight in (MapsSight(), PhotoSight())
)
# for photographs that people take: they may be crops, and may clip
PEOPLE_PHOTO = SvbrdfNonstationary(
    FieldMaps(FIELD, "raised"), PhotoSight(fills=True), FieldJudge(), PhotoEncoder(2, finer=(2,)), FINEST_PX
)


def material(seed: int, size: int = 32) -> Tensor:
    """Maps [10, size, size], smooth, with relief."""
    coarse = torch.rand(1, 8, 4, 4, generator=Generator().manual_seed(seed))
    smooth = interpolate(coarse, (size, size), mode="bilinear")[0]
    normal = normal_from_height(4 * smooth[:1], periodic=False)
    return pack_maps(Maps(0.1 + 0.7 * smooth[1:4], 0.4 * smooth[4:7], 0.3 + 0.5 * smooth[7:], normal))


def photo_of_unknown_height(photo: Tensor) -> SeenPhoto:
    """Linear photographs [T, 3, H, W] by cameras of unknown height, as fits see them."""
    return SeenPhoto(photo, torch.zeros(len(photo), 1))


@pytest.fixture
def app() -> SvbrdfNonstationary:
    return REFERENCE


@pytest.fixture
def tasks(app: SvbrdfNonstationary) -> Tasks:
    return stack_tasks(app, [make_svbrdf_task(f"material-{seed}", material(seed)) for seed in range(4)])


@pytest.fixture
def exact(tasks: Tasks, monkeypatch: pytest.MonkeyPatch) -> Params:
    """Parameters whose field gives the tasks' maps."""
    truth = unpack_maps(tasks.data["maps"])
    monkeypatch.setattr(FieldMaps, "make_maps", lambda decoder, theta, photo: truth)
    return REFERENCE.init(Generator().manual_seed(0), 4)


# What is seen of a photograph


def test_contrasts_say_where_it_gets_brighter() -> None:
    x, y = texel_positions(64, 64, dtype=torch.float64)
    photo = torch.exp(0.5 * x + 0.25 * y).expand(1, 3, -1, -1) - 0.02
    known, even = pixel_inputs(photo)[0, :, 1:-1, 1:-1], pixel_inputs(torch.full((1, 3, 16, 16), 0.3))
    texel = 2 / 64
    torch.testing.assert_close(known[3], torch.full_like(known[3], 2 * texel * 0.5))
    torch.testing.assert_close(known[4], torch.full_like(known[4], 2 * texel * 0.25))
    assert known[5].abs().max() < 1e-12
    torch.testing.assert_close(known[6:], torch.stack([x, y])[:, 1:-1, 1:-1])
    assert even[:, 3:6].abs().max() < 1e-5  # rounding
    assert float(even[0, 0, 3, 4]) == pytest.approx(math.log(0.32) / 1.5 + 1, rel=1e-5)


def test_a_finer_photo_says_the_same() -> None:
    coarse = 0.3 + 0.4 * torch.rand(1, 3, 4, 4, generator=Generator().manual_seed(0))
    fine, plain = (interpolate(coarse, (size, size), mode="bicubic") for size in (256, 64))
    found = torch.nn.functional.avg_pool2d(pixel_inputs(fine), 4)
    difference = (found - pixel_inputs(plain))[..., 4:-4, 4:-4]
    assert difference.abs().max() < 0.05
    assert (difference.abs().mean((0, 2, 3)) / pixel_inputs(plain).std((0, 2, 3)).clamp_min(1e-3)).max() < 0.05


def test_finer_levels_add_to_what_the_coarse_ones_read(rng: Generator) -> None:
    """Nothing at first; then at each resolution that a photo has, and what the coarse ones read of it stays in it."""
    coarse, finer = PhotoUNet(4, code=3), PhotoUNet(4, code=3, finer=(3, 2))
    weights = finer.init(rng)
    photo = torch.rand(2, 3, 256, 256, generator=rng)
    small = avg_pool2d(photo, 4)
    code = coarse(weights, small)
    for size in (64, 128, 256):
        found = finer(weights, adaptive_avg_pool2d(photo, size))
        torch.testing.assert_close(avg_pool2d(found["z"], size // 64), code["z"], atol=0.3, rtol=0)  # enlarged, no more
        assert found["z"].shape == (2, 3, size, size)
        torch.testing.assert_close(found["flash"], code["flash"])
    changed = {key: value + 0.1 * torch.randn(value.shape, generator=rng) for key, value in weights.items()}
    for level, size in enumerate((128, 256)):
        given = adaptive_avg_pool2d(photo, size)
        for name in (f"finer{level}.code.kernel", "finer0.known.kernel"):
            without = changed | {name: torch.zeros_like(changed[name])}
            assert not torch.equal(finer(changed, given)["z"], finer(without, given)["z"])


# Views


def test_mirroring_pairs_mirror_in_the_patch(rng: Generator) -> None:
    light, view = draw_mirroring_pairs(rng, (2, 50)).unbind(-2)
    centre = (light + view) / 2
    assert centre[..., :2].abs().max() <= 0.8
    towards = (light - centre * torch.tensor([1.0, 1.0, 0.0])) / camera_distance()
    torch.testing.assert_close(towards.norm(dim=-1), torch.ones(2, 50))
    half = normalize(light + view - 2 * centre * torch.tensor([1.0, 1.0, 0.0]), dim=-1)
    torch.testing.assert_close(half, torch.tensor([0.0, 0.0, 1.0]).expand(2, 50, 3), atol=1e-5, rtol=0)


def test_oblique_pairs_are_evenly_spread_above_the_patch(rng: Generator) -> None:
    towards = draw_oblique_pairs(rng, (4000,)) / camera_distance()
    torch.testing.assert_close(towards.norm(dim=-1), torch.ones(4000, 2))
    assert towards[..., 2].min() >= 0.4
    assert towards.mean((0, 1)).sub(torch.tensor([0.0, 0.0, 0.7])).abs().max() < 0.02  # z is uniform in [0.4, 1]


def test_lights_that_fits_see_differ_from_those_of_errors(app: SvbrdfNonstationary) -> None:
    fitted, judged = (fixed_pairs(counts) for counts in (FITTED_LIGHTS, JUDGED_LIGHTS))
    assert fitted.shape == (5, 2, 3)
    assert judged.shape == (12, 2, 3)
    assert (fitted[:, None] - judged).abs().flatten(2).amax(2).min() > 0.05
    assert torch.equal(judged, fixed_pairs((6, 6)))


def test_a_flash_described_by_zeros_is_the_camera_s() -> None:
    maps = material(0)[None]
    photo = render_photo(unpack_maps(maps), decode_flash(torch.zeros(1, FLASH_NUMBERS)))
    expected = srgb_to_linear(render_flash_photo(maps[0]).float() / 255)
    torch.testing.assert_close(photo[0].clamp(0, 1), expected, atol=0.01, rtol=0.01)  # 8 bits


def test_white_below_a_flash_is_as_bright_at_any_height() -> None:
    white = pack_maps(
        Maps(torch.ones(3, 33, 33), torch.zeros(3, 33, 33), torch.ones(1, 33, 33), torch.zeros(3, 33, 33))
    )
    white[2] = 1
    for higher in (-2.0, 0.0, 2.0):
        flash = decode_flash(torch.tensor([[0.0, 0.0, higher, 0.0], [0.0, 0.0, higher, 1.0]]))
        below = render_photo(unpack_maps(white[None]), flash)[:, :, 16, 16]
        torch.testing.assert_close(below, torch.tensor([1.0, math.exp(0.3)])[:, None].expand(2, 3), atol=1e-3, rtol=0)
        assert flash.place[0, 2] == pytest.approx(camera_distance() * math.exp(0.2 * higher))


def test_the_camera_moves_with_the_flash_where_photos_may_be_crops() -> None:
    """A photograph of twice the height is the middle of a photograph of a patch that is twice as large."""
    theta = PHOTO.init(Generator().manual_seed(0), 1)
    theta |= {"flash": torch.tensor([[0.0, 0.0, math.log(2) / 0.2 / FIELD.gain, 0.0]])}
    seen = photo_of_unknown_height(torch.full((1, 3, SIDE, SIDE), 0.3))
    people, training = (app.decoder(theta, seen).flash for app in (PEOPLE_PHOTO, PHOTO))
    assert float(people.eye[0, 2]) == pytest.approx(2 * camera_distance())
    assert float(training.eye[2]) == pytest.approx(camera_distance())
    maps = torch.cat([material(0)[:, 8:24, 8:24].mean((1, 2), keepdim=True).expand(-1, 32, 32)])[None]
    maps[:, :2], maps[:, 2] = 0, 1
    whole = render_photo(unpack_maps(maps), decode_flash(torch.zeros(1, FLASH_NUMBERS)))
    crop = render_photo(unpack_maps(maps[..., 8:24, 8:24]), people)
    torch.testing.assert_close(crop, whole[..., 8:24, 8:24])


def test_photos_may_be_crops_and_are_filled_in_the_recipe_for_those_of_people_alone() -> None:
    for name, recipe in PHOTO_RECIPES.items():
        is_for_people = name == "full"
        assert recipe.app.sight.fills is is_for_people
        assert recipe.app.decoder.camera_motion == ("raised" if is_for_people else "fixed")
        assert recipe.app.read_size == (FINEST_PX if is_for_people else 0)
    for name, recipe in REFERENCE_RECIPES.items():
        assert recipe.app.decoder.camera_motion == "fixed"
        assert recipe.app.read_size == (FINEST_PX if name == "full" else 0)


def test_the_flash_of_a_fit_is_as_high_as_a_camera_of_known_height(rng: Generator) -> None:
    """Heights about which nothing is known, or which fits expect, are General's to predict."""
    app = PEOPLE_PHOTO
    photo, encoder = torch.randint(256, (3, SIDE, SIDE), generator=rng, dtype=torch.uint8), app.init_encoder(rng)
    heights: dict[float, float] = {}
    for height in (0.0, 1.01 * camera_distance(), 5.0):
        places = {"places": torch.tensor([0.0, 0.0, height]).expand(1, 2, 3)} if height else {}
        tasks = stack_tasks(app, [Task("photo", {"photo": photo} | places)])
        theta = app.encode(encoder, app.encoder_input(tasks, rng))
        heights[height] = float(app.decoder(theta, app.sight.gather(tasks)).flash.place[0, 2])
    unknown, usual, known = heights.values()
    assert usual == unknown
    assert known == pytest.approx(5.0)
    assert abs(unknown - 5.0) > 1


# Variants


def test_turned_materials_look_like_turned_photos() -> None:
    maps, rng, found = material(0), Generator().manual_seed(0), set()
    photo = render_flash_photo(maps).int()
    for _ in range(60):
        turned = _turn(maps, rng)
        after = render_flash_photo(turned).int()
        ways = [
            [torch.rot90(channels, k, (1, 2)) for channels in (a, a.flip(2)) for k in range(4)] for a in (photo, maps)
        ]
        off = [int((candidate - after).abs().max()) for candidate in ways[0]]
        assert min(off) <= 1
        found.add(off.index(min(off)))
        assert torch.equal(ways[1][off.index(min(off))][2:], turned[2:])
    assert len(found) == 8


def test_variants_are_materials(tasks: Tasks, rng: Generator) -> None:
    for change in (mix_materials, recolour, restyle, polish):
        maps = change(tasks.data["maps"], rng)
        torch.testing.assert_close(maps[:, :3].norm(dim=1), torch.ones(4, SIDE, SIDE))
        assert maps[:, 3:].amin() >= 0
        assert maps[:, 3:].amax() <= 1
        assert not torch.equal(maps, tasks.data["maps"])


def test_the_normals_of_a_crop_are_those_of_its_relief(rng: Generator) -> None:
    coarse = 20 * torch.randn(1, 1, 8, 8, generator=rng)
    height = interpolate(coarse, size=(256, 256), mode="bicubic")
    maps = torch.cat([normal_from_height(height, periodic=False), height, torch.zeros(1, 6, 256, 256)], 1)
    for seed in range(8):
        crops = _crop(maps, 128, Generator().manual_seed(seed))
        share = (
            CROP_SIDES[0] + (CROP_SIDES[1] - CROP_SIDES[0]) * torch.rand(2, generator=Generator().manual_seed(seed))
        )[1]
        found = normal_from_height(crops[:, 3:4], 128 / (256 * float(share)), periodic=False)
        cosine = (found * crops[:, :3]).sum(1)[..., 2:-2, 2:-2].clamp(-1, 1)
        assert float(torch.rad2deg(cosine.acos()).mean()) < 1.0


def test_polished_materials_are_flat_dielectrics_with_a_sharp_highlight(tasks: Tasks, rng: Generator) -> None:
    polished = unpack_maps(torch.cat([polish(tasks.data["maps"], rng) for _ in range(8)]))
    assert float(polished.specular.amin()) >= DIELECTRIC_F0[0]
    assert float(polished.specular.amax()) <= DIELECTRIC_F0[1]
    assert float(polished.roughness.mean((1, 2, 3)).amax()) < 0.4
    steepness = [(1 - normal[:, 2].square()).sqrt().mean() for normal in (polished.normal, tasks.data["maps"][:, :3])]
    assert float(steepness[0]) < 0.25 * float(steepness[1])
    patterns = [diffuse.std((2, 3)).mean() for diffuse in (polished.diffuse, tasks.data["maps"][:, 3:6])]
    assert float(patterns[0]) > 0.5 * float(patterns[1])


def test_photos_of_one_material_have_flashes_at_other_heights(rng: Generator) -> None:
    """Corners of a white patch tell the height: from 45 degrees they are 0.66 times as bright as its middle."""
    maps = torch.zeros(1, 10, 32, 32)
    maps[:, 2:6], maps[:, 6] = 0.5, 1.0
    maps[:, 2] = 1.0
    photos = draw_photos(maps.expand(200, -1, -1, -1), rng).mean(1)
    corners = torch.stack([photos[:, row, column] for row in (0, -1) for column in (0, -1)]).mean(0)
    falls = corners / photos[:, 14:18, 14:18].mean((1, 2))
    is_standard = (falls > 0.58) & (falls < 0.74)
    assert 0.5 * FAR_FLASH_SHARE < float((falls > 0.75).float().mean()) < FAR_FLASH_SHARE
    assert float(is_standard.float().mean()) > 0.5


def test_variants_show_relief_that_is_finer_than_their_maps(app: SvbrdfNonstationary, rng: Generator) -> None:
    size = 2 * SIDE
    slopes = torch.where(torch.arange(size) % 2 == 0, 1.0, -1.0).expand(1, size, size)
    normal = normalize(torch.cat([slopes, torch.zeros_like(slopes), torch.ones_like(slopes)]), dim=0)
    even = torch.ones(3, size, size)
    ridges = pack_maps(Maps(0.5 * even, 0.04 * even, 0.9 * even[:1], normal))
    variants = app.augment(stack_tasks(app, [make_svbrdf_task(f"ridges-{i}", ridges) for i in range(16)]), rng)
    assert variants.data["maps"][:, 2].amin() > 0.9  # even, as far as these know
    flat = render_photo(unpack_maps(variants.data["maps"]), decode_flash(torch.zeros(16, FLASH_NUMBERS)))
    darker = variants.data["photo"].mean((1, 2, 3)) / flat.clamp(0, 1).mean((1, 2, 3))
    assert float(darker.median()) < 0.85  # about cos 45 degrees


# Losses and protocols


def test_the_true_maps_have_no_loss(app: SvbrdfNonstationary, tasks: Tasks, exact: Params, rng: Generator) -> None:
    batch = app.outer_sample(tasks, rng, 1)
    assert app.loss(exact, batch, {}).max() < 1e-6
    assert app.outer_loss(exact, batch, {}).max() < 0.01  # the photograph has 8 bits
    errors = app.errors(exact, tasks)
    assert max(float(value.max()) for key, value in errors.items() if key not in ("normal", "relief")) < 1e-6
    assert errors["normal"].max() < 0.1
    torch.testing.assert_close(errors["relief"], torch.ones(len(tasks)), rtol=0, atol=1e-4)


def test_a_tilt_is_measured_in_degrees(
    app: SvbrdfNonstationary, tasks: Tasks, exact: Params, monkeypatch: pytest.MonkeyPatch
) -> None:
    flat = tasks.data["maps"].clone()
    flat[:, :3] = torch.tensor([0.0, 0.0, 1.0])[:, None, None]
    angle = math.radians(10)
    tilted = unpack_maps(flat)._replace(normal=torch.tensor([math.sin(angle), 0.0, math.cos(angle)])[:, None, None])
    tilted = tilted._replace(normal=tilted.normal.expand(4, -1, SIDE, SIDE))
    monkeypatch.setattr(FieldMaps, "make_maps", lambda decoder, theta, photo: tilted)
    judged = replace(tasks, data=tasks.data | {"maps": flat})
    torch.testing.assert_close(app.errors(exact, judged)["normal"], torch.full((4,), 10.0), rtol=1e-3, atol=0)


def test_clipped_parts_of_a_photo_may_have_any_brightness(exact: Params) -> None:
    photo = PHOTO
    white = photo_of_unknown_height(torch.ones(4, 3, SIDE, SIDE))._asdict()
    brighter = exact | {"flash": torch.tensor([[0.0, 0.0, 0.0, 20.0]]).expand(4, -1)}
    assert photo.loss(brighter, white, {}).max() < 1e-4
    assert photo.loss(exact, white, {}).min() > 0.05


def test_clipped_parts_are_filled_in_maps_but_not_in_losses(
    tasks: Tasks, exact: Params, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only of maps that people use, made of photographs; a line says how much."""
    people = PEOPLE_PHOTO
    clipped = tasks.data["photo"].clamp_max(0.5).clone()
    clipped[0, :, 4:10, 4:10] = 1
    wrong = unpack_maps(tasks.data["maps"].clone())
    wrong.diffuse[0, :, 4:10, 4:10] = 0
    monkeypatch.setattr(FieldMaps, "make_maps", lambda decoder, theta, photo: wrong)
    batch = photo_of_unknown_height(clipped)._asdict()
    stacked = replace(tasks, data=tasks.data | batch)
    filled = people.prediction(exact, people.sight.gather(stacked))
    assert filled.diffuse[0, :, 4:10, 4:10].min() > 0.1
    for part, before in zip(filled, wrong, strict=True):
        assert torch.equal(part[1:], before[1:])
    reference = replace(REFERENCE, encoder=PhotoEncoder(2, SIDE), read_px=FINEST_PX)
    assert PHOTO.prediction(exact, PHOTO.sight.gather(stacked)) is wrong
    assert reference.prediction(exact, reference.sight.gather(stacked)) is wrong
    (clause,), *others = presenter_of(people).quality_warnings(exact, stacked)
    assert clause == (
        "14 % of the photo is clipped, 14 % of the maps is filled from its surroundings (a darker exposure shows more)"
    )
    assert others == [[], [], []]
    assert people.errors(exact, stacked)["diffuse"][0] < PHOTO.errors(exact, stacked)["diffuse"][0]
    torch.testing.assert_close(people.loss(exact, batch, {}), PHOTO.loss(exact, batch, {}), rtol=0, atol=0)


def test_fits_see_maps_or_a_photo_by_protocol(tasks: Tasks) -> None:
    reference, photo = REFERENCE, PHOTO
    theta = reference.init(Generator().manual_seed(0), 4)
    batch = reference.sample(tasks, Generator(), 1)
    batch |= photo_of_unknown_height(batch["photo"])._asdict()
    for app, changed in ((reference, "maps"), (reference, "lit"), (photo, "photo")):
        before = app.loss(theta, batch, {})
        after = app.loss(theta, batch | {changed: batch[changed] * 0.9}, {})
        assert (before - after).abs().min() > 1e-4
    for hidden in ("maps", "lit"):
        other = batch | {hidden: batch[hidden] * 0.5}
        assert torch.equal(photo.loss(theta, other, {}), photo.loss(theta, batch, {}))


def test_blots_and_relief_are_measured(app: SvbrdfNonstationary, tasks: Tasks) -> None:
    """Diffuse colours are off in one corner, which alone clips in the photograph; all normals are upright."""
    maps = unpack_maps(tasks.data["maps"])
    off = torch.zeros_like(maps.diffuse)
    off[..., :2, :2] = 1
    photo = tasks.data["photo"].clamp_max(0.5).clone()
    photo[..., :2, :2] = 1
    up = torch.zeros_like(maps.normal)
    up[:, 2] = 1
    result = maps._replace(diffuse=torch.where(off > 0, 1.0, maps.diffuse), normal=up)
    found = app.errors_of(result, replace(tasks, data=tasks.data | {"photo": photo}))
    torch.testing.assert_close(found["blots"], found["diffuse"] * off[0, 0].numel() / 4)
    tilt = (1 - maps.normal[:, 2].square()).clamp_min(0).sqrt().mean((1, 2))
    torch.testing.assert_close(found["relief"], 0.011 / (tilt + 0.01), rtol=0.02, atol=0)


def test_outer_losses_count_flat_normals_and_blots(
    app: SvbrdfNonstationary, tasks: Tasks, exact: Params, rng: Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Normals are flatter everywhere than they should be; diffuse colours are off, and the photograph clips in part."""
    half = tasks.data["maps"].clone()
    half[:, 3:6] = (half[:, 3:6] + 0.2).clamp_max(0.98)
    half[:, :2] *= 0.1
    half[:, :3] = normalize(half[:, :3], dim=1)
    batch = app.outer_sample(tasks, rng, 1)
    batch["photo"] = batch["photo"].clamp_max(0.9).clone()
    batch["photo"][..., :4] = 1
    monkeypatch.setattr(FieldMaps, "make_maps", lambda decoder, theta, photo: unpack_maps(half))
    whole, without_steep, neither = (
        replace(app, judge=judge).outer_loss(exact, batch, {})
        for judge in (
            FieldJudge(),
            FieldJudge(steepness_weight=0.0),
            FieldJudge(steepness_weight=0.0, blots_weight=0.0),
        )
    )
    assert (whole - without_steep).min() > 0.5 * STEEPNESS_WEIGHT  # the log of some three to ten times
    shades = [(maps[:, 3:6] + 1e-3) ** (1 / 2.2) for maps in (half, batch["maps"])]
    apart = (shades[0] - shades[1]).abs()[..., :4].mean((1, 2, 3))
    torch.testing.assert_close(without_steep - neither, BLOTS_WEIGHT * apart)
