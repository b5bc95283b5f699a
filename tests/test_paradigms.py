"""What every application and paradigm promises, on tasks small enough to make here."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any, NamedTuple

import pytest
import torch
from torch import Generator

from data_tools.brdf_task import brdf_task
from data_tools.svbrdf_task import svbrdf_task
from data_tools.synthetic_brdf import synthetic_materials
from metapp.apps import app_names, illumination, load_app, svbrdf_nonstationary, transport
from metapp.apps.transport.flow import Flow
from metapp.exemplar import Setup
from metapp.flash import Maps, normal_from_height, pack
from metapp.latlong import directions, mean_luminance
from metapp.learning import MetaParameters, learn, task_loss
from metapp.networks import LocalField, UNet
from metapp.paradigms import Job, Paradigm, paradigms, prepare
from metapp.paradigms.prepare import Interrupted, Prepared, split_validation, tune_quickft, validation_error
from metapp.paradigms.quickft import adam_of, to_alpha
from metapp.photograph import photograph
from metapp.rules import RULES, fixed_adam
from metapp.task import Adam, App, Batch, Params, Recipe, Task, Tasks, Training, stack

COUNT = 12
# rules that differ in more than the start that recipes give them
UNLIKE = sorted({rule: name for name, rule in reversed(RULES.items())}.values())


class Small(NamedTuple):
    """What makes an application small enough for its contract: other settings than the quick recipe's, and tasks."""

    tasks: Callable[[], list[Task]]
    setup: Any = None


def brdf_tasks() -> list[Task]:
    return [brdf_task(each.name, each.evaluate, samples=512) for each in synthetic_materials("train", COUNT)]


