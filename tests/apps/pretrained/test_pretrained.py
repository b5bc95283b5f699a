"""The recipe of one photo: where it is the default, its outer loss, both networks, and what it reads of a photo."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Generator, Tensor

from metapp.appearance.flash import texel_positions
from metapp.appearance.svbrdf_maps import Maps, unpack_maps
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.encoder import PhotoEncoder
from metapp.apps.svbrdf_nonstationary.field_judge import FieldJudge
from metapp.apps.svbrdf_nonstationary.field_maps import FieldMaps
from metapp.apps.svbrdf_nonstationary.flashes import FLASH_NUMBERS, render_photo
from metapp.apps.svbrdf_nonstationary.maps import CHANNELS, decode_maps, pixel_inputs
from metapp.apps.svbrdf_nonstationary.photo_sight import PhotoSight, compare_photos
from metapp.apps.svbrdf_nonstationary.pretrained.augmentation import draw_variants
from metapp.apps.svbrdf_nonstationary.pretrained.encoder import (
    FeatureEncoder,
    _balance,
    init_reader,
    read_photos,
)
from metapp.apps.svbrdf_nonstationary.pretrained.ensemble_maps import (
    HALVED_SLOPE,
    PARTS,
    SECOND_SHARE,
    SLOPE_GAIN,
    EnsembleMaps,
    UncertainMaps,
)
from metapp.apps.svbrdf_nonstationary.pretrained.feature_judge import FeatureJudge
from metapp.apps.svbrdf_nonstationary.pretrained.feature_sight import FeatureSight, FitPhoto, TrainingPhoto
from metapp.apps.svbrdf_nonstationary.pretrained.patch import (
    FULL_APP,
    GUESS_CHANNELS,
    LOG_FLOOR,
    OVERVIEW_PX,
    describe_patch,
    load_full_general,
)
from metapp.apps.svbrdf_nonstationary.pretrained.scars import trust_texels
from metapp.learning.learn import descend, final_item, task_loss
from metapp.learning.rules import fixed_adam, outer_adam
from metapp.learning.task import Batch, Params, Tasks
from metapp.paradigms.trainings import general_training
from metapp.storage.checkpoint_files import tensor_digest
from tests.apps.pretrained.conftest import APP, RECIPE, SIDE
from tests.kept_fits import resolve_inputs
from tests.recipe_apps import recipes_of


def test_pretrained_recipe_alone_uses_features() -> None:
    apps = {name: recipe.app for name, recipe in recipes_of(APP, "photo").items()}
    parts = {
        name: {type(part) for part in (app.decoder, app.sight, app.judge, app.encoder)} for name, app in apps.items()
    }
    feature_parts = {EnsembleMaps, FeatureSight, FeatureJudge, FeatureEncoder}
    assert {name for name, app_parts in parts.items() if app_parts & feature_parts} == {"pretrained"}
    assert parts["pretrained"] == feature_parts
    assert parts["full"] == {FieldMaps, PhotoSight, FieldJudge, PhotoEncoder}


def test_missing_weights_are_refused_with_the_command_that_gets_them(
    metapp: Callable, tmp_path: Path, cache: Path
) -> None:
    photo = ("general", APP, "--observe", "photo", "--train", "--train-steps", "1", "--out", tmp_path / "runs")
    assert metapp("data", "synth", APP, "--count", "8", "--size", "32", "--out", tmp_path / "set").code == 0
    result = metapp(*photo, "--recipe", "pretrained", "--data", tmp_path / "set")
    assert result.code == 1
    assert "get them by metapp data vgg, or fit by --recipe full" in " ".join(result.err.split())
    assert "Traceback" not in result.err


@pytest.mark.parametrize("has", [True, False])
def test_pretrained_is_the_default_of_fits_from_general_where_weights_are(
    request: pytest.FixtureRequest, metapp: Callable, tmp_path: Path, has: bool
) -> None:
    """Without weights fits take the smaller network and say so.

    Other paradigms and protocols have no checkpoints for it.
    """
    if has:
        request.getfixturevalue("random_vgg_in_cache")
    assert metapp("data", "synth", APP, "--count", "8", "--size", "32", "--out", tmp_path / "set").code == 0

    def chosen(paradigm: str, **options: object) -> str:
        given: dict[str, Any] = {"observe": "photo", "data": tmp_path / "set"} | options
        (recipe,) = {spec.recipe for spec in resolve_inputs(APP, paradigm=paradigm, **given)[0]}
        return recipe

    defaults = {chosen(paradigm) for paradigm in ("general", "quickft", "meta")}
    assert defaults == {"pretrained" if has else "full"}
    assert chosen("general", recipe="full") == chosen("finetune") == "full"
    assert chosen("general", observe="reference") == "full"
    result = metapp("general", APP, "--observe", "photo", "--data", tmp_path / "set", "--out", tmp_path / "runs")
    output = " ".join(result.err.split())
    assert ("the weights of VGG-16 are missing: maps by a smaller network; metapp data vgg gets them" in output) != has
    assert result.code == has  # these weights are not those that the checkpoint was trained with


# The outer loss, and a few outer steps


def losses(app: SvbrdfNonstationary, maps: Maps, batch: Batch, monkeypatch: pytest.MonkeyPatch) -> Tensor:
    """The outer losses of such predicted maps, of which General is equally sure."""
    count, side = maps.diffuse.shape[0], maps.diffuse.shape[-1]
    flash = app.decoder.decode_flash_numbers(torch.zeros(count, FLASH_NUMBERS), torch.zeros(count, 1))
    answer = UncertainMaps(maps, flash, torch.full((count, 4, side // 4, side // 4), -2.0))
    monkeypatch.setattr(EnsembleMaps, "decode_for_training", lambda decoder, theta, seen: answer)
    return app.outer_loss({}, batch, {})


def test_unknown_maps_have_no_weight_in_the_loss(
    app: SvbrdfNonstationary, tasks: Tasks, rng: Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    batch = app.outer_sample(app.augment(tasks, rng), rng, 1)
    batch["map_weights"] = torch.tensor([[1.0, 1.0, 1.0, 1.0], [1.0, 0.0, 0.0, 1.0], [0.5, 0.0, 0.0, 0.5], [0.0] * 4])
    parts = [part.clone().requires_grad_() for part in unpack_maps(0.9 * batch["maps"] + 0.01)]
    value = losses(app, Maps(*parts), batch, monkeypatch)
    value.sum().backward()
    moved = [part.grad.abs().amax((1, 2, 3)) > 0 for part in parts]  # type: ignore[union-attr]
    diffuse, specular, roughness, normal = (part_moved.tolist() for part_moved in moved)
    assert diffuse == normal == [True, True, True, False]
    assert specular == roughness == [True, False, False, False]


def test_flat_normals_have_the_lowest_loss_where_relief_is_ambiguous(
    app: SvbrdfNonstationary, tasks: Tasks, rng: Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Flat maps have a lower loss than slopes of either sign. Where slopes are known, true maps have the lowest."""
    batch = app.outer_sample(app.augment(tasks, rng), rng, 1)
    truth = unpack_maps(batch["maps"])
    turned = truth._replace(normal=truth.normal * torch.tensor([-1.0, -1.0, 1.0])[:, None, None])
    flat = truth._replace(normal=torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand_as(truth.normal))
    right, wrong, none = (losses(app, maps, batch, monkeypatch).mean() for maps in (truth, turned, flat))
    assert right < none < (right + wrong) / 2


