"""The BRDF application: its network, losses, samples, encoder and made-up materials."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Generator, Tensor

from data_tools.readers.brdf_task import make_brdf_task
from data_tools.readers.nbrdf_files import evaluate_nbrdf, export, read_nbrdf
from data_tools.synthetic.brdf import synthetic_materials
from metapp.appearance.geometry import angle_cosines
from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.nbrdf_network import WEIGHT_KNOTS
from metapp.learning.app import stack_tasks
from metapp.learning.task import Batch, Params, Task, Tasks
from tests.recipe_apps import asset_of, recipes_of

APP = Brdf()

SAMPLES = 512


@pytest.fixture(scope="module")
def materials() -> list[Task]:
    return [make_brdf_task(brdf.name, brdf.evaluate, samples=SAMPLES) for brdf in synthetic_materials("train", 4)]


@pytest.fixture(scope="module")
def tasks(materials: list[Task]) -> Tasks:
    return stack_tasks(APP, materials)


@pytest.fixture
def theta(rng: Generator) -> Params:
    """Four random networks that are not black anywhere near."""
    theta = APP.init(rng, 4)
    return {key: value + 0.3 * torch.rand(value.shape, generator=rng) for key, value in theta.items()}


@pytest.fixture
def batch(tasks: Tasks, rng: Generator) -> Batch:
    return APP.sample(tasks, rng, 100)


def network_by_hand(theta: Params, task: int, inputs: np.ndarray) -> np.ndarray:
    """exp(out) - 1 of one network, inputs [6, N]."""
    x, weights = inputs, {key: value[task].numpy() for key, value in theta.items()}
    for layer in (1, 2, 3):
        x = weights[f"w{layer}"] @ x + weights[f"b{layer}"]
        x = np.maximum(x, 0) if layer < 3 else np.exp(x) - 1
    return x


def distance_by_hand(theta: Params, batch: Batch, task: int) -> np.ndarray:
    """|log(1 + f cos) - log(1 + f' cos)|, [3, N]."""
    where, target = batch["where"][task].numpy(), batch["target"][task].numpy()
    return np.abs(np.log1p(network_by_hand(theta, task, where[:6]) * where[6]) - target)


def test_papers_recipe_has_the_papers_initialisation_and_settings() -> None:
    """Weights uniform in +-0.05 and biases 0 (Sztrajman et al. 2021), also in what an untrained General predicts."""
    recipe = recipes_of("brdf")["paper"]
    app = recipe.app
    theta = app.init(Generator().manual_seed(0), 2000)
    for layer in (1, 2, 3):
        assert 0.0499 < theta[f"w{layer}"].abs().max() <= 0.05
        torch.testing.assert_close(theta[f"w{layer}"].var(), torch.tensor(0.1**2 / 12), rtol=0.02, atol=0)
        assert not theta[f"b{layer}"].any()
    assert app.init_encoder(Generator().manual_seed(0))["out.b"].abs().max() <= 0.05
    training = recipe.meta["meta-sgd"]
    assert (recipe.steps, recipe.samples, training.tasks, training.order) == (10, 512, 1, 2)
    assert (training.steps, training.rates, training.weight_decay, training.initial_adam.rate) == (
        1_000_000,
        {"": 1e-4},
        1e-6,
        1e-3,
    )


def test_losses_agree_with_worked_values(theta: Params, batch: Batch, rng: Generator) -> None:
    """Plain, smoothed, and of weighted samples."""
    rounding, knots = torch.tensor([0.3, 0.1, 0.01, 1.0]), torch.randn(4, WEIGHT_KNOTS, generator=rng)
    loss = APP.loss(theta, batch, {})
    smooth = APP.loss(theta, batch, {"smoothing": rounding.log(), "weights": torch.zeros(4, WEIGHT_KNOTS)})
    weighted_reflectance = APP.loss(theta, batch, {"smoothing": torch.full((4,), -20.0), "weights": knots})
    assert loss.shape == (4,)
    assert (smooth < loss).all()
    for task, s in enumerate(rounding.tolist()):
        d = distance_by_hand(theta, batch, task)
        np.testing.assert_allclose(float(loss[task]), d.mean(), rtol=1e-5)
        np.testing.assert_allclose(float(smooth[task]), (np.sqrt(d * d + s * s) - s).mean(), rtol=1e-4)
        theta_h = np.arccos(batch["where"][task, 2].clamp(-1, 1).numpy())
        weight = np.exp(np.interp(theta_h, np.linspace(0, math.pi / 2, WEIGHT_KNOTS), knots[task].numpy()))
        np.testing.assert_allclose(float(weighted_reflectance[task]), (d * weight).mean(), rtol=1e-4)


def test_same_as_the_published_network(theta: Params, materials: list[Task], tasks: Tasks, tmp_path: Path) -> None:
    """Through an export to files and back: the formula of Sztrajman et al., and the same errors."""
    angles, errors = materials[0].data["angles"], APP.errors(theta, tasks)["error"]
    held_out = slice(SAMPLES // 2, None)
    for task, material in enumerate(materials):
        single = {key: value[task] for key, value in theta.items()}
        export(asset_of(APP, single, material), tmp_path / material.name, {})
        published = evaluate_nbrdf(read_nbrdf(tmp_path / material.name), angles)
        torch.testing.assert_close(APP.reflectance(single, angles), published, rtol=1e-5, atol=1e-5)
        cosine, truth = angle_cosines(angles).incident[held_out, None], material.data["reflectance"][held_out]
        error = (torch.log1p(published[held_out] * cosine) - torch.log1p(truth * cosine)).abs().mean()
        torch.testing.assert_close(error, errors[task], rtol=1e-4, atol=1e-7)


# Samples


def poison_second_half(tasks: Tasks, part: slice) -> Tasks:
    target = tasks.data["target"].clone()
    target[:, part] = math.nan
    return Tasks(tasks.names, {**tasks.data, "target": target}, tasks.rows)


def test_fits_see_the_first_half_alone(tasks: Tasks, theta: Params, rng: Generator) -> None:
    hidden, seen = poison_second_half(tasks, slice(SAMPLES // 2, None)), poison_second_half(tasks, slice(SAMPLES // 2))
    drawn = APP.sample(hidden, rng, 5000)["target"]
    assert torch.isfinite(drawn).all()
    assert torch.isfinite(APP.encoder_input(hidden, rng)["target"]).all()
    assert torch.isfinite(APP.errors(theta, seen)["error"]).all()
    assert len(drawn[0].T.unique(dim=0)) > 0.95 * len(tasks.data["target"][0, : SAMPLES // 2].unique(dim=0))


# Encoder


def test_encoder_does_not_depend_on_the_order_of_samples(tasks: Tasks, rng: Generator) -> None:
    encoder, seen = APP.init_encoder(rng), APP.encoder_input(tasks, rng)
    shuffled = {key: value[..., torch.randperm(value.shape[-1], generator=rng)] for key, value in seen.items()}
    order = torch.randperm(seen["where"].shape[-1], generator=rng)
    together = {key: value[..., order] for key, value in seen.items()}
    theta, same = APP.encode(encoder, seen), APP.encode(encoder, together)
    for key, value in theta.items():
        torch.testing.assert_close(same[key], value, rtol=1e-4, atol=1e-5)
    other = APP.encode(encoder, shuffled)  # other targets for the same places are another material
    assert not torch.allclose(other["w2"], theta["w2"], rtol=1e-4, atol=1e-5)


# Made-up materials


def separate_angles(tasks: Tasks) -> Tasks:
    """Return the materials with angles of their own, so that they cannot be mixed."""
    return Tasks(tasks.names, {key: value.clone().contiguous() for key, value in tasks.data.items()}, tasks.rows)


def weighted(tasks: Tasks) -> Tensor:
    """f cos theta_i of the stacked materials, [M, N, 3]."""
    return torch.expm1(tasks.data["target"])


def sources(mixed: Tasks, tasks: Tasks) -> Tensor:
    """Indices [N] of the samples of `tasks` that made-up materials stand at."""
    return torch.cdist(mixed.data["where"][0].double(), tasks.data["where"][0].double()).argmin(1)


def test_augmented_material_is_a_single_material(tasks: Tasks, rng: Generator) -> None:
    """Each channel is one channel of the source times one factor, at every sample."""
    separate = separate_angles(tasks)
    variants = APP.augment(separate, rng)
    assert (variants.data["target"] >= 0).all()
    before, after = weighted(separate)[:, sources(variants, separate)], weighted(variants)
    permuted = 0
    for task in range(4):
        matches = []
        for channel in range(3):
            factors = after[task, :, [channel]] / before[task].clamp_min(1e-9)  # dark at the horizon
            spread = factors.std(0) / factors.mean(0)
            matches.append(int(spread.argmin()))
            assert float(spread.min()) < 1e-2
        permuted += sorted(matches) == [0, 1, 2] and matches != [0, 1, 2]
    assert permuted


def test_mixtures_are_between_two_materials(tasks: Tasks, rng: Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    grey = weighted(tasks).mean(2, keepdim=True).expand(-1, -1, 3)  # which permuting channels leaves alone
    tasks = Tasks(tasks.names, {**tasks.data, "target": torch.log1p(grey)}, tasks.rows)
    monkeypatch.setattr(
        "metapp.apps.brdf.sample_augmentation.draw_normal", lambda rng, *shape: torch.zeros(shape)
    )  # no gains
    mixed = 0
    for _ in range(4):
        variants = APP.augment(tasks, rng)
        at = sources(variants, tasks)
        for task in range(4):
            mine, result = grey[task, at, 0], weighted(variants)[task, :, 0]
            fits = []  # (how much the share of the task varies over samples, that share), for each other one
            for other in set(range(4)) - {task}:
                gap = mine - grey[other, at, 0]
                clear = gap.abs() > 0.05 * gap.abs().max()
                shares = 1 + ((result - mine) / gap)[clear]
                fits.append((float(shares.std()), float(shares.mean())))
            deviation, share = min(fits)
            assert deviation < 1e-3
            assert -1e-3 < share < 1 + 1e-3
            mixed += share < 0.99
    assert 3 <= mixed <= 15
