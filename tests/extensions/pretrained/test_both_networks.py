"""Both networks in one field, and steps by the photograph, which move one of them."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Generator

from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.maps import RAW, decoded, inputs_of
from metapp.extensions.pretrained.app import SHALLOW, SHARE, STEEPER, FromFeatures
from metapp.extensions.pretrained.encoder import FULL_APP, full_encoder, patch_of
from metapp.learning.learn import descend, final_item, task_loss
from metapp.learning.rules import fixed_adam
from metapp.learning.task import Tasks
from metapp.networks.field import LocalField
from tests.extensions.pretrained.conftest import RECIPE, SIDE


@pytest.mark.usefixtures("weights")
def test_maps_are_the_mean_of_both_networks_but_for_normals(app: FromFeatures, rng: Generator) -> None:
    """Before their ranges are imposed, and at resolutions that the smaller one does not read."""
    encoder = app.init_encoder(rng)
    photo = torch.rand(1, 3, 2 * SIDE, 2 * SIDE, generator=rng)
    inputs = inputs_of(photo)
    theta = app.encode(encoder, {"photo": photo, "inputs": inputs, **patch_of(photo)})
    size = {"height": 2 * SIDE, "width": 2 * SIDE, "rows": 2 * SIDE, "columns": 2 * SIDE}
    own = LocalField(*app.network)._replace(**size)
    alone = {key.removeprefix("decoder."): value[None] for key, value in encoder.items() if key.startswith("decoder.")}
    first = own(alone | {"z": theta["z"][:, : own.code]}, inputs)
    full = full_encoder(torch.device("cpu"))
    beside = {key.removeprefix("decoder."): value[None] for key, value in full.items() if "decoder." in key}
    second = FULL_APP.network._replace(**size)(beside | {"z": theta["z"][:, own.code :]}, inputs)
    joined = app.network._replace(**size)(theta, inputs)
    torch.testing.assert_close(joined[:, :2], first[:, :2], atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(joined[:, 2:], torch.lerp(first, second, SHARE)[:, 2:], atol=1e-4, rtol=1e-4)


def test_shallow_slopes_become_flatter_and_steep_ones_steeper(app: FromFeatures) -> None:
    """In the same direction, each pixel by itself; a slope of SHALLOW is halved, but for STEEPER; other maps stay."""
    raw = torch.randn(2, sum(RAW), 16, 16, generator=Generator().manual_seed(0))
    size = torch.logspace(-3, 1, 256).reshape(16, 16)
    size[0, 0] = SHALLOW
    raw[:, :2] *= size / raw[:, :2].norm(dim=1, keepdim=True)
    maps, as_read = app.maps_from(raw), decoded(raw)
    for found, wanted in zip(maps[:3], as_read[:3], strict=True):
        assert torch.equal(found, wanted)
    slopes, read = (each.normal[:, :2] / each.normal[:, 2:] for each in (maps, as_read))
    torch.testing.assert_close(slopes[:, :, 0, 0].norm(dim=1), torch.full((2,), STEEPER * SHALLOW / 2))
    ratio = slopes / read
    torch.testing.assert_close(ratio[:, 0], ratio[:, 1], rtol=1e-2, atol=1e-3)
    assert (ratio[..., size < SHALLOW / 3] < 0.1 * STEEPER + 1e-3).all()
    assert (ratio[..., size > 10 * SHALLOW] > 0.99 * STEEPER - 1e-2).all()
    flat = torch.zeros(1, sum(RAW), 4, 4, requires_grad=True)
    app.maps_from(flat).normal.sum().backward()
    assert flat.grad is not None
    assert flat.grad.isfinite().all()


@pytest.mark.usefixtures("weights")
def test_training_sees_what_the_network_makes_and_fits_what_is_made_of_it(
    app: FromFeatures, tasks: Tasks, rng: Generator
) -> None:
    """Else training would undo it."""
    theta = app.encode(app.init_encoder(rng), app.condition(tasks, rng))
    photo = tasks.data["photo"]
    raw = app.network(theta, inputs_of(photo))
    for maps, wanted in (
        (app._made_of(theta, inputs_of(photo)), decoded(raw)),
        (app.maps_of(theta, photo), app.maps_from(raw)),
    ):
        for found, other in zip(maps, wanted, strict=True):
            torch.testing.assert_close(found, other)
    assert not torch.equal(decoded(raw).normal, app.maps_from(raw).normal)


@pytest.mark.usefixtures("weights")
def test_a_step_by_a_photo_is_that_of_the_whole_field_but_for_what_is_held(
    app: FromFeatures, tasks: Tasks, rng: Generator
) -> None:
    theta = app.encode(app.init_encoder(rng), app.condition(tasks, rng))
    theta = {key: value.detach().requires_grad_() for key, value in theta.items()}
    batch, own = app.sample(tasks, rng, 1), app.network.code
    loss = app.loss(theta, batch, {})
    whole = SvbrdfNonstationary.loss(app, theta, batch, {})
    torch.testing.assert_close(loss, whole)
    by_loss, by_whole = (
        dict(zip(theta, torch.autograd.grad(each.sum(), [*theta.values()], allow_unused=True), strict=True))
        for each in (loss, whole)
    )
    torch.testing.assert_close(by_loss["z"][:, own:], by_whole["z"][:, own:])
    torch.testing.assert_close(by_loss["flash"], by_whole["flash"])
    assert by_loss["z"][:, own:].abs().amax() > 0
    assert (by_loss["z"][:, :own] == 0).all()
    assert all(by_loss[key] is None for key in theta if "." in key)


@pytest.mark.usefixtures("weights")
def test_steps_by_a_photo_keep_the_normals(app: FromFeatures, tasks: Tasks, rng: Generator) -> None:
    theta = app.encode(app.init_encoder(rng), app.condition(tasks, rng))
    batch = app.sample(tasks, rng, 1)
    before, photo = app.maps_of(theta, batch["photo"]), task_loss(app, RECIPE.batch)
    end = final_item(
        descend(theta, fixed_adam(replace(RECIPE.quickft, rate=0.01), theta, 5), tasks, photo, steps=5, rng=rng)
    ).theta
    after = app.maps_of(end, batch["photo"])
    assert torch.equal(after.normal, before.normal)
    assert (app.loss(end, batch, {}) < app.loss(theta, batch, {})).all()
    for was, now in zip(before[:3], after[:3], strict=True):
        assert (was - now).abs().amax() > 1e-5
