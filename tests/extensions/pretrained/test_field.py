"""Both networks in one field, and steps by the photograph, which move one of them."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Generator, Tensor

from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.maps import inputs_of
from metapp.extensions.pretrained.app import SHALLOW, FromFeatures
from metapp.extensions.pretrained.encoder import SHARE, SMALLER, _smaller, beside_smaller, patch_of
from metapp.learning.learn import descend, last
from metapp.learning.rules import fixed_adam
from metapp.learning.task import Batch, Tasks
from metapp.paradigms import Job
from metapp.paradigms.paradigm import plain_loss
from tests.extensions.pretrained.conftest import RECIPE, SIDE


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
def test_a_step_by_a_photo_is_that_of_the_whole_field_but_for_what_is_held(
    app: FromFeatures, tasks: Tasks, rng: Generator
) -> None:
    theta = app.encode(app.init_encoder(rng), app.condition(tasks, rng))
    theta = {key: value.detach().requires_grad_() for key, value in theta.items()}
    batch, own = app.sample(tasks, rng, 1), app.setup.field.code
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
    before, photo = app.maps_of(theta, batch["photo"]), plain_loss(Job(app, RECIPE, ""))
    end = last(
        descend(theta, fixed_adam(replace(RECIPE.quickft, rate=0.01), theta, 5), tasks, photo, steps=5, rng=rng)
    ).theta
    after = app.maps_of(end, batch["photo"])
    assert torch.equal(after.normal, before.normal)
    assert (app.loss(end, batch, {}) < app.loss(theta, batch, {})).all()
    for was, now in zip(before[:3], after[:3], strict=True):
        assert (was - now).abs().amax() > 1e-5
