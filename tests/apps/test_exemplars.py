"""Pictures from noise, at several octaves: what is compared at each, from coarse to fine, and that relief is kept."""

import math
import re
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d

from metapp.appearance.doubts import LOST_ORDER
from metapp.appearance.features import NOISE_DISPLAY_VALUE, detail_statistics
from metapp.apps.exemplar.exemplar_codec import move_tiles
from metapp.apps.exemplar.exemplar_sight import ExemplarSight
from metapp.apps.exemplar.octaves import Octaves
from metapp.apps.exemplar.presenter import ExemplarPresenter
from metapp.apps.exemplar.recipes import CANDIDATES
from metapp.apps.svbrdf_stationary.app import SvbrdfStationary, compose_svbrdf
from metapp.apps.svbrdf_stationary.flash_statistics import SOFTNESS_WEIGHT
from metapp.learning.app import App, stack_tasks
from metapp.learning.learn import MetaParameters, learn, over_tasks, task_loss
from metapp.learning.rules import sgd
from metapp.learning.task import Params, Task, Tasks
from metapp.networks.generators import Pyramid
from metapp.networks.layers import enlarge_periodic
from metapp.networks.quilted import normalise_quilts, quilt_deviation
from metapp.paradigms.methods import fit_tasks, make_method
from tests.recipe_apps import presenter_of, recipes_of

TAPS = ("relu1_1", "relu2_1", "relu3_1")
SHARE = 0.6  # of the steps at half the size


@pytest.fixture(scope="module")
def app() -> SvbrdfStationary:
    """Return the application of the recipe full with a small network, of two octaves."""
    octaves = Octaves(64, 64, TAPS, count=2, shares=(SHARE,))
    return compose_svbrdf(Pyramid(4, 3, code=8, outputs=6, quilt=3), octaves, CANDIDATES, expects_gloss=True)


def draw_noise(app: SvbrdfStationary, rng: Generator, *counts: int, octave: int = 0) -> Tensor:
    size = app.decoder.octaves.octave_size(octave)
    return torch.randn(*counts, app.decoder.noise_channels, *size, generator=rng)


def shown(app: App) -> ExemplarPresenter:
    presenter = presenter_of(app)
    assert isinstance(presenter, ExemplarPresenter)
    return presenter


def warnings_of(app: App, theta: Params, tasks: Tasks) -> list[list[str]]:
    return shown(app).quality_warnings(theta, tasks)


@pytest.fixture(scope="module")
def tasks(app: SvbrdfStationary) -> Tasks:
    """Exemplars of white noise, the same each time."""
    images = torch.randint(256, (3, 3, 64, 64), generator=Generator().manual_seed(0), dtype=torch.uint8)
    return stack_tasks(app, [Task(f"noise {i}", {"image": image}) for i, image in enumerate(images)])


@pytest.mark.parametrize(
    ("name", "steps", "tasks", "size"), [("texture", 15, 5, (192, 256)), ("svbrdf_stationary", 20, 3, (256, 256))]
)
def test_recipes_of_the_paper_have_its_settings(name: str, steps: int, tasks: int, size: tuple[int, int]) -> None:
    recipe = recipes_of(name)["paper"]
    training = recipe.meta["meta-sgd"]
    assert (recipe.steps, recipe.rule, training.tasks, training.order) == (steps, "meta-sgd", tasks, 1)
    rng = Generator().manual_seed(0)
    app: Any = recipe.app
    assert app.decoder.shown_noise(torch.zeros(1)).shape == (1, 1, 8, *size)
    assert 5e5 < sum(value.numel() for value in app.init(rng, 1).values()) < 5e6
    photos = torch.rand(1, 3, 256, 256, generator=rng)
    rows = (256 - size[0]) // 2
    assert torch.equal(app.decoder.octaves.take_exemplar(photos), photos[:, :, rows : 256 - rows])


