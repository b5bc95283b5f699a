"""General over features of VGG-16: what it reads, what it is trained on and by; made-up weights of VGG."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file
from torch import Generator, Tensor

from data_tools.readers.svbrdf_task import svbrdf_task
from metapp.appearance.features import BLOCKS
from metapp.appearance.flash import Maps, positions, unpack
from metapp.apps import app_of, recipes_of
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary, field_of
from metapp.apps.svbrdf_nonstationary.confidence import PARTS
from metapp.apps.svbrdf_nonstationary.maps import FLASH, inputs_of
from metapp.extensions.pretrained.app import SHALLOW, FromFeatures, PretrainedSetup
from metapp.extensions.pretrained.augmentation import (
    FLATTER,
    LEAST,
    blended,
    crossed,
    pieces,
    polished,
    variants,
    windows,
)
from metapp.extensions.pretrained.encoder import (
    DARK,
    GUESS,
    OVERVIEW,
    SHARE,
    SMALLER,
    FeatureEncoder,
    _balanced,
    _smaller,
    beside_smaller,
    overview_of,
    patch_of,
)
from metapp.extensions.pretrained.recipe import PRETRAINED
from metapp.learning.app import stack
from metapp.learning.learn import descend, last
from metapp.learning.rules import fixed_adam, outer_adam
from metapp.learning.task import Batch, Tasks
from metapp.paradigms import Job
from metapp.paradigms.general import outer_problem
from metapp.paradigms.paradigm import plain_loss
from metapp.runs.requests.plan import plan
from metapp.runs.requests.request import Request
from metapp.storage.records import tensor_digest
from tests.apps.test_svbrdf_nonstationary import material

APP = "svbrdf_nonstationary"
SIDE = 32
DIGEST = "f6bf608fb21e"  # the digest of General by "full" that the checkpoint's was trained beside
RECIPE = replace(PRETRAINED, setup=PretrainedSetup(field_of(SIDE, 8)))


@pytest.fixture(scope="module")
def made_up(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Random weights of VGG-16 up to relu4_3."""
    rng, weights, inputs = Generator().manual_seed(2), {}, 3
    for i, outputs in enumerate([width for block in BLOCKS[:4] for width in block]):
        weights[f"conv{i}.weight"] = torch.randn(outputs, inputs, 3, 3, generator=rng) * (2 / (9 * inputs)) ** 0.5
        weights[f"conv{i}.bias"] = torch.zeros(outputs)
        inputs = outputs
    path = tmp_path_factory.mktemp("vgg") / "vgg16.safetensors"
    save_file(weights, path)
    return path


@pytest.fixture
def weights(made_up: Path, cache: Path) -> None:
    os.link(made_up, cache / made_up.name)


@pytest.fixture
def app() -> FromFeatures:
    found = app_of(APP, RECIPE, "photo")
    assert isinstance(found, FromFeatures)
    return found


@pytest.fixture
def tasks(app: FromFeatures) -> Tasks:
    return stack(app, [svbrdf_task(f"material-{seed}", material(seed, 2 * SIDE)) for seed in range(4)])


def test_only_its_recipe_is_of_the_subclass() -> None:
    kinds = {name: type(app_of(APP, recipe, "photo")) for name, recipe in recipes_of(APP, "photo").items()}
    assert {name for name, kind in kinds.items() if kind is FromFeatures} == {"pretrained"}
    assert kinds["full"] is SvbrdfNonstationary


