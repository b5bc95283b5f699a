"""The outer loss, and a few outer steps."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Generator, Tensor

from metapp.appearance.flash import Maps, unpack
from metapp.apps.svbrdf_nonstationary.maps import FLASH
from metapp.extensions.pretrained.app import FromFeatures
from metapp.learning.learn import descend, final_item
from metapp.learning.rules import outer_adam
from metapp.learning.task import Batch, Tasks
from metapp.paradigms.general import General
from tests.extensions.pretrained.conftest import RECIPE


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
    general = General(app, replace(RECIPE, general=training))
    phi = general.first_phi(None, tasks, rng)
    loss = general.outer_loss(phi)
    drawn = loss.draw(tasks, Generator().manual_seed(0), 0.0).batch
    flat = app.maps_of(app.encode(phi.encoder, app.condition(tasks, rng)), tasks.data["photo"])
    assert float(flat.normal[:, 2].mean()) > 0.99
    same = replace(loss, draw=lambda data, own, done: loss.draw(data, Generator().manual_seed(0), done))
    end = final_item(descend(phi.flat(), outer_adam(training, phi.flat()), tasks, same, steps=12, rng=rng)).theta
    before, after = (float(loss.value(each, drawn, {}).mean()) for each in (phi.flat(), end))
    assert after < 0.9 * before
    encoder = {key.removeprefix("encoder."): value for key, value in end.items()}
    assert set(app.errors(app.encode(encoder, app.condition(tasks, rng)), tasks)) >= {"error", "normal"}