def test_lost_order_is_doubted_where_networks_read_quilts(
    app: SvbrdfStationary, tasks: Tasks, monkeypatch: pytest.MonkeyPatch
) -> None:
    at = torch.arange(64)
    tiles = 60 + 130 * ((at[:, None] % 16 < 6) | (at % 16 < 6)).to(torch.uint8).expand(3, -1, -1)
    ordered = Task("tiles", {"image": tiles})
    noise = Task("noise", {"image": tasks.data["image"][0]})
    both = stack_tasks(app, [noise, ordered])
    theta = app.init(Generator().manual_seed(0), 2) | app.task_parameters(both.select([0, 0]))
    unordered, (clause, *_) = warnings_of(app, theta, both)
    assert not any("regular structure" in other for other in unordered)
    remedy = "a photo that shows it more often helps"
    kept = re.fullmatch(rf"keeps (\S+) of the photo's regular structure \({remedy}\)", clause)
    assert kept
    assert 0 <= float(kept[1]) < LOST_ORDER.limit
    alone = {key: value[1:] for key, value in theta.items()}
    assert warnings_of(app, alone, both.select([1]))[0][0] == clause
    copies = app.decoder.octaves.take_exemplar(both.data["image"].float() / 255)[:, None].roll(5, -1)
    monkeypatch.setattr(type(app.judge), "render_prediction", lambda *_: copies)
    assert not any("regular structure" in other for clauses in warnings_of(app, theta, both) for other in clauses)
    quick = recipes_of(app.name)["quick"].app
    assert warnings_of(quick, {}, both) == [[], []]


def test_pictures_that_collapsed_are_doubted(
    app: SvbrdfStationary, tasks: Tasks, monkeypatch: pytest.MonkeyPatch
) -> None:
    theta = app.init(Generator().manual_seed(0), 3) | app.task_parameters(tasks)
    shape = (3, 1, 3, *app.decoder.octaves.octave_size())
    varied = torch.rand(shape, generator=Generator().manual_seed(1))
    for result, message in (
        (torch.zeros(shape), "the fit is black, and its input is not"),
        (torch.full(shape, 0.4), "the fit is the same everywhere, and its input is not"),
        (0.02 * varied, ""),
        (varied, ""),
    ):
        monkeypatch.setattr(type(app.judge), "render_prediction", lambda *_, result=result: result)
        for clauses in warnings_of(app, theta, tasks):
            assert any(clause.startswith("the fit is") for clause in clauses) == bool(message)
            assert any(clause.startswith(message) for clause in clauses) or not message


def test_broken_lines_are_doubted_where_no_lattice_is_lost(
    app: SvbrdfStationary, tasks: Tasks, monkeypatch: pytest.MonkeyPatch
) -> None:
    theta = app.init(Generator().manual_seed(0), 3) | app.task_parameters(tasks)
    found = iter([0.4, 1.0, math.nan])
    monkeypatch.setattr("metapp.apps.exemplar.presenter.compare_lines", lambda *_: next(found))
    broken, intact, unknown = (
        [clause for clause in clauses if "relief" not in clause] for clauses in warnings_of(app, theta, tasks)
    )
    assert len(broken) == 1
    assert broken[0].startswith("breaks lines of the photo such as joints, cracks or threads (0.40 as strong, ")
    assert "a photo that shows them more often helps" in broken[0]
    assert not any("lines" in clause for clause in (*intact, *unknown))
    assert not any(";" in clause for clause in broken)  # which parts clauses in records