@pytest.mark.usefixtures("weights")
def test_the_same_parameters_read_photos_of_several_sizes(rng: Generator) -> None:
    encoder = FeatureEncoder(5, len(PARTS))
    parameters = encoder.init(rng)
    for side in (32, 64):
        read = encoder(parameters, torch.rand(2, 3, side, side, generator=rng))
        assert read["z"].shape == (2, 5 + SMALLER.field.code, side, side)
        assert read["deviation"].shape == (2, len(PARTS), side // 4, side // 4)
        assert read["flash"].shape == (2, FLASH)
    with pytest.raises(ValueError, match="44 px, expected a multiple of 8"):
        encoder(parameters, torch.rand(1, 3, 44, 44))


@pytest.mark.usefixtures("weights")
def test_the_flash_is_where_full_sees_it_in_all_of_the_patch(rng: Generator) -> None:
    """It is not in most windows."""
    encoder = FeatureEncoder(5, len(PARTS))
    parameters, photos = encoder.init(rng), torch.rand(2, 3, 32, 32, generator=rng) ** 2
    smaller, its = _smaller(photos.device)
    side = smaller.field.height
    large = torch.nn.functional.interpolate(photos, (side, side), mode="bilinear")
    with torch.no_grad():
        seen = smaller.field.gain * smaller.encode(its, {"photo": large})["flash"]
    torch.testing.assert_close(encoder(parameters, photos)["flash"], seen)
    window = photos[..., :16, :16], positions(32, 32)[None, :, :16, :16]
    torch.testing.assert_close(encoder(parameters, *window, patch_of(photos))["flash"], seen)


@pytest.mark.usefixtures("weights")
def test_maps_are_the_mean_of_both_networks_but_for_normals(app: FromFeatures, rng: Generator) -> None:
    """Before their ranges are imposed, and at resolutions that the smaller one does not read."""
    encoder = app.init_encoder(rng)
    photo = torch.rand(1, 3, 2 * SIDE, 2 * SIDE, generator=rng)
    inputs = inputs_of(photo)
    theta = app.encode(encoder, {"photo": photo, "inputs": inputs, **patch_of(photo)})
    size = {"height": 2 * SIDE, "width": 2 * SIDE, "rows": 2 * SIDE, "columns": 2 * SIDE}
    own = app.setup.field._replace(**size)
    alone = {key.removeprefix("decoder."): value[None] for key, value in encoder.items() if key.startswith("decoder.")}
    first = own(alone | {"z": theta["z"][:, : own.code]}, inputs)
    _, smaller = _smaller(torch.device("cpu"))
    beside = {key.removeprefix("decoder."): value[None] for key, value in smaller.items() if "decoder." in key}
    second = SMALLER.field._replace(**size)(beside | {"z": theta["z"][:, own.code :]}, inputs)
    joined = app.field._replace(**size)(theta, inputs)
    torch.testing.assert_close(joined[:, :2], first[:, :2], atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(joined[:, 2:], torch.lerp(first, second, SHARE)[:, 2:], atol=1e-4, rtol=1e-4)
    assert set(beside_smaller(encoder)) == set(encoder)


@pytest.mark.usefixtures("weights")
def test_shallow_relief_is_shrunk_and_steep_relief_is_not(app: FromFeatures, rng: Generator) -> None:
    """By the same share all over; other maps are as they were, and windows, which training sees."""
    photo, encoder = torch.rand(1, 3, SIDE, SIDE, generator=rng), app.init_encoder(rng)
    inputs = inputs_of(photo)
    window = {"photo": photo, "inputs": inputs, **patch_of(photo)}

    def raw(condition: Batch, steeper: float) -> Tensor:
        slopes = {key: value.clone() for key, value in encoder.items() if key.startswith("decoder.out.")}
        for value in slopes.values():
            value[:2] *= steeper
        return app.field(app.encode(encoder | slopes, condition), inputs)

    for steeper in (0.1, 1.0, 100.0):
        whole, as_read = raw({"photo": photo}, steeper), raw(window, steeper)
        strength = as_read[:, :2].square().sum(1).mean()
        torch.testing.assert_close(whole[:, :2], strength / (strength + SHALLOW**2) * as_read[:, :2])
        torch.testing.assert_close(whole[:, 2:], as_read[:, 2:])
        assert (steeper < 1) == bool(strength < SHALLOW**2 / 9)
        assert (steeper > 1) == bool(strength > 9 * SHALLOW**2)


@pytest.mark.usefixtures("weights")
def test_steps_by_a_photo_keep_the_normals(app: FromFeatures, tasks: Tasks, rng: Generator) -> None:
    theta = app.encode(app.init_encoder(rng), app.condition(tasks, rng))
    batch = app.sample(tasks, rng, 1)
    before, photo = app.maps_of(theta, batch["photo"]), plain_loss(Job(app, RECIPE, ""))
    end = last(
        descend(theta, fixed_adam(replace(RECIPE.quickft, rate=0.01), theta, 5), tasks, photo, steps=5, rng=rng)
    ).theta
    after = app.maps_of(end, batch["photo"])
    assert torch.equal(after.normal, before.normal)
    assert (app.loss(end, batch, {}) < app.loss(theta, batch, {})).all()
    for was, now in zip(before[:3], after[:3], strict=True):
        assert (was - now).abs().amax() > 1e-5


def test_exposure_and_white_balance_are_inputs_of_their_own(rng: Generator) -> None:
    """The rest of what is known of a photo, and what VGG sees, stays as it is; these move by as much."""
    photo, place = 0.1 + 0.3 * torch.rand(1, 3, 16, 16, generator=rng), positions(16, 16)[None]
    gains = torch.tensor([1.3, 1.0, 0.6])[:, None, None]
    mean = photo.mean((2, 3), keepdim=True)
    (seen, known), (again, others) = _balanced(photo, place, mean), _balanced(photo * gains, place, mean * gains)
    torch.testing.assert_close(again, seen)
    torch.testing.assert_close(others[:, :-4], known[:, :-4])
    change = (others - known)[0, -4:, 0, 0]
    torch.testing.assert_close((3 * change[:1] + change[1:]).exp(), gains.flatten())


def test_pieces_turn_normals_with_what_they_are_of(rng: Generator) -> None:
    """Of planes of known heights: normals lean as the heights fall, in any direction, mirrored or not."""
    across, up = positions(64, 64)
    slopes = torch.randn(12, 2, generator=rng)
    heights = slopes[:, 0, None, None] * across + slopes[:, 1, None, None] * up
    normal = torch.nn.functional.normalize(torch.cat([-slopes, torch.ones(12, 1)], 1), dim=1)
    maps = torch.cat([normal[:, :, None, None].expand(-1, -1, 64, 64), heights[:, None].expand(-1, 7, -1, -1)], 1)
    piece = pieces(maps, 16, rng)
    fall_x = piece[:, 3, 8, 7] - piece[:, 3, 8, 8]
    fall_y = piece[:, 3, 8, 8] - piece[:, 3, 7, 8]
    fall = torch.nn.functional.normalize(torch.stack([fall_x, fall_y], 1), dim=1)
    lean = torch.nn.functional.normalize(piece[:, :2, 8, 8], dim=1)
    torch.testing.assert_close(lean, fall, atol=1e-3, rtol=0)
    torch.testing.assert_close(piece[:, 2, 8, 8], normal[:, 2])
    assert piece[:, 3].std() > 0.1


def test_pieces_show_up_to_all_of_the_maps(rng: Generator) -> None:
    """From LEAST of the side to all of it, and nothing beyond; such as are turned have less room."""
    across, up = positions(64, 64)
    maps = torch.stack([torch.zeros_like(up), torch.zeros_like(up), torch.ones_like(up), across, up, *[across] * 5])
    piece = pieces(maps.expand(200, -1, -1, -1), 64, rng)[:, 3:5]
    sides = (piece[:, :, 0, 0] - piece[:, :, 0, -1]).norm(dim=1) / 2
    assert LEAST - 0.02 < sides.min() < 0.45
    assert 0.9 < sides.max() < 1.001
    assert piece.abs().max() <= 1


def test_polished_materials_keep_all_but_their_slopes(rng: Generator) -> None:
    maps = torch.rand(300, 10, 4, 4, generator=rng)
    maps[:, :3] = torch.nn.functional.normalize(maps[:, :3] + torch.tensor([-0.5, -0.5, 0.5])[:, None, None], dim=1)
    flat = polished(maps, rng)
    assert torch.equal(flat[:, 3:], maps[:, 3:])
    torch.testing.assert_close(flat[:, :3].norm(dim=1), torch.ones(300, 4, 4))
    ratio = (flat[:, :2] / flat[:, 2:3] / (maps[:, :2] / maps[:, 2:3])).log()
    torch.testing.assert_close(ratio, ratio[:, :1, :1, :1].expand_as(ratio), atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(ratio.min(), torch.tensor(FLATTER[0]), atol=0.1, rtol=0)
    torch.testing.assert_close(ratio.max(), torch.tensor(FLATTER[1]), atol=0.1, rtol=0)


def test_windows_come_from_everywhere_and_know_where(rng: Generator) -> None:
    side = 8
    rows = torch.arange(20.0)[:, None].expand(20, 20)
    seen = windows(torch.stack([rows, rows.T]).expand(200, -1, -1, -1), side, rng)
    assert torch.equal(seen[:, 0, 1:] - seen[:, 0, :-1], torch.ones(200, side - 1, side))
    for corner in (seen[:, 0, 0, 0], seen[:, 1, 0, 0]):
        assert (corner.min(), corner.max()) == (0, 20 - side)


@pytest.mark.usefixtures("weights")
def test_a_window_is_read_with_all_of_its_patch(rng: Generator) -> None:
    """Gloss is read off an overview, which says the same of a patch in any window and at any resolution."""
    side = 64
    made = [variants(torch.rand(2, 10, 128, 128, generator=rng), torch.ones(2, 4), side, rng) for _ in range(12)]
    whole = [float(each["inputs"][:, -2:].std()) > 0.5 for each in made]
    assert set(whole) == {True, False}
    for each, seen in zip(made, whole, strict=True):
        assert each["overview"].shape == (2, 3, OVERVIEW, OVERVIEW)
        assert each["photo"].shape[-1] == each["maps"].shape[-1] == each["inputs"].shape[-1] == side
        if seen:
            torch.testing.assert_close(inputs_of(each["photo"]), each["inputs"])
            coarse = torch.nn.functional.avg_pool2d(each["overview"], OVERVIEW)
            torch.testing.assert_close(each["photo"].mean((2, 3), keepdim=True), coarse)
    fine = torch.rand(1, 3, 512, 512, generator=rng)
    smooth = torch.nn.functional.avg_pool2d(fine, 2)
    torch.testing.assert_close(overview_of(fine), overview_of(smooth))
    encoder = FeatureEncoder(5, len(PARTS))
    untrained = encoder.init(rng)
    trained = {key: value + (0.1 if ".overview" in key else 0) for key, value in untrained.items()}
    patch, middle = patch_of(smooth), (slice(None), slice(None), slice(96, 160), slice(96, 160))
    window = (smooth[middle], positions(256, 256)[None][middle])
    for parameters, same in ((untrained, True), (trained, False)):  # of another patch with the same mean
        turned = patch | {"overview": patch["overview"].flip(3)}
        read, other = (encoder(parameters, *window, each)["z"] for each in (patch, turned))
        assert torch.allclose(read, other, atol=1e-5) == same


def test_the_guess_is_what_general_by_full_says(rng: Generator) -> None:
    """Of all of the patch, whatever the photograph's size; and of the checkpoint that this one was trained beside."""
    assert tensor_digest(_smaller(torch.device("cpu"))[1]) == DIGEST, "train pretrained beside this General, too"
    photo = torch.rand(1, 3, 256, 256, generator=rng)
    guess = patch_of(photo)["guess"]
    small, smaller = app_of(APP, recipes_of(APP, "photo")["full"], "photo"), _smaller(torch.device("cpu"))[1]
    assert isinstance(small, SvbrdfNonstationary)
    with torch.no_grad():
        maps = small.maps_of(small.encode(smaller, {"photo": photo}), photo)
    assert guess.shape == (1, GUESS, 256, 256)
    torch.testing.assert_close(guess[:, :1], maps.roughness)
    torch.testing.assert_close(guess[:, 1:].exp() - DARK, torch.stack([maps.specular, maps.diffuse], 1).mean(2))
    twice = photo.repeat_interleave(2, 2).repeat_interleave(2, 3)
    torch.testing.assert_close(patch_of(twice)["guess"], guess)


@pytest.mark.usefixtures("weights")
def test_windows_are_read_beside_the_guess_of_their_patch(rng: Generator) -> None:
    encoder = FeatureEncoder(5, len(PARTS))
    untrained = encoder.init(rng)
    trained = {key: value + (0.1 if ".guess.kernel" in key else 0) for key, value in untrained.items()}
    photo = torch.rand(1, 3, 32, 32, generator=rng)
    patch = patch_of(photo)
    for parameters, same in ((untrained, True), (trained, False)):
        changed = patch | {"guess": 1 - patch["guess"]}
        read, other = (encoder(parameters, photo, patch=each)["z"] for each in (patch, changed))
        assert torch.allclose(read, other, atol=1e-5) == same


def test_relief_beside_other_colours_keeps_what_is_known_of_it(rng: Generator) -> None:
    maps = torch.arange(40.0)[:, None, None, None].expand(-1, 10, 2, 2)
    known = torch.arange(40.0)[:, None].expand(-1, 4)
    mixed, of_mixed = crossed(maps, known, rng)
    assert torch.equal(mixed[:, 3:], maps[:, 3:])
    assert torch.equal(mixed[:, 0, 0, 0], of_mixed[:, 3])
    assert 0.1 < float((mixed[:, 0, 0, 0] != maps[:, 0, 0, 0]).float().mean()) < 0.6


def test_of_mixed_materials_what_is_known_of_both_counts(rng: Generator) -> None:
    """Maps that are as they were keep what is known of them; the others lie between two materials."""
    maps = torch.arange(1, 41.0)[:, None, None, None].expand(-1, 10, 8, 8)
    known = (torch.arange(40)[:, None] % torch.tensor([2, 3, 4, 5]) > 0).float()
    both, of_both = blended(maps, known, rng)
    alone = (both[:, 3] == maps[:, 3]).flatten(1).all(1)
    assert 0.3 < float(alone.float().mean()) < 0.7
    assert torch.equal(of_both[alone], known[alone])
    assert torch.equal(of_both[~alone], torch.minimum(known, known.roll(1, 0))[~alone])
    low, high = torch.minimum(maps, maps.roll(1, 0)), torch.maximum(maps, maps.roll(1, 0))
    assert ((both >= low - 1e-4) & (both <= high + 1e-4))[:, 3:].all()
    torch.testing.assert_close(both[:, :3].norm(dim=1), torch.ones(40, 8, 8))


def losses(app: FromFeatures, maps: Maps, batch: Batch, monkeypatch: pytest.MonkeyPatch) -> Tensor:
    """The outer losses of such predicted maps, of which General is equally sure."""
    count, side = maps.diffuse.shape[0], maps.diffuse.shape[-1]
    theta = {"deviation": torch.full((count, 4, side // 4, side // 4), -2.0), "flash": torch.zeros(count, FLASH)}
    monkeypatch.setattr(FromFeatures, "_made_of", lambda app, theta, inputs: maps)
    return app.outer_loss(theta, batch, {})


def test_what_is_made_up_counts_nothing(
    app: FromFeatures, tasks: Tasks, rng: Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    batch = app.sample(app.augment(tasks, rng), rng, 1)
    batch["known"] = torch.tensor([[1.0, 1.0, 1.0, 1.0], [1.0, 0.0, 0.0, 1.0], [0.5, 0.0, 0.0, 0.5], [0.0] * 4])
    parts = [part.clone().requires_grad_() for part in unpack(0.9 * batch["maps"] + 0.01)]
    value = losses(app, Maps(*parts), batch, monkeypatch)
    value.sum().backward()
    moved = [part.grad.abs().amax((1, 2, 3)) > 0 for part in parts]  # type: ignore[union-attr]
    diffuse, specular, roughness, normal = (each.tolist() for each in moved)
    assert diffuse == normal == [True, True, True, False]
    assert specular == roughness == [True, False, False, False]


def test_relief_that_a_photo_does_not_tell_is_best_left_out(
    app: FromFeatures, tasks: Tasks, rng: Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where slopes may as well go the other way, flat maps are better than either; where they are known, the truth."""
    batch = app.sample(app.augment(tasks, rng), rng, 1)
    truth = unpack(batch["maps"])
    turned = truth._replace(normal=truth.normal * torch.tensor([-1.0, -1.0, 1.0])[:, None, None])
    flat = truth._replace(normal=torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand_as(truth.normal))
    right, wrong, none = (losses(app, maps, batch, monkeypatch).mean() for maps in (truth, turned, flat))
    assert right < none < (right + wrong) / 2


@pytest.mark.usefixtures("weights")
def test_a_few_outer_steps_lower_the_loss(app: FromFeatures, tasks: Tasks, rng: Generator) -> None:
    training = replace(RECIPE.general, tasks=4, steps=12, warmup=0)
    phi, loss = outer_problem(Job(app, replace(RECIPE, general=training), ""), rng)
    drawn = loss.draw(tasks, Generator().manual_seed(0), 0.0).batch
    flat = app.maps_of(app.encode(phi.encoder, app.condition(tasks, rng)), tasks.data["photo"])
    assert float(flat.normal[:, 2].mean()) > 0.99
    same = replace(loss, draw=lambda data, own, done: loss.draw(data, Generator().manual_seed(0), done))
    end = last(descend(phi.flat(), outer_adam(training, phi.flat()), tasks, same, steps=12, rng=rng)).theta
    before, after = (float(loss.value(each, drawn, {}).mean()) for each in (phi.flat(), end))
    assert after < 0.9 * before
    encoder = {key.removeprefix("encoder."): value for key, value in end.items()}
    assert set(app.errors(app.encode(encoder, app.condition(tasks, rng)), tasks)) >= {"error", "normal"}


def test_without_the_weights_it_says_how_to_get_them(metapp: Callable, tmp_path: Path, cache: Path) -> None:
    photo = ("general", APP, "--observe", "photo", "--train", "--train-steps", "1", "--out", tmp_path / "runs")
    assert metapp("data", "synth", APP, "--count", "8", "--size", "32", "--out", tmp_path / "set").code == 0
    done = metapp(*photo, "--recipe", "pretrained", "--data", tmp_path / "set")
    assert done.code == 1
    assert "get them by metapp data vgg, or fit by --recipe full" in " ".join(done.err.split())
    assert "Traceback" not in done.err


@pytest.mark.parametrize("has", [True, False])
def test_it_is_the_default_of_what_goes_on_from_general_where_weights_are(
    request: pytest.FixtureRequest, metapp: Callable, tmp_path: Path, has: bool
) -> None:
    """Else the smaller network, which is said; other paradigms and protocols have no files for it."""
    if has:
        request.getfixturevalue("weights")
    assert metapp("data", "synth", APP, "--count", "8", "--size", "32", "--out", tmp_path / "set").code == 0

    def chosen(paradigm: str, **options: object) -> str:
        return plan(Request(APP, paradigm, **{"observe": "photo", "data": tmp_path / "set"} | options)).request.recipe

    defaults = {chosen(paradigm) for paradigm in ("general", "quickft", "meta")}
    assert defaults == {"pretrained" if has else "full"}
    assert chosen("general", recipe="full") == chosen("finetune") == "full"
    assert chosen("general", observe="reference") == "full"
    done = metapp("general", APP, "--observe", "photo", "--data", tmp_path / "set", "--out", tmp_path / "runs")
    said = " ".join(done.err.split())
    assert ("the weights of VGG-16 are missing: maps by a smaller network; metapp data vgg gets them" in said) != has
    assert done.code == has  # these weights are not those that the checkpoint was trained with