@pytest.mark.long
@pytest.mark.usefixtures("random_vgg_in_cache")
def test_a_few_outer_steps_lower_the_loss(app: SvbrdfNonstationary, tasks: Tasks, rng: Generator) -> None:
    training = replace(RECIPE.general, tasks=4, steps=12, warmup_steps=0)
    general = general_training(app, replace(RECIPE, general=training))
    assert general.outer_loss is not None
    phi = general.first_phi(None, tasks, rng)
    loss = general.outer_loss(phi)
    drawn = loss.draw(tasks, Generator().manual_seed(0), 0.0).batch
    flat = app.decoder.make_maps(app.encode(phi.encoder, app.encoder_input(tasks, rng)), tasks.data["photo"])
    assert float(flat.normal[:, 2].mean()) > 0.99
    same = replace(loss, draw=lambda data, own, done: loss.draw(data, Generator().manual_seed(0), done))
    end = final_item(descend(phi.flatten(), outer_adam(training, phi.flatten()), tasks, same, steps=12, rng=rng)).theta
    before, after = (float(loss.value(parameters, drawn, {}).mean()) for parameters in (phi.flatten(), end))
    assert after < 0.9 * before
    encoder = {key.removeprefix("encoder."): value for key, value in end.items()}
    assert set(app.errors(app.encode(encoder, app.encoder_input(tasks, rng)), tasks)) >= {"error", "normal"}


# Both networks in one field, and steps by the photograph, which move one of them


