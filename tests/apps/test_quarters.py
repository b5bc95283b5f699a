"""Quarters of large pictures in training: the outer loss is the whole's on average, and all else sees the whole."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Generator, Tensor

from metapp.apps.svbrdf_nonstationary import quarters
from metapp.apps.svbrdf_nonstationary.app import MaterialSetup, SvbrdfNonstationary, field_of
from metapp.apps.svbrdf_nonstationary.quarters import drawn_quarters, quarter_of
from metapp.learning.app import stack
from metapp.learning.task import Batch, Params, Task, Tasks
from metapp.paradigms import Job, paradigms
from metapp.paradigms.general import outer_problem
from metapp.paradigms.validation import validation_error
from tests.apps.test_several_photos import several
from tests.apps.test_svbrdf_nonstationary import RECIPE

SIDE = 64  # the least whose cells of normals, and of how sure General is, are whole in quarters


@pytest.fixture(autouse=True)
def every_field_is_large(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(quarters, "LARGE", SIDE - 1)


@pytest.fixture
def app() -> SvbrdfNonstationary:
    return SvbrdfNonstationary(MaterialSetup(field_of(SIDE, 8)._replace(code=3), 4, sure=True), "photo")


def tasks_of(app: SvbrdfNonstationary, *, photos: int) -> Tasks:
    made = [several(seed, max(2, photos)) for seed in range(4)]
    keys = ("photo", "maps") if photos == 1 else ("photo", "maps", "others", "places")
    return stack(app, [Task(task.name, {key: task.data[key] for key in keys}) for task in made])


def predicted(app: SvbrdfNonstationary, tasks: Tasks, rng: Generator) -> tuple[Params, Batch]:
    """Parameters as of General before training, with codes of any size, and what the outer loss sees; float64."""
    theta = app.encode(app.init_encoder(rng), app.condition(tasks, rng))
    theta |= {"z": 0.02 * torch.randn(theta["z"].shape, generator=rng)}
    theta |= {"deviation": torch.randn(theta["deviation"].shape, generator=rng)}
    batch = app.outer_sample(tasks, rng, 1)
    batch["photo"] = (1.5 * batch["photo"]).clamp_max(1)  # some clip, unevenly
    double = [{key: value.double() if value.is_floating_point() else value for key, value in each.items()}
              for each in (theta, batch)]  # fmt: skip
    return {key: value.detach().requires_grad_() for key, value in double[0].items()}, double[1]


def loss_of(app: SvbrdfNonstationary, theta: Params, batch: Batch) -> tuple[Tensor, list[Tensor]]:
    """The outer losses [T] and the gradients of their sum."""
    loss = app.outer_loss(theta, batch, {})
    return loss.detach(), list(torch.autograd.grad(loss.sum(), list(theta.values()), materialize_grads=True))


@pytest.mark.parametrize("photos", [1, 3])
def test_the_mean_over_quarters_is_the_loss_of_the_whole(app: SvbrdfNonstationary, rng: Generator, photos: int) -> None:
    """Of all its parts: each texel, each cell of normals, each place of deviations, and where the photo clips."""
    theta, batch = predicted(app, tasks_of(app, photos=photos), rng)
    clips = (batch["photo"] > 0.95).flatten(1).any(1)
    assert clips.all()
    drawn = batch.pop("quarter")
    whole = loss_of(app, theta, batch)
    parts = [loss_of(app, theta, batch | {"quarter": torch.full_like(drawn, i)}) for i in range(4)]
    losses = torch.stack([loss for loss, _ in parts])
    assert (losses.std(0) > 1e-3 * whole[0]).all()  # quarters differ
    torch.testing.assert_close(losses.mean(0), whole[0])
    for name, grad, *others in zip(theta, whole[1], *(grads for _, grads in parts), strict=True):
        torch.testing.assert_close(torch.stack(others).mean(0), grad, msg=lambda text, name=name: f"{name}: {text}")


def test_random_quarters_have_that_mean(app: SvbrdfNonstationary, rng: Generator) -> None:
    tasks = tasks_of(app, photos=1)
    theta, batch = predicted(app, tasks, rng)
    each = torch.stack([loss_of(app, theta, batch | {"quarter": torch.full((4,), i)})[0] for i in range(4)])
    drawn = torch.stack([drawn_quarters(app.field, 4, rng)["quarter"] for _ in range(2000)])
    found = each.gather(0, drawn)
    error = each.std(0, correction=0) / 2000**0.5
    assert ((found.mean(0) - each.mean(0)).abs() < 4 * error).all()


def test_four_quarters_are_the_picture() -> None:
    pictures = torch.rand(3, 2, 5, 8, 6)
    parts = [quarter_of(pictures, torch.full((3,), i)) for i in range(4)]
    above, below = torch.cat(parts[:2], -1), torch.cat(parts[2:], -1)
    assert torch.equal(torch.cat([above, below], -2), pictures)
    mixed = quarter_of(pictures, torch.tensor([2, 0, 3]))
    assert all(torch.equal(mixed[i], parts[k][i]) for i, k in enumerate((2, 0, 3)))


def test_small_pictures_are_seen_as_a_whole(app: SvbrdfNonstationary, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the same draws as before: a training of 64 or 128 texels is what it was."""
    monkeypatch.setattr(quarters, "LARGE", SIDE)
    tasks = tasks_of(app, photos=1)
    first, second = (Generator().manual_seed(5) for _ in range(2))
    batch, plain = app.outer_sample(tasks, first, 1), app.sample(tasks, second, 1)
    assert batch.keys() == plain.keys()
    assert all(torch.equal(batch[key], plain[key]) for key in batch)
    assert torch.equal(first.get_state(), second.get_state())