def test_fits_see_a_crop_of_the_finest_octave_alone(app: SvbrdfStationary) -> None:
    images = torch.rand(2, 3, *app.decoder.octaves.octave_size(), generator=Generator().manual_seed(0))
    whole, cropped = (
        app.judge.compute_features(images, 0),
        app.judge.compute_features(images, 0, lambda features: features[..., : features.shape[-2] // 2, :]),
    )
    rows = images.shape[-2] // 2
    assert [octave.shape[-2] for octave in cropped] == [*(octave.shape[-2] for octave in whole[:3]), rows, rows // 2]
    for first, other in zip(whole[:3], cropped[:3], strict=True):
        torch.testing.assert_close(first, other)


def test_softness_counts_at_the_finest_octave_by_exemplar(app: SvbrdfStationary, tasks: Tasks) -> None:
    """0 of the exemplar itself; weighted, about ln 2 of one whose detail is half as strong."""
    exemplars = app.decoder.octaves.take_exemplar(tasks.data["image"][tasks.rows].float() / 255)
    batch = app.sample(tasks, Generator().manual_seed(0), 1)
    torch.testing.assert_close(app.judge.measure_softness(exemplars[:, None], batch), torch.zeros(3))
    half = 0.5 + (exemplars - 0.5) / 2
    ratio = (detail_statistics(exemplars) + NOISE_DISPLAY_VALUE) / (
        detail_statistics(exemplars) / 2 + NOISE_DISPLAY_VALUE
    )
    torch.testing.assert_close(
        app.judge.measure_softness(half[:, None], batch), SOFTNESS_WEIGHT * ratio.log().mean((1, 2))
    )
    mixed = torch.stack([exemplars[0], half[1], exemplars[2]])[:, None]
    assert (app.judge.measure_softness(mixed, batch) > 0.05).tolist() == [False, True, False]
    coarse = app.sample(app.coarsen(tasks, 0.0), Generator().manual_seed(0), 1)
    assert app.judge.measure_softness(half[:, None], coarse).tolist() == [0, 0, 0]


def test_coarsened_tasks_leave_out_all_of_the_finest_octave(app: SvbrdfStationary, tasks: Tasks) -> None:
    coarse = app.coarsen(tasks, SHARE - 0.01).data
    assert app.coarsen(tasks, SHARE) is tasks
    for name in app.judge.statistic_names:
        assert sorted(key for key in coarse if key.startswith(name)) == [f"{name}{i}" for i in range(3)]
        assert sorted(key for key in tasks.data if key.startswith(name)) == [f"{name}{i}" for i in range(5)]
    assert (app.decoder.octaves.find_octave(coarse), app.decoder.octaves.find_octave(tasks.data)) == (1, 0)


def test_a_coarse_loss_leaves_the_finest_level_alone(app: SvbrdfStationary, tasks: Tasks) -> None:
    rng = Generator().manual_seed(0)
    theta = {key: value.requires_grad_() for key, value in (app.init(rng, 3) | app.task_parameters(tasks)).items()}
    moved: list[set[str]] = []
    for done in (0.0, 0.9):
        loss = app.loss(theta, app.sample(app.coarsen(tasks, done), rng, 1), {})
        assert loss.shape == (3,)
        grads = torch.autograd.grad(loss.sum(), list(theta.values()), materialize_grads=True)
        moved.append({key.split(".")[0] for key, grad in zip(theta, grads, strict=True) if grad.any()})
    assert moved[0] == {"z", "join2", "draw2", "out2", "join1", "draw1", "out1"}
    assert moved[1] - moved[0] == {"join0", "draw0", "out0"}


def test_descents_go_from_coarse_to_fine(app: SvbrdfStationary, tasks: Tasks) -> None:
    rng, seen = Generator().manual_seed(0), []

    class Watched(ExemplarSight):
        def sample(self, tasks: Tasks, rng: Generator, count: int) -> dict[str, Tensor]:
            batch = super().sample(tasks, rng, count)
            seen.append(batch["noise"].shape[-1])
            return batch

    watched = replace(app, sight=Watched(**vars(app.sight)))
    theta, rule = watched.init(rng, 3) | app.task_parameters(tasks), sgd(dict.fromkeys(("rate",), torch.zeros(1)))
    learn(theta, rule, tasks, task_loss(watched, 1), steps=5, rng=rng)
    assert seen == [32, 32, 32, 64, 64]
    seen.clear()
    lifted = over_tasks(task_loss(watched, 1), count=2, augment=watched.augment)
    lifted.draw(tasks, rng, 0.0)
    lifted.draw(tasks, rng, 0.9)
    assert seen == [32, 64]


def test_relief_keeps_its_slopes(app: Any) -> None:
    """Half as many texels a side, half as many texels of height."""
    rng = Generator().manual_seed(0)
    theta = app.init(rng, 1)
    silent = theta | {key: torch.zeros_like(theta[key]) for key in ("out0.kernel", "out0.shift")}
    silent["quilt"] = torch.full((1, 3, 64, 64), 0.5)
    noise = torch.randn(1, 1, 8, 64, 64, generator=rng)
    small = avg_pool2d(noise[0], 2)[None] * 2
    height, low = app.decoder.generate(silent, noise).height, app.decoder.generate(silent, small, 1).height
    expected = 2 * enlarge_periodic(low[0])
    # slow changes, which are removed, are found a little differently in fewer texels
    assert float((height[0] - expected).square().mean().sqrt()) < 0.05 * float(expected.square().mean().sqrt())


# Quilts: pictures of pieces of exemplars


@pytest.fixture(scope="module")
def pavement(app: SvbrdfStationary) -> Tasks:
    """A pavement of stones of two colours, and one of noise."""
    at = torch.arange(64)
    stones = torch.where(((at[:, None] // 8 + at // 16) % 2).bool(), 200, 60).expand(3, -1, -1)
    noise = torch.randint(256, (3, 64, 64), generator=Generator().manual_seed(0))
    images = {"paved": stones.to(torch.uint8), "noise": noise.to(torch.uint8)}
    return stack_tasks(app, [Task(name, {"image": image}) for name, image in images.items()])


def test_quilts_are_known_of_each_task_and_no_step_changes_them(app: SvbrdfStationary, pavement: Tasks) -> None:
    quilt, places = pavement.data["quilt"], pavement.data["places"]
    assert (quilt.shape, places.shape) == ((2, 3, 64, 64), (2, 2, 64, 64))
    assert quilt[0].std() > 0.1
    rng = Generator().manual_seed(0)
    recipe = replace(recipes_of(app.name)["full"], app=app)
    theta = fit_tasks(make_method("overfit", app, recipe, MetaParameters(), steps=2), pavement, rng)
    encoded = app.encode(app.init_encoder(rng), app.encoder_input(pavement, rng))
    for parameters in (theta, encoded):
        assert torch.equal(parameters["quilt"], quilt)
        assert torch.equal(parameters["places"], places)


def test_tiles_move_with_noise_and_shrink_to_octaves(app: SvbrdfStationary, pavement: Tasks) -> None:
    rng, quilt = Generator().manual_seed(0), pavement.data["quilt"]
    for octave in (0, 1):
        moved = move_tiles(quilt, draw_noise(app, rng, 2, 2, octave=octave))
        small = avg_pool2d(quilt, 2**octave)
        side = small.shape[-1]
        assert moved.shape == (2, 2, 3, side, side)
        assert not torch.equal(moved[0, 0], moved[0, 1])
        rolls = [small[0].roll((y, x), (1, 2)) for y in range(side) for x in range(side)]
        assert any(torch.equal(roll, moved[0, 1]) for roll in rolls)


def test_coarsened_tasks_train_by_quilts_of_augmented_exemplars(app: SvbrdfStationary, pavement: Tasks) -> None:
    rng = Generator().manual_seed(0)
    for done in (0.0, 0.9):
        variants = app.augment(app.coarsen(pavement, done), rng)
        theta = app.encode(app.init_encoder(rng), app.encoder_input(variants, rng))
        assert app.outer_loss(theta, app.outer_sample(variants, rng, 1), {}).isfinite().all()


def test_networks_read_quilts_without_mean_and_of_one_contrast(pavement: Tasks) -> None:
    quilts = pavement.data["quilt"][:, None]
    normalised = normalise_quilts(quilts)
    torch.testing.assert_close(normalised.mean((-1, -2)), torch.zeros(2, 1, 3), atol=1e-5, rtol=0)
    torch.testing.assert_close(normalise_quilts(0.3 + 0.5 * quilts), normalised)


def test_generated_pictures_follow_their_quilt(app: SvbrdfStationary, pavement: Tasks) -> None:
    """The network reads it, and the loss counts how far pictures are from it."""
    rng = Generator().manual_seed(0)
    noise = draw_noise(app, rng, 2, 1)
    theta = app.init(rng, 2) | app.task_parameters(pavement)
    other = theta | {"quilt": theta["quilt"].flip(0)}
    assert not torch.equal(*(app.decoder.generate(fit, noise).prediction.roughness for fit in (theta, other)))
    quilts = move_tiles(theta["quilt"], noise)
    assert quilt_deviation(quilts, quilts).abs().max() == 0
    assert quilt_deviation(torch.full_like(quilts, 0.5), quilts)[0] > 0.05