def picture_tasks() -> list[Task]:
    """Pictures of 32 px in small patches, dark green and bright red ones, that fade towards the edges."""
    generator, tasks = rng(7), []
    away = torch.linspace(-1, 1, 32).square()
    colours = torch.tensor([[0.1, 0.3, 0.2], [0.8, 0.5, 0.3]])[..., None, None]
    for i in range(COUNT):
        size = 2 + 2 * (i % 2)
        which = torch.rand(1, 32 // size, 32 // size, generator=generator) < 0.3 + 0.4 * i / COUNT
        dark, bright = colours + 0.1 * torch.rand(2, 3, 1, 1, generator=generator)
        image = torch.where(which.repeat_interleave(size, 1).repeat_interleave(size, 2), bright, dark)
        image = image / (1 + 0.3 * (away[:, None] + away))
        tasks.append(Task(f"patches-{i}", {"image": (255 * image).to(torch.uint8)}))
    return tasks


def map_tasks() -> list[Task]:
    """Maps of one lamp each, all around, and a photograph."""
    generator, towards, tasks = rng(7), directions(16, 32), []
    for i in range(COUNT):
        lamp = torch.nn.functional.normalize(torch.randn(3, generator=generator), dim=0)
        colour = 0.3 + torch.rand(3, 1, 1, generator=generator)
        light = 0.3 + colour * (6 * (torch.einsum("c,chw->hw", lamp, towards) - 0.6)).exp()
        light = light / mean_luminance(light)
        photos = (photograph(light[None], generator) * 255).round().to(torch.uint8)
        tasks.append(Task(f"lamp-{i}", {"map": light, "scale": torch.tensor(2.0), "photos": photos}))
    return tasks


def material_tasks() -> list[Task]:
    """Smooth materials of two colours each, and how they look under a flash."""
    generator, tasks = rng(7), []
    for i in range(COUNT):
        coarse = torch.rand(1, 8, 3, 3, generator=generator)
        smooth = torch.nn.functional.interpolate(coarse, (16, 16), mode="bilinear")[0]
        normal = normal_from_height(3 * smooth[:1])
        maps = Maps(0.8 * smooth[1:4], 0.1 + 0.4 * smooth[4:7], 0.2 + 0.6 * smooth[7:], normal)
        tasks.append(svbrdf_task(f"material-{i}", pack(maps)))
    return tasks


def path_tasks() -> list[Task]:
    """Samples of which half are on a lamp, and others come from where it is, and a picture of 8 px."""
    generator, tasks = rng(7), []
    for i in range(COUNT):
        lamp = 0.2 + 0.6 * torch.rand(2, generator=generator)
        samples = torch.rand(2048, 4, generator=generator)
        samples[:1024, :2] = lamp + 0.1 * (samples[:1024, :2] - 0.5)
        samples[1024:, 2:] = 0.5 + 0.5 * (lamp - samples[1024:, :2]) + 0.1 * (samples[1024:, 2:] - 0.5)
        samples = samples.clamp(0, 0.999)[torch.randperm(2048, generator=generator)]
        row, column = ((8 * samples[:, k]).long() for k in (1, 0))
        image = torch.bincount(8 * row + column, minlength=64).reshape(1, 8, 8).expand(3, -1, -1) / 32
        tasks.append(Task(f"room-{i}", {"samples": samples[:1536], "held": samples[1536:], "image": image.clone()}))
    return tasks


def small_setup(outputs: int) -> Setup:
    return Setup(16, 16, UNet(4, levels=2, noise=2, code=4, outputs=outputs), "vgg16", ("relu1_1",))


SMALL: dict[str, Small] = {
    "brdf": Small(brdf_tasks),
    "illumination": Small(
        map_tasks, illumination.Setup(LocalField(8, 16, rows=4, columns=8, code=3, hidden=8, layers=2))
    ),
    "svbrdf_nonstationary": Small(
        material_tasks,
        svbrdf_nonstationary.Setup(svbrdf_nonstationary.field_of(16, hidden=8)._replace(code=3), width=2),
    ),
    "svbrdf_stationary": Small(picture_tasks, small_setup(6)),
    "texture": Small(picture_tasks, small_setup(3)),
    "transport": Small(
        path_tasks,
        transport.Setup(Flow(rows=4, columns=4, code=3, hidden=8, bins=4, film_bins=8, blobs=6)),
    ),
}


@pytest.fixture(autouse=True)
def eager(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiling takes longer than these tests."""
    monkeypatch.setattr(prepare, "can_compile", lambda: False)


def small_recipe(app: App) -> Recipe:
    """The quick recipe, with few samples, tasks and steps, and every rule."""
    recipe = app.recipes["quick"]

    def short(training: Training) -> Training:
        rates = training.rates if training.steps else {"": 1e-4, "alpha.out.": 0.0, "alpha.in.": 0.0}
        return replace(training, steps=12, tasks=3, warmup=0, validate_every=4, rates=rates, tuned=False)

    return replace(
        recipe,
        steps=3,
        batch=min(64, recipe.batch),
        overfit_steps=60,
        finetune_steps=20,
        general=short(recipe.general),
        meta={rule: short(recipe.meta.get(rule, recipe.meta[recipe.rule])) for rule in RULES},
        setup=SMALL[app.name].setup or recipe.setup,
    )


@pytest.fixture(scope="module", params=app_names())
def app(request: pytest.FixtureRequest) -> App:
    app = load_app(request.param)
    assert app.name in SMALL, f"{app.name}: no small tasks for its contract; add a line to SMALL."
    return app.at(small_recipe(app))


@pytest.fixture(scope="module")
def sources(app: App) -> list[Task]:
    """What tasks are before an application prepares them."""
    return SMALL[app.name].tasks()


@pytest.fixture(scope="module")
def tasks(app: App, sources: list[Task]) -> Tasks:
    return stack(app, sources)


@pytest.fixture(autouse=True)
def judged(request: pytest.FixtureRequest) -> None:
    """What errors of an application need beside its tasks."""
    if "app" in request.fixturenames and request.getfixturevalue("app").name == "illumination":
        request.getfixturevalue("scene")


@pytest.fixture
def job(app: App) -> Job:
    recipe = small_recipe(app)
    return Job(app, recipe, recipe.rule)


def rng(seed: int = 0) -> Generator:
    return Generator().manual_seed(seed)


def untrained(job: Job) -> MetaParameters:
    """A start for every paradigm: a random encoder, a random theta_0 and its rule's initial quantities."""
    theta = {key: value[0] for key, value in job.app.init(rng(1), 1).items()}
    alpha = RULES[job.rule].alpha(job.app, theta, job.recipe.steps, Adam(5e-3, beta2=0.99))
    return MetaParameters(theta, alpha, job.app.init_encoder(rng(2)))


def start_for(paradigm: Paradigm, job: Job) -> MetaParameters:
    """What its preparation would leave, untrained."""
    start = untrained(job)
    return start._replace(encoder={}) if paradigm.name == "meta" else MetaParameters(encoder=start.encoder)


# Fitting


@pytest.mark.parametrize("name", list(paradigms()))
def test_a_paradigm_fits(name: str, job: Job, tasks: Tasks) -> None:
    """Parameters of the same network, detached, finite, the same for the same seed; errors for every task."""
    paradigm, few = paradigms()[name], tasks.select([0, 5, 2])
    prepared = start_for(paradigm, job)
    theta = paradigm.fit(job, prepared, few, rng())
    template = job.app.init(rng(), 3)
    assert {key: value.shape for key, value in theta.items()} == {key: value.shape for key, value in template.items()}
    assert {value.dtype for value in theta.values()} == {torch.float32}
    assert not any(value.requires_grad for value in theta.values())
    again = paradigm.fit(job, prepared, few, rng())
    assert all(torch.equal(theta[key], again[key]) for key in theta)
    other = paradigm.fit(job, prepared, few, rng(9))
    # without steps nothing need be random: an encoder may look at all there is
    if name == "overfit" or (paradigm.count(job) and job.app.random):
        assert not all(torch.equal(theta[key], other[key]) for key in theta)
    elif not job.app.random:
        assert all(torch.equal(theta[key], other[key]) for key in theta)
    errors = job.app.errors(theta, few)
    assert {tuple(value.shape) for value in errors.values()} == {(3,)}
    assert torch.isfinite(errors["error"]).all()


def test_the_five_paradigms(job: Job) -> None:
    table = paradigms()
    assert list(table) == ["general", "overfit", "finetune", "quickft", "meta"]
    assert {name: paradigm.needs(job) for name, paradigm in table.items()} == {
        "general": "general",
        "overfit": None,
        "finetune": "general",
        "quickft": "general",
        "meta": job.rule,
    }
    recipe = job.recipe
    expected = {"general": 0, "overfit": 60, "finetune": 20, "quickft": recipe.steps, "meta": recipe.steps}
    assert {name: paradigm.count(job) for name, paradigm in table.items()} == expected
    assert {paradigm.count(job._replace(steps=7)) for paradigm in table.values()} == {7}


@pytest.mark.parametrize("rule", UNLIKE)
def test_meta_fits_by_every_rule(rule: str, job: Job, tasks: Tasks) -> None:
    job = job._replace(rule=rule)
    start = start_for(paradigms()["meta"], job)
    theta = paradigms()["meta"].fit(job, start, tasks.select([0, 1]), rng())
    assert all(torch.isfinite(value).all() for value in theta.values())
    assert not all(torch.equal(value[0], start.theta[key]) for key, value in theta.items())
    longer = paradigms()["meta"].fit(job._replace(steps=job.recipe.steps + 2), start, tasks, rng())
    assert all(torch.isfinite(value).all() for value in longer.values())


def test_overfit_learns(job: Job, tasks: Tasks) -> None:
    few, job = tasks.select([0, 1, 2, 3]), job._replace(steps=300)
    before = job.app.errors(job.app.init(rng(), 4), few)["error"]
    after = job.app.errors(paradigms()["overfit"].fit(job, MetaParameters(), few, rng()), few)["error"]
    assert (after < 0.7 * before).all()
    assert after.mean() < 0.5 * before.mean()


@pytest.mark.parametrize("name", ["quickft", "finetune"])
def test_no_steps_from_general_is_general(name: str, job: Job, tasks: Tasks) -> None:
    prepared = start_for(paradigms()[name], job)
    general = paradigms()["general"].fit(job, prepared, tasks, rng())
    for key, value in paradigms()[name].fit(job._replace(steps=0), prepared, tasks, rng()).items():
        assert torch.equal(value, general[key])


def test_meta_starts_all_tasks_alike(job: Job, tasks: Tasks) -> None:
    start = start_for(paradigms()["meta"], job)
    theta = paradigms()["meta"].fit(job._replace(steps=0), start, tasks, rng())
    for key, value in start.theta.items():
        assert torch.equal(theta[key], value.expand(len(tasks), *value.shape))


def test_meta_with_an_encoder_starts_where_general_ends(job: Job, tasks: Tasks) -> None:
    start = untrained(job)._replace(theta={})
    theta = paradigms()["meta"].fit(job._replace(steps=0), start, tasks, rng())
    general = paradigms()["general"].fit(job, start, tasks, rng())
    assert all(torch.equal(theta[key], value) for key, value in general.items())
    moved = paradigms()["meta"].fit(job, start, tasks, rng())
    assert all(value.isfinite().all() for value in moved.values())
    assert not all(torch.equal(moved[key], value) for key, value in general.items())


@pytest.mark.parametrize("name", ["finetune", "quickft", "meta"])
def test_a_fit_is_learn_and_nothing_else(name: str, job: Job, tasks: Tasks) -> None:
    paradigm = paradigms()[name]
    prepared, generator = start_for(paradigm, job), rng()
    theta = paradigm.start(job, prepared, tasks, generator)
    rule, steps = paradigm.rule(job, prepared, theta, paradigm.count(job)), paradigm.count(job)
    expected = learn(theta, rule, tasks, task_loss(job.app, job.recipe.batch), steps=steps, rng=generator)
    for key, value in paradigm.fit(job, prepared, tasks, rng()).items():
        assert torch.equal(value, expected[key])


def test_quickft_takes_the_tuned_adam(job: Job, tasks: Tasks) -> None:
    settings = Adam(0.02, 0.7, 0.9, 1e-6, 0.1)
    prepared = start_for(paradigms()["quickft"], job)._replace(alpha=to_alpha(settings))
    theta, steps = paradigms()["general"].fit(job, prepared, tasks, rng()), job.recipe.steps
    tuned = paradigms()["quickft"].rule(job, prepared, theta, steps)
    for key, value in fixed_adam(settings, theta, steps).alpha.items():
        torch.testing.assert_close(tuned.alpha[key], value)


# What an application makes of tasks


@pytest.fixture
def fitted(job: Job, tasks: Tasks) -> Params:
    """The parameters of the first task after a few steps, as a run keeps them: without a task axis."""
    theta = paradigms()["overfit"].fit(job._replace(steps=3), MetaParameters(), tasks.select([0]), rng())
    return {key: value[0] for key, value in theta.items()}


def test_pictures_of_a_fit_and_of_its_reference(app: App, fitted: Params, sources: list[Task]) -> None:
    pictures = app.outputs(fitted, sources[0])
    assert list(pictures)[:2] == ["reference", "fit"]
    assert pictures["fit"].shape == pictures["reference"].shape
    for name, picture in pictures.items():
        assert picture.ndim == 3, name
        assert picture.shape[2] in (3, 4), name
        assert picture.dtype == torch.float32, name
        assert picture.isfinite().all(), name
        assert not picture.requires_grad, name
    again = app.outputs(fitted, sources[0])
    assert all(torch.equal(again[name], picture) for name, picture in pictures.items())
    other = app.outputs(fitted, sources[1])
    assert not torch.equal(other["reference"], pictures["reference"])


def test_files_are_display_values(app: App, fitted: Params, sources: list[Task]) -> None:
    made = app.files(fitted, sources[0])
    for name, picture in made.items():
        assert name.replace("_", "").isalnum(), name
        assert picture.ndim == 3, name
        assert picture.shape[2] in (1, 3), name
        assert picture.isfinite().all(), name
        assert 0 <= float(picture.min()) <= float(picture.max()) <= (math.inf if name in app.radiance else 1), name
        assert not picture.requires_grad, name
    again = app.files(fitted, sources[0])
    assert all(torch.equal(again[name], picture) for name, picture in made.items())


def shapes(batch: Batch) -> dict[str, Any]:
    return {key: (value.shape, value.dtype) for key, value in batch.items()}


def test_made_up_tasks_do_what_tasks_do(job: Job, tasks: Tasks) -> None:
    """As many, with names that say so, for the same network: samples and observations of the same shapes."""
    app, few = job.app, tasks.select([4, 1, 7])
    made = app.augment(few, rng())
    assert len(made) == len(made.names) == 3
    assert not set(made.names) & set(tasks.names)
    drawn = app.sample(made, rng(), job.recipe.batch)
    assert shapes(drawn) == shapes(app.sample(few, rng(), job.recipe.batch))
    assert shapes(app.observe(made, rng())) == shapes(app.observe(few, rng()))
    theta = app.encode(app.init_encoder(rng()), app.observe(made, rng()))
    assert app.loss(theta, drawn, {}).shape == (3,)
    assert app.loss(theta, drawn, {}).isfinite().all()
    again, other = app.augment(few, rng()), app.augment(few, rng(1))
    assert all(torch.equal(again.data[key], value) for key, value in made.data.items())
    assert not all(torch.equal(other.data[key], value) for key, value in made.data.items())


def test_made_up_tasks_leave_the_tasks_alone(app: App, tasks: Tasks) -> None:
    before = {key: value.clone() for key, value in tasks.data.items()}
    app.augment(tasks, rng())
    assert all(torch.equal(tasks.data[key], value) for key, value in before.items())


def test_tasks_beside_each_other_are_independent(job: Job, tasks: Tasks) -> None:
    """The loss and the errors of a task are the same, whatever is fitted beside it."""
    app, few = job.app, tasks.select([3, 0])
    theta, batch = app.init(rng(), 2), app.sample(few, rng(), 2)
    together = app.loss(theta, batch, {})
    for i in (0, 1):
        own = {key: value[i : i + 1] for key, value in theta.items()}
        alone = app.loss(own, {key: value[i : i + 1] for key, value in batch.items()}, {})
        torch.testing.assert_close(alone, together[i : i + 1])
        for key, value in app.errors(theta, few).items():
            torch.testing.assert_close(app.errors(own, few.select([i]))[key], value[i : i + 1])


def test_a_recipe_is_no_part_of_the_application(app: App) -> None:
    """Its recipes stay what they are at any setup, and what errors depend on is said."""
    recipes = load_app(app.name).recipes
    assert {"paper", "quick"} <= set(recipes)
    for recipe in recipes.values():
        again = load_app(app.name).at(recipe)
        assert (again.name, again.recipes) == (app.name, recipes)
        assert recipe.rule in recipe.meta
        assert all(isinstance(value, str) and value for value in again.conditions().values())


# Preparing


def test_split_keeps_tasks_apart(tasks: Tasks) -> None:
    fit, validate = split_validation(tasks)
    names = tasks.picked_names()
    assert set(validate.picked_names()) == set(sorted(names)[3::8])
    assert fit.picked_names() == tuple(name for name in names if name not in validate.picked_names())
    with pytest.raises(ValueError, match="training set: 3 tasks that show 3 things, expected at least 4"):
        split_validation(tasks.select([0, 1, 2]))


def test_split_keeps_photos_of_one_thing_together() -> None:
    """Whatever their order; and sorting spreads the validation tasks over families that take turns."""
    names = tuple(f"{i:02d}-{photo}" for photo in range(3) for i in range(12))
    groups = tuple(name.split("-")[0] for name in names)
    fit, validate = split_validation(Tasks(names, {}, torch.arange(36), groups))
    assert {name.split("-")[0] for name in validate.picked_names()} == {"03", "11"}
    assert (len(fit), len(validate)) == (30, 6)
    turns = tuple(f"{'abcd'[i % 4]}-{i:02d}" for i in range(64))
    _, validate = split_validation(Tasks(turns, {}, torch.arange(64)))
    assert {name[0] for name in validate.picked_names()} == set("abcd")


def look(name: str, job: Job, tasks: Tasks, **options: Any) -> Prepared:
    return prepare.prepare(name, job if name == "general" else job._replace(rule=name), tasks, rng(3), **options)


def error_of(name: str, job: Job, start: MetaParameters, tasks: Tasks) -> float:
    job = job if name == "general" else job._replace(rule=name)
    return validation_error(paradigms()["general" if name == "general" else "meta"], job, start, tasks)


@pytest.mark.parametrize("name", ["general", *UNLIKE])
def test_the_best_state_is_kept(name: str, job: Job, tasks: Tasks) -> None:
    prepared = look(name, job, tasks)
    steps, losses, errors = zip(*prepared.curve, strict=True)
    assert steps == (0, 4, 8, 12)
    assert prepared.validation == min(errors) <= errors[0]
    assert steps[errors.index(min(errors))] == prepared.step
    assert losses[0] is None
    assert all(loss is not None and math.isfinite(loss) for loss in losses[1:])
    validation = split_validation(tasks)[1]
    assert math.isclose(error_of(name, job, prepared.start, validation), prepared.validation, rel_tol=1e-6)
    again = look(name, job, tasks)
    assert again.curve[1:] == prepared.curve[1:]
    assert all(torch.equal(again.start.flat()[key], value) for key, value in prepared.start.flat().items())


@pytest.mark.parametrize("name", ["general", *UNLIKE])
def test_a_start_that_only_gets_worse_is_kept(
    name: str, job: Job, tasks: Tasks, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Iteration 0 is among the states to choose from, and it is not written to afterwards."""
    before, errors = look(name, job, tasks, steps=0), itertools.count(1)
    monkeypatch.setattr(prepare, "validation_error", lambda *_: float(next(errors)))
    prepared = look(name, job, tasks)
    assert (prepared.step, prepared.validation) == (0, 1.0)
    assert [error for _, _, error in prepared.curve] == [1.0, 2.0, 3.0, 4.0]
    assert all(torch.equal(prepared.start.flat()[key], value) for key, value in before.start.flat().items())


def test_general_learns(job: Job, tasks: Tasks) -> None:
    """Preparing it improves what it is prepared for."""
    training = replace(job.recipe.general, steps=100, rates={"": 1e-3}, validate_every=25)
    prepared = look("general", job._replace(recipe=replace(job.recipe, general=training)), tasks)
    assert prepared.validation < 0.9 * prepared.curve[0][2]


def test_meta_learns(job: Job, tasks: Tasks) -> None:
    training = replace(job.recipe.meta["meta-adam"], steps=60, rates={"": 3e-3}, validate_every=20)
    recipe = replace(job.recipe, meta={"meta-adam": training})
    prepared = look("meta-adam", job._replace(recipe=recipe), tasks)
    assert prepared.validation < 0.9 * prepared.curve[0][2]


def starting_from(start: str, job: Job) -> Job:
    rule = job.recipe.rule
    return job._replace(recipe=replace(job.recipe, meta={rule: replace(job.recipe.meta[rule], start=start)}))


def test_meta_starts_from_the_mean_of_general(job: Job, tasks: Tasks) -> None:
    encoder, rule = start_for(paradigms()["general"], job), job.recipe.rule
    prepared = look(rule, starting_from("mean", job), tasks, encoder=encoder, steps=0)
    assert not prepared.start.encoder
    predicted = paradigms()["general"].fit(job, encoder, split_validation(tasks)[0], rng(3))
    for key, value in predicted.items():
        torch.testing.assert_close(prepared.start.theta[key], value.mean(0))


def test_meta_starts_at_random(job: Job, tasks: Tasks) -> None:
    """Where it is told to, and where there is no General."""
    encoder, rule = start_for(paradigms()["general"], job), job.recipe.rule
    told = look(rule, starting_from("random", job), tasks, encoder=encoder, steps=0).start
    alone = look(rule, starting_from("mean", job), tasks, steps=0).start
    expected = {key: value[0] for key, value in job.app.init(rng(3), 1).items()}
    for start in (told, alone):
        assert not start.encoder
        assert all(torch.equal(start.theta[key], value) for key, value in expected.items())


def test_meta_goes_on_from_general(job: Job, tasks: Tasks) -> None:
    """The encoder itself is then trained through the steps, beside the rule, and another start there is none."""
    encoder, rule = start_for(paradigms()["general"], job), job.recipe.rule
    job = starting_from("encoder", job)
    first = look(rule, job, tasks, encoder=encoder, steps=0).start
    assert not first.theta
    assert all(torch.equal(first.encoder[key], value) for key, value in encoder.encoder.items())
    training = replace(job.recipe.meta[rule], steps=20, rates={"": 1e-3}, validate_every=5)
    job = job._replace(recipe=replace(job.recipe, meta={rule: training}))
    prepared = look(rule, job, tasks, encoder=encoder)
    assert prepared.step > 0
    assert prepared.validation < prepared.curve[0][2]
    assert not prepared.start.theta
    assert not all(torch.equal(prepared.start.encoder[key], value) for key, value in encoder.encoder.items())
    assert not all(torch.equal(prepared.start.alpha[key], value) for key, value in first.alpha.items())
    validation = split_validation(tasks)[1]
    assert math.isclose(error_of(rule, job, prepared.start, validation), prepared.validation, rel_tol=1e-6)


@pytest.mark.parametrize("name", ["general", "meta-sgd"])
def test_training_never_sees_a_validation_task(
    name: str, job: Job, tasks: Tasks, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the data of the validation tasks spoilt, the training loss stays finite."""
    rows = split_validation(tasks)[1].rows
    spoilt = {}
    for key, value in tasks.data.items():
        own = value.stride(0) != 0  # what all tasks share is no task's
        spoilt[key] = value.float().index_fill(0, rows, math.nan) if own else value
    monkeypatch.setattr(prepare, "validation_error", lambda *_: 1.0)
    prepared = look(name, job, Tasks(tasks.names, spoilt, tasks.rows), steps=30)
    assert all(loss is not None and math.isfinite(loss) for _, loss, _ in prepared.curve[1:])


@pytest.mark.parametrize("name", ["general", "meta-sgd"])
def test_interrupted_carries_the_best_state(name: str, job: Job, tasks: Tasks) -> None:
    whole = look(name, job, tasks)

    def stop(step: int, steps: int, note: str) -> None:
        assert steps == 12
        if step >= 8:
            raise KeyboardInterrupt

    with pytest.raises(Interrupted) as caught:
        look(name, job, tasks, report=stop)
    best = caught.value.prepared
    assert best.curve[1:] == whole.curve[1:3]
    assert best.validation == min(error for _, _, error in whole.curve[:3])
    assert best.step in (0, 4, 8)
    validation = split_validation(tasks)[1]
    assert math.isclose(error_of(name, job, best.start, validation), best.validation, rel_tol=1e-6)


def test_interrupted_at_the_last_look(job: Job, tasks: Tasks) -> None:
    def stop(step: int, steps: int, note: str) -> None:
        if step == steps:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as caught:
        look("general", job, tasks, report=stop)
    assert isinstance(caught.value, Interrupted)
    assert math.isfinite(caught.value.prepared.validation)


def test_tuned_quickft_is_no_worse_than_the_recipe(job: Job, tasks: Tasks, monkeypatch: pytest.MonkeyPatch) -> None:
    """On the tasks it was tuned on; a strawman is no baseline."""
    job = job._replace(steps=2)
    rates = [{"rate": 2.0**i} for i in (-4, -2, -1, 1, 2, 4)]
    monkeypatch.setattr(prepare, "SEARCHED", (rates, [{"beta1": 0.5}, {"eps": 1e-3, "rate": 1.2}]))
    encoder, validation = start_for(paradigms()["quickft"], job), split_validation(tasks)[1]
    plain = validation_error(paradigms()["quickft"], job, encoder, validation)
    tuned = tune_quickft(job, encoder, validation)
    assert tuned.validation <= plain
    assert math.isclose(validation_error(paradigms()["quickft"], job, tuned.start, validation), tuned.validation)
    assert set(tuned.start.alpha) == set(asdict(Adam(0.0)))
    assert tuned.start.encoder is encoder.encoder
    errors = [error for _, _, error in tuned.curve]
    assert errors == sorted(errors, reverse=True)


def test_interrupted_tuning_carries_the_best_so_far(job: Job, tasks: Tasks) -> None:
    def stop(step: int, steps: int, note: str) -> None:
        if step == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as caught:
        look("quickft", job, tasks, encoder=start_for(paradigms()["quickft"], job), report=stop)
    assert isinstance(caught.value, Interrupted)
    assert math.isfinite(caught.value.prepared.validation)


def test_a_preparation_says_how_it_came_about(job: Job, tasks: Tasks) -> None:
    prepared = look("general", job, tasks, steps=4)
    said = prepare.describe(job, "general", prepared)
    assert said["app"] == job.app.name
    assert said["start"] == "general"
    assert said["validation_error"] == prepared.validation
    assert said["best_step"] == prepared.step
    assert said["training"] == asdict(job.recipe.general)


# The search of QuickFT's Adam, on errors in closed form


BEST = Adam(rate=0.05, beta1=0.5, beta2=0.97, eps=1e-4, final=0.1)


def bowl(adam: Adam) -> float:
    """0 at BEST, and rising with the distance from it in each quantity."""
    away = [
        math.log(adam.rate / BEST.rate),
        3 * (adam.beta1 - BEST.beta1),
        10 * (adam.beta2 - BEST.beta2),
        math.log(adam.eps / BEST.eps) / 10,
        adam.final - BEST.final,
    ]
    return sum(each * each for each in away)


class Search(NamedTuple):
    """What a search looked at and what it found."""

    looked: list[Adam]
    job: Job
    run: Callable[..., Prepared]


@pytest.fixture
def search(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Search]:
    """A search that starts at an Adam and that is told errors in closed form."""

    def make(first: Adam, error: Callable[[Adam], float] = bowl) -> Search:
        app = load_app("brdf")
        job = Job(app, replace(app.recipes["quick"], quickft=first), "meta-sgd")
        looked: list[Adam] = []

        def told(paradigm: Paradigm, job: Job, prepared: MetaParameters, tasks: Any, seeds: int = 2) -> float:
            assert paradigm.name == "quickft"
            looked.append(adam_of(job, prepared))
            return error(looked[-1])

        monkeypatch.setattr(prepare, "validation_error", told)
        encoder = MetaParameters(encoder={"w": torch.ones(2)})
        return Search(looked, job, lambda **options: tune_quickft(job, encoder, None, **options))  # type: ignore[arg-type]

    return make


@pytest.mark.parametrize(
    "first", [Adam(1e-2), Adam(5e-2, 0.9, 0.99, 1e-8, 0.0), Adam(1.0, 0.3, 0.8), Adam(2e-3, 0.9, 0.999, 1e-3)]
)
def test_the_search_finds_the_best_adam(first: Adam, search: Callable[..., Search]) -> None:
    """Also from a rate that is 25 times too small or 20 times too large; the rate to a third of its grid's step."""
    tuned = search(first).run()
    found = adam_of(search(first).job, tuned.start)
    assert (found.beta1, found.beta2, found.final) == (BEST.beta1, BEST.beta2, BEST.final)
    assert found.eps == pytest.approx(BEST.eps)
    assert abs(math.log2(found.rate / BEST.rate)) < 1 / 6
    assert tuned.validation == pytest.approx(bowl(found))


def test_the_search_goes_on_around_the_best_so_far(search: Callable[..., Search]) -> None:
    """One line of choices at a time changes its own quantities, and those before it stay at their best."""
    first = Adam(0.05, 0.9, 0.999, 1e-8, 1.0)
    searching = search(first)
    reported: list[tuple[int, int]] = []
    tuned = searching.run(report=lambda step, steps, note: reported.append((step, steps)))
    looked, lines = searching.looked, [len(line) for line in prepare.SEARCHED]
    assert looked[0] == first
    assert len(looked) == 1 + sum(lines)
    assert reported == [(i + 1, len(looked)) for i in range(len(looked))]
    assert {(each.beta1, each.beta2, each.eps, each.final) for each in looked[1 : 1 + lines[0]]} == {
        (0.9, 0.999, 1e-8, 1.0)
    }
    assert all((each.beta1, each.beta2) == (BEST.beta1, BEST.beta2) for each in looked[1 + sum(lines[:2]) : sum(lines)])
    best = min(looked, key=bowl)
    assert adam_of(searching.job, tuned.start) == best
    assert looked[tuned.step - 1] == best
    errors = [error for _, _, error in tuned.curve]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] == tuned.validation == bowl(best)
    assert [looked[step - 1] for step, _, _ in tuned.curve][-1] == best


def test_a_recipe_that_nothing_beats_is_kept(search: Callable[..., Search]) -> None:
    first = Adam(0.0123, 0.77, 0.95, 3e-5, 0.2)
    for error in (lambda adam: 1.0, lambda adam: 0.5 if adam == first else math.inf):
        tuned = search(first, error).run()
        assert adam_of(search(first, error).job, tuned.start) == first
        assert (tuned.step, len(tuned.curve)) == (1, 1)


def test_a_recipe_that_diverges_is_left(search: Callable[..., Search]) -> None:
    tuned = search(Adam(10.0), lambda adam: bowl(adam) if adam.rate < 3 else math.inf).run()
    assert math.isfinite(tuned.validation)
    assert adam_of(search(Adam(10.0)).job, tuned.start).rate < 3


@pytest.mark.parametrize("looks", [1, 7, 60])
def test_an_interrupted_search_carries_the_best_so_far(looks: int, search: Callable[..., Search]) -> None:
    searching = search(Adam(1e-2))

    def stop(step: int, steps: int, note: str) -> None:
        if step == looks:
            raise KeyboardInterrupt

    with pytest.raises(Interrupted) as caught:
        searching.run(report=stop)
    assert len(searching.looked) == looks
    best = caught.value.prepared
    assert best.validation == min(bowl(each) for each in searching.looked)
    assert adam_of(searching.job, best.start) == min(searching.looked, key=bowl)
    assert best.start.encoder


@pytest.mark.parametrize("steps", [5, 30])
def test_a_mean_is_over_the_last_of_the_steps_there_are(steps: int, job: Job, tasks: Tasks) -> None:
    """A rule that was prepared for fewer or more steps takes no other mean than one prepared for these."""
    if job.app.name != "texture":
        pytest.skip("one application will do")
    job = job._replace(rule="meta-mean")
    single = {key: value[0] for key, value in job.app.init(rng(), 1).items()}
    fits = []
    for prepared_for in (15, steps):
        alpha = RULES["meta-mean"].alpha(job.app, single, prepared_for, Adam(1e-3))
        start = MetaParameters(single, alpha)
        fits.append(paradigms()["meta"].fit(job._replace(steps=steps), start, tasks.select([0]), rng()))
    for key, value in fits[0].items():
        torch.testing.assert_close(value, fits[1][key])


@pytest.mark.parametrize(("name", "count"), [("brdf", 30), ("texture", 8), ("svbrdf_stationary", 8)])
def test_searches_look_at_all_validation_tasks_where_fits_are_cheap(
    name: str, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    app = load_app(name)
    job = Job(app, app.recipes["quick"], app.recipes["quick"].rule)
    names = tuple(f"{i:03d}" for i in range(240))
    looked: list[int] = []

    def told(paradigm: Paradigm, job: Job, prepared: MetaParameters, tasks: Tasks, seeds: int = 2) -> float:
        looked.append(len(tasks))
        return 1.0

    monkeypatch.setattr(prepare, "validation_error", told)
    encoder = MetaParameters(encoder={"w": torch.ones(2)})
    prepare.prepare("quickft", job, Tasks(names, {}, torch.arange(240)), rng(), encoder=encoder, steps=3)
    assert looked == [count] * 3


@pytest.mark.parametrize("looks", [1, 4, 11, 30])
def test_a_search_takes_no_more_looks_than_told(looks: int, search: Callable[..., Search]) -> None:
    searching = search(Adam(1e-2))
    tuned = searching.run(looks=looks)
    assert len(searching.looked) == looks
    assert tuned.validation == min(bowl(each) for each in searching.looked)


@pytest.mark.parametrize("outer", [0, 2])
@pytest.mark.parametrize("rule", ["meta-mean", "meta-basis"])
def test_a_rule_is_tuned_as_quickft_is(
    rule: str, outer: int, job: Job, tasks: Tasks, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its Adam is searched on validation tasks, in the bases of the training tasks; outer steps go on from there."""
    if job.app.name != "texture":
        pytest.skip("one application will do")
    monkeypatch.setattr(prepare, "SEARCHED", ([{"rate": 0.5}, {"rate": 2.0}], [{"beta1": 0.3, "rate": 1.0}]))
    training = replace(job.recipe.meta[rule], start="encoder", tuned=True, steps=outer)
    job = job._replace(rule=rule, recipe=replace(job.recipe, meta={rule: training}))
    encoder = MetaParameters(encoder=job.app.init_encoder(rng()))
    made = prepare.prepare(rule, job, tasks, rng(), encoder=encoder)
    plain = RULES[rule].alpha(job.app, {key: v[0] for key, v in job.app.init(rng(), 1).items()}, 3, training.first)
    assert made.start.alpha.keys() == plain.keys()
    assert not made.start.theta
    for name, value in made.start.alpha.items():
        if name.startswith(("out.", "in.")):
            torch.testing.assert_close(value @ value.mT, torch.eye(value.shape[-1])[None], atol=1e-4, rtol=0)
            assert value.shape[-1] == 1 or not torch.equal(value, plain[name])
    if not outer:
        assert len(made.curve) >= 1
        assert made.validation == min(error for _, _, error in made.curve)


def test_choices_of_the_search_are_settings_of_adam() -> None:
    for line in prepare.SEARCHED:
        for changes in line:
            adam = replace(Adam(1.0), **changes)
            assert adam.rate > 0
            assert 0 <= adam.beta1 < 1
            assert 0 < adam.beta2 < 1
            assert 0 <= adam.final <= 1
            assert adam.eps > 0