def test_the_encoder_reads_the_whole_photo(app: SvbrdfNonstationary, rng: Generator) -> None:
    """What is not in the quarter reaches the loss through the code alone."""
    tasks = tasks_of(app, photos=1)
    weights = app.init_encoder(rng)
    batch = app.outer_sample(tasks, rng, 1) | {"quarter": torch.zeros(4, dtype=torch.long)}
    batch["photo"] = batch["photo"].clamp_max(0.9)  # how much of a photo clips is known of the whole, too
    other = batch | {"photo": batch["photo"].clone(), "maps": batch["maps"].clone()}
    other["photo"][..., SIDE // 2 + 8 :] *= 0.5
    other["maps"][..., SIDE // 2 + 8 :] *= 0.5
    theta = app.encode(weights, {"photo": batch["photo"]})
    before = app.outer_loss(theta, batch, {})
    torch.testing.assert_close(app.outer_loss(theta, other, {}), before)
    again = app.outer_loss(app.encode(weights, {"photo": other["photo"]}), batch, {})
    assert ((again - before).abs() > 1e-5).all()


def test_general_is_trained_on_quarters_and_validated_on_the_whole(
    app: SvbrdfNonstationary, rng: Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    tasks = tasks_of(app, photos=1)
    recipe = replace(RECIPE, setup=app.setup, general=replace(RECIPE.general, tasks=2))
    job = Job(app, recipe, "meta-encoder")
    phi, loss = outer_problem(job, rng)
    _, (condition, batch) = loss.draw(tasks, rng, 0.0)
    assert condition["photo"].shape[-1] == SIDE
    assert batch["quarter"].shape == (2,)
    seen = []
    original = SvbrdfNonstationary.maps_of

    def maps_of(app: SvbrdfNonstationary, theta: Params, photo: Tensor) -> object:
        seen.append(photo.shape[-1])
        return original(app, theta, photo)

    monkeypatch.setattr(SvbrdfNonstationary, "maps_of", maps_of)
    monkeypatch.setattr(SvbrdfNonstationary, "outer_sample", None)
    assert validation_error(paradigms()["general"], job, phi, tasks) > 0
    assert set(seen) == {SIDE}
