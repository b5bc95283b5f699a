"""Textures at several octaves: what is compared at each, and that descents go from coarse to fine."""

from __future__ import annotations

import pytest
import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d

from metapp.appearance.features import RANDOM, gram, load_features
from metapp.apps.texture import Texture
from metapp.apps.texture.recipes import FULL
from metapp.learning.learn import MetaParameters, learn, over_tasks, task_loss
from metapp.learning.rules import sgd
from metapp.learning.task import Tasks
from metapp.paradigms import Job, paradigms
from tests.apps.octaves import TAPS, noise_tasks, tiny

TINY = tiny(FULL, 32, 0.6)


@pytest.fixture(scope="module")
def app() -> Texture:
    return Texture(TINY.setup)


@pytest.fixture(scope="module")
def tasks(app: Texture) -> Tasks:
    return noise_tasks(app, 3)


def test_the_recipe() -> None:
    """At 64 texels four layers are compared, at 128 three, at 256 two."""
    setup = FULL.setup
    assert [setup.taps_of(octave) for octave in (0, 1, 2)] == [2, 3, 4]
    assert [setup.maps_from(octave) for octave in (0, 1, 2)] == [9, 7, 4]
    assert (setup.height, setup.width, setup.taps[-1]) == (256, 256, "relu4_1")


def test_what_is_compared(app: Texture, tasks: Tasks) -> None:
    """Three layers of the picture of half the size, then two of the whole."""
    image = app.exemplar(tasks.data["image"][:1].float() / 255)
    features = load_features("vgg16", TAPS, image)
    maps = features(avg_pool2d(image, 2)) + features(image)[:2]
    assert len(maps) == 5
    for i, each in enumerate(maps):
        torch.testing.assert_close(tasks.data[f"gram{i}"][:1], gram(each))
    assert tasks.data["summary"].shape == (3, 2 * 5 * RANDOM) == (3, app.summary_size())


def test_an_exemplar_is_at_no_distance_from_itself(app: Texture, tasks: Tasks) -> None:
    images = app.exemplar(tasks.data["image"].float() / 255)[:, None]
    assert app.errors_of(images, tasks)["error"].max() < 1e-5
    assert app.errors_of(images.roll(1, 0), tasks)["error"].min() > 1e-3


def test_descents_go_from_coarse_to_fine(app: Texture, tasks: Tasks) -> None:
    coarse = app.stage(tasks, 0.59)
    assert sorted(key for key in coarse.data if key.startswith("gram")) == ["gram0", "gram1", "gram2"]
    assert app.stage(tasks, 0.6) is tasks
    rng, seen = Generator().manual_seed(0), []

    class Watched(Texture):
        def sample(self, tasks: Tasks, rng: Generator, count: int) -> dict[str, Tensor]:
            batch = super().sample(tasks, rng, count)
            seen.append(batch["noise"].shape[-1])
            return batch

    watched = Watched(TINY.setup)
    theta, rule = watched.init(rng, 3), sgd(dict.fromkeys(("rate",), torch.zeros(1)))
    learn(theta, rule, tasks, task_loss(watched, 1), steps=5, rng=rng)
    assert seen == [16, 16, 16, 32, 32]
    seen.clear()
    lifted = over_tasks(task_loss(watched, 1), count=2, augment=watched.augment)
    lifted.draw_at(tasks, rng, 0, 10)
    lifted.draw_at(tasks, rng, 9, 10)
    assert seen == [16, 32]


def test_a_coarse_loss_leaves_the_finest_level_alone(app: Texture, tasks: Tasks) -> None:
    rng = Generator().manual_seed(0)
    theta = {key: value.requires_grad_() for key, value in app.init(rng, 3).items()}
    loss = app.loss(theta, app.sample(app.stage(tasks, 0.0), rng, 1), {})
    grads = torch.autograd.grad(loss.sum(), list(theta.values()), materialize_grads=True)
    moved = {key.split(".")[0] for key, grad in zip(theta, grads, strict=True) if grad.any()}
    assert moved == {"z", "join2", "draw2", "out2", "join1", "draw1", "out1"}


def test_summaries_of_coarse_exemplars_are_as_long(app: Texture, tasks: Tasks) -> None:
    """The finest octave that is seen stands for those that are not."""
    images = avg_pool2d(app.exemplar(tasks.data["image"].float() / 255), 2)
    described = app.describe(images, octave=1)
    coarse, finer = described["summary"].split([2 * 3 * RANDOM, 2 * 2 * RANDOM], 1)
    assert torch.equal(finer, coarse[:, : 2 * 2 * RANDOM])
    torch.testing.assert_close(coarse, tasks.data["summary"][:, : 2 * 3 * RANDOM])
    assert app.octave(described) == 1
    assert app.octave(tasks.data) == 0


def test_a_few_steps_lower_the_error(app: Texture, tasks: Tasks) -> None:
    errors = []
    for steps in (1, 40):
        theta = paradigms()["overfit"].fit(
            Job(app, TINY, TINY.rule, steps), MetaParameters(), tasks, Generator().manual_seed(0)
        )
        errors.append(app.errors(theta, tasks)["error"].mean())
    assert errors[1] < 0.6 * errors[0]