@pytest.mark.usefixtures("random_vgg_in_cache")
def test_maps_are_the_mean_of_both_networks_but_for_normals(app: SvbrdfNonstationary, rng: Generator) -> None:
    """Before their ranges are imposed, and at resolutions that the smaller one does not read."""
    encoder = app.init_encoder(rng)
    photo = torch.rand(1, 3, 2 * SIDE, 2 * SIDE, generator=rng)
    inputs = pixel_inputs(photo)
    theta = app.encode(encoder, app.encoder.select_input(FitPhoto(photo, torch.zeros(1, 1))))
    size = {"height": 2 * SIDE, "width": 2 * SIDE, "rows": 2 * SIDE, "columns": 2 * SIDE}
    small_network = app.decoder.network._replace(**size)
    alone = {key.removeprefix("decoder."): value[None] for key, value in encoder.items() if key.startswith("decoder.")}
    first = small_network(alone | {"z": theta["z"][:, : small_network.code]}, inputs)
    full = load_full_general(torch.device("cpu"))
    beside = {key.removeprefix("decoder."): value[None] for key, value in full.items() if "decoder." in key}
    second = FULL_APP.decoder.network._replace(**size)(beside | {"z": theta["z"][:, small_network.code :]}, inputs)
    joined = app.decoder.evaluate(theta, inputs)
    torch.testing.assert_close(joined[:, :2], first[:, :2], atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(joined[:, 2:], torch.lerp(first, second, SECOND_SHARE)[:, 2:], atol=1e-4, rtol=1e-4)


def test_shallow_slopes_become_flatter_and_steep_ones_steeper(app: SvbrdfNonstationary) -> None:
    """In the same direction, each pixel by itself; a slope of SHALLOW is halved, but for STEEPER; other maps stay."""
    raw = torch.randn(2, sum(CHANNELS), 16, 16, generator=Generator().manual_seed(0))
    size = torch.logspace(-3, 1, 256).reshape(16, 16)
    size[0, 0] = HALVED_SLOPE
    raw[:, :2] *= size / raw[:, :2].norm(dim=1, keepdim=True)
    maps, as_read = app.decoder.finish_maps(raw), decode_maps(raw)
    for found, expected in zip(maps[:3], as_read[:3], strict=True):
        assert torch.equal(found, expected)
    slopes, read = (maps_of_one.normal[:, :2] / maps_of_one.normal[:, 2:] for maps_of_one in (maps, as_read))
    torch.testing.assert_close(slopes[:, :, 0, 0].norm(dim=1), torch.full((2,), SLOPE_GAIN * HALVED_SLOPE / 2))
    ratio = slopes / read
    torch.testing.assert_close(ratio[:, 0], ratio[:, 1], rtol=1e-2, atol=1e-3)
    assert (ratio[..., size < HALVED_SLOPE / 3] < 0.1 * SLOPE_GAIN + 1e-3).all()
    assert (ratio[..., size > 10 * HALVED_SLOPE] > 0.99 * SLOPE_GAIN - 1e-2).all()
    flat = torch.zeros(1, sum(CHANNELS), 4, 4, requires_grad=True)
    app.decoder.finish_maps(flat).normal.sum().backward()
    assert flat.grad is not None
    assert flat.grad.isfinite().all()


@pytest.mark.usefixtures("random_vgg_in_cache")
def test_training_sees_raw_maps_and_fits_see_processed_ones(
    app: SvbrdfNonstationary, tasks: Tasks, rng: Generator
) -> None:
    """Training on processed maps would undo the processing."""
    theta = app.encode(app.init_encoder(rng), app.encoder_input(tasks, rng))
    seen = app.sight.gather(tasks)
    raw = app.decoder.evaluate(theta, pixel_inputs(seen.photo))
    for maps, expected in (
        (app.decoder.decode_for_training(theta, seen).maps, decode_maps(raw)),
        (app.decoder.decode_for_steps(theta, seen).maps, app.decoder.finish_maps(raw)),
        (app.decoder.make_maps(theta, seen.photo), app.decoder.finish_maps(raw)),
    ):
        for found, other in zip(maps, expected, strict=True):
            torch.testing.assert_close(found, other)
    assert not torch.equal(decode_maps(raw).normal, app.decoder.finish_maps(raw).normal)


@pytest.mark.usefixtures("random_vgg_in_cache")
def test_photo_steps_equal_steps_of_the_whole_field_except_fixed_parts(
    app: SvbrdfNonstationary, tasks: Tasks, rng: Generator
) -> None:
    theta = app.encode(app.init_encoder(rng), app.encoder_input(tasks, rng))
    theta = {key: value.detach().requires_grad_() for key, value in theta.items()}
    batch, code_channels = app.sample(tasks, rng, 1), app.decoder.network.code
    loss = app.loss(theta, batch, {})
    maps, flash = app.decoder.make_maps(theta, batch["photo"]), app.decoder(theta, app.sight.gather(tasks)).flash
    radiance = render_photo(maps, flash)
    whole = compare_photos(radiance, batch["photo"], {}, trust_texels(maps, radiance, flash))
    torch.testing.assert_close(loss, whole)
    by_loss, by_whole = (
        dict(zip(theta, torch.autograd.grad(inner_loss.sum(), [*theta.values()], allow_unused=True), strict=True))
        for inner_loss in (loss, whole)
    )
    torch.testing.assert_close(by_loss["z"][:, code_channels:], by_whole["z"][:, code_channels:])
    torch.testing.assert_close(by_loss["flash"], by_whole["flash"])
    assert by_loss["z"][:, code_channels:].abs().amax() > 0
    assert (by_loss["z"][:, :code_channels] == 0).all()
    assert all(by_loss[key] is None for key in theta if "." in key)


@pytest.mark.usefixtures("random_vgg_in_cache")
def test_steps_by_a_photo_keep_the_normals(app: SvbrdfNonstationary, tasks: Tasks, rng: Generator) -> None:
    theta = app.encode(app.init_encoder(rng), app.encoder_input(tasks, rng))
    batch = app.sample(tasks, rng, 1)
    before, photo = app.decoder.make_maps(theta, batch["photo"]), task_loss(app, RECIPE.samples)
    end = final_item(
        descend(theta, fixed_adam(replace(RECIPE.quickft, rate=0.01), theta, 5), tasks, photo, steps=5, rng=rng)
    ).theta
    after = app.decoder.make_maps(end, batch["photo"])
    assert torch.equal(after.normal, before.normal)
    assert (app.loss(end, batch, {}) < app.loss(theta, batch, {})).all()
    for was, now in zip(before[:3], after[:3], strict=True):
        assert (was - now).abs().amax() > 1e-5


# What General reads of a photograph


def read_whole_photos(reader: Params, photos: Tensor, patch: Params | None = None) -> Params:
    """What is read of photos of whole patches."""
    positions = texel_positions(*photos.shape[-2:])[None]
    return read_photos(reader, photos, positions, describe_patch(photos) if patch is None else patch)


DIGEST = "bb6b69ff3905"  # the digest of General by "full" that the checkpoint's was measured beside


@pytest.mark.usefixtures("random_vgg_in_cache")
def test_the_same_parameters_read_photos_of_several_sizes(rng: Generator) -> None:
    reader = init_reader(rng, 5)
    for side in (32, 64):
        read = read_whole_photos(reader, torch.rand(2, 3, side, side, generator=rng))
        assert read["z"].shape == (2, 5, side, side)
        assert read["deviation"].shape == (2, len(PARTS), side // 4, side // 4)
        assert read["shown"].shape == (2,)
    with pytest.raises(ValueError, match="44 px, expected a multiple of 8"):
        read_whole_photos(reader, torch.rand(1, 3, 44, 44))


@pytest.mark.usefixtures("random_vgg_in_cache")
def test_the_flash_is_where_full_sees_it_in_all_of_the_patch(app: SvbrdfNonstationary, rng: Generator) -> None:
    """The flash is predicted from the whole patch, since it lies outside most windows."""
    encoder, photos = app.init_encoder(rng), torch.rand(2, 3, SIDE, SIDE, generator=rng) ** 2
    side = FULL_APP.decoder.network.height
    large = torch.nn.functional.interpolate(photos, (side, side), mode="bilinear")
    with torch.no_grad():
        expected = FULL_APP.encode(load_full_general(photos.device), {"photo": large})["flash"]
    whole = FitPhoto(photos, torch.zeros(2, 1))
    window = TrainingPhoto(photos[..., :16, :16], pixel_inputs(photos)[..., :16, :16], **describe_patch(photos))
    for seen in (whole, window):
        torch.testing.assert_close(app.encode(encoder, app.encoder.select_input(seen))["flash"], expected)


def test_exposure_and_white_balance_are_inputs_of_their_own(rng: Generator) -> None:
    """The rest of what is known of a photo, and what VGG sees, stays as it is; these move by as much."""
    photo, place = 0.1 + 0.3 * torch.rand(1, 3, 16, 16, generator=rng), texel_positions(16, 16)[None]
    gains = torch.tensor([1.3, 1.0, 0.6])[:, None, None]
    mean = photo.mean((2, 3), keepdim=True)
    (seen, known), (again, others) = _balance(photo, place, mean), _balance(photo * gains, place, mean * gains)
    torch.testing.assert_close(again, seen)
    torch.testing.assert_close(others[:, :-4], known[:, :-4])
    change = (others - known)[0, -4:, 0, 0]
    torch.testing.assert_close((3 * change[:1] + change[1:]).exp(), gains.flatten())


@pytest.mark.usefixtures("random_vgg_in_cache")
def test_a_window_is_read_with_all_of_its_patch(rng: Generator) -> None:
    """Gloss is read off an overview, which says the same of a patch in any window and at any resolution."""
    side = 64
    result = [draw_variants(torch.rand(2, 10, 128, 128, generator=rng), torch.ones(2, 4), side, rng) for _ in range(12)]
    whole = [float(variants["inputs"][:, -2:].std()) > 0.5 for variants in result]
    assert set(whole) == {True, False}
    for variants, seen in zip(result, whole, strict=True):
        assert variants["overview"].shape == (2, 3, OVERVIEW_PX, OVERVIEW_PX)
        assert variants["photo"].shape[-1] == variants["maps"].shape[-1] == variants["inputs"].shape[-1] == side
        if seen:
            torch.testing.assert_close(pixel_inputs(variants["photo"]), variants["inputs"])
            coarse = torch.nn.functional.avg_pool2d(variants["overview"], OVERVIEW_PX)
            torch.testing.assert_close(variants["photo"].mean((2, 3), keepdim=True), coarse)
    fine = torch.rand(1, 3, 512, 512, generator=rng)
    smooth = torch.nn.functional.avg_pool2d(fine, 2)
    torch.testing.assert_close(*(describe_patch(photo)["overview"] for photo in (fine, smooth)))
    untrained = init_reader(rng, 5)
    trained = {key: value + (0.1 if ".overview" in key else 0) for key, value in untrained.items()}
    patch, middle = describe_patch(smooth), (slice(None), slice(None), slice(96, 160), slice(96, 160))
    window = (smooth[middle], texel_positions(256, 256)[None][middle])
    for parameters, same in ((untrained, True), (trained, False)):  # of another patch with the same mean
        turned = patch | {"overview": patch["overview"].flip(3)}
        read, other = (read_photos(parameters, *window, patch_photo)["z"] for patch_photo in (patch, turned))
        assert torch.allclose(read, other, atol=1e-5) == same


def test_guess_agrees_with_general_of_the_full_recipe(rng: Generator) -> None:
    """Of all of the patch, whatever the photograph's size; and of the checkpoint that this one was measured beside."""
    assert tensor_digest(load_full_general(torch.device("cpu"))) == DIGEST, "measure pretrained beside this General"
    photo = torch.rand(1, 3, 256, 256, generator=rng)
    guess = describe_patch(photo)["guess"]
    full = recipes_of(APP, "photo")["full"].app
    assert isinstance(full, SvbrdfNonstationary)
    with torch.no_grad():
        maps = full.decoder.make_maps(full.encode(load_full_general(torch.device("cpu")), {"photo": photo}), photo)
    assert guess.shape == (1, GUESS_CHANNELS, 256, 256)
    torch.testing.assert_close(guess[:, :1], maps.roughness)
    torch.testing.assert_close(guess[:, 1:].exp() - LOG_FLOOR, torch.stack([maps.specular, maps.diffuse], 1).mean(2))
    twice = photo.repeat_interleave(2, 2).repeat_interleave(2, 3)
    torch.testing.assert_close(describe_patch(twice)["guess"], guess)


@pytest.mark.usefixtures("random_vgg_in_cache")
def test_windows_are_read_beside_the_guess_of_their_patch(rng: Generator) -> None:
    untrained = init_reader(rng, 5)
    trained = {key: value + (0.1 if ".guess.kernel" in key else 0) for key, value in untrained.items()}
    photo = torch.rand(1, 3, 32, 32, generator=rng)
    patch = describe_patch(photo)
    for parameters, same in ((untrained, True), (trained, False)):
        changed = patch | {"guess": 1 - patch["guess"]}
        read, other = (read_whole_photos(parameters, photo, patch_photo)["z"] for patch_photo in (patch, changed))
        assert torch.allclose(read, other, atol=1e-5) == same
