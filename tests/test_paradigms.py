"""What every application and paradigm promises, on tasks small enough to make here."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any

import pytest
import torch
from torch import Generator

from data_tools.brdf_task import brdf_task
from data_tools.synthetic_brdf import synthetic_materials
from metapp.apps import app_names, load_app
from metapp.learning import MetaParameters, learn, task_loss
from metapp.paradigms import Job, Paradigm, paradigms, prepare
from metapp.paradigms.prepare import Interrupted, Prepared, split_validation, tune_quickft, validation_error
from metapp.paradigms.quickft import to_alpha
from metapp.rules import RULES, fixed_adam
from metapp.task import Adam, App, Params, Task, Tasks, stack

COUNT = 12


def brdf_tasks() -> list[Task]:
    return [brdf_task(each.name, each.evaluate, samples=512) for each in synthetic_materials("train", COUNT)]


SMALL: dict[str, Callable[[], list[Task]]] = {"brdf": brdf_tasks}


@pytest.fixture(autouse=True)
def eager(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compiling takes longer than these tests."""
    monkeypatch.setattr(prepare, "can_compile", lambda: False)


@pytest.fixture(scope="module", params=app_names())
def app(request: pytest.FixtureRequest) -> App:
    return load_app(request.param)


@pytest.fixture(scope="module")
def tasks(app: App) -> Tasks:
    assert app.name in SMALL, f"{app.name}: no small tasks for its contract; add a line to SMALL."
    return stack(app, SMALL[app.name]())


@pytest.fixture
def job(app: App) -> Job:
    """The quick recipe, with few samples, tasks and steps."""
    recipe = app.recipes["quick"]

    def short(training: Any) -> Any:
        return replace(training, steps=12, tasks=3, warmup=0, validate_every=4)

    meta = {rule: short(training) for rule, training in recipe.meta.items()}
    recipe = replace(recipe, steps=3, batch=64, general=short(recipe.general), meta=meta, finetune_steps=20)
    return Job(app, replace(recipe, overfit_steps=60), recipe.rule)


def rng(seed: int = 0) -> Generator:
    return Generator().manual_seed(seed)


def untrained(job: Job) -> MetaParameters:
    """A start for every paradigm: a random encoder, a random theta_0 and its rule's initial quantities."""
    theta = {key: value[0] for key, value in job.app.init(rng(1), 1).items()}
    alpha = RULES[job.rule].alpha(job.app, theta, job.recipe.steps, 5e-3)
    return MetaParameters(theta, alpha, job.app.init_encoder(rng(2)))


def start_for(paradigm: Paradigm, job: Job) -> MetaParameters:
    start = untrained(job)
    return start if paradigm.name == "meta" else start._replace(alpha={})


def mean_error(app: App, theta: Params, tasks: Tasks) -> float:
    return float(app.errors(theta, tasks)["error"].mean())


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
    assert not all(torch.equal(theta[key], other[key]) for key in theta)
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


@pytest.mark.parametrize("rule", list(RULES))
def test_meta_fits_by_every_rule(rule: str, job: Job, tasks: Tasks) -> None:
    job = job._replace(rule=rule)
    theta = paradigms()["meta"].fit(job, untrained(job), tasks.select([0, 1]), rng())
    start = untrained(job).theta
    assert all(torch.isfinite(value).all() for value in theta.values())
    assert not all(torch.equal(value[0], start[key]) for key, value in theta.items())
    longer = paradigms()["meta"].fit(job._replace(steps=job.recipe.steps + 2), untrained(job), tasks, rng())
    assert all(torch.isfinite(value).all() for value in longer.values())


def test_overfit_learns(job: Job, tasks: Tasks) -> None:
    few, job = tasks.select([0, 1, 2, 3]), job._replace(steps=300)
    before = job.app.errors(job.app.init(rng(), 4), few)["error"]
    after = job.app.errors(paradigms()["overfit"].fit(job, MetaParameters(), few, rng()), few)["error"]
    assert (after < 0.7 * before).all()
    assert after.mean() < 0.3 * before.mean()


@pytest.mark.parametrize("name", ["quickft", "finetune"])
def test_no_steps_from_general_is_general(name: str, job: Job, tasks: Tasks) -> None:
    prepared = start_for(paradigms()[name], job)
    general = paradigms()["general"].fit(job, prepared, tasks, rng())
    for key, value in paradigms()[name].fit(job._replace(steps=0), prepared, tasks, rng()).items():
        assert torch.equal(value, general[key])


def test_meta_starts_all_tasks_alike(job: Job, tasks: Tasks) -> None:
    theta = paradigms()["meta"].fit(job._replace(steps=0), untrained(job), tasks, rng())
    for key, value in untrained(job).theta.items():
        assert torch.equal(theta[key], value.expand(len(tasks), *value.shape))


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


# Preparing


def test_split_keeps_tasks_apart(tasks: Tasks) -> None:
    fit, validate = split_validation(tasks)
    names = tasks.picked_names()
    assert validate.picked_names() == names[3::8]
    assert fit.picked_names() == tuple(name for name in names if name not in names[3::8])
    with pytest.raises(ValueError, match="training set: 3 tasks, expected at least 4"):
        split_validation(tasks.select([0, 1, 2]))


def look(name: str, job: Job, tasks: Tasks, **options: Any) -> Prepared:
    return prepare.prepare(name, job if name == "general" else job._replace(rule=name), tasks, rng(3), **options)


def error_of(name: str, job: Job, start: MetaParameters, tasks: Tasks) -> float:
    job = job if name == "general" else job._replace(rule=name)
    return validation_error(paradigms()["general" if name == "general" else "meta"], job, start, tasks)


@pytest.mark.parametrize("name", ["general", *RULES])
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


@pytest.mark.parametrize("name", ["general", *RULES])
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
    assert prepared.validation < 0.8 * prepared.curve[0][2]


def test_meta_learns(job: Job, tasks: Tasks) -> None:
    training = replace(job.recipe.meta["meta-adam"], steps=60, rates={"": 1e-2}, validate_every=20)
    recipe = replace(job.recipe, meta={"meta-adam": training})
    prepared = look("meta-adam", job._replace(recipe=recipe), tasks)
    assert prepared.validation < 0.8 * prepared.curve[0][2]


def test_meta_starts_from_the_mean_of_general(job: Job, tasks: Tasks) -> None:
    encoder = start_for(paradigms()["general"], job)
    rule = job.recipe.rule
    recipe = replace(job.recipe, meta={rule: replace(job.recipe.meta[rule], from_general=True)})
    prepared = look(rule, job._replace(recipe=recipe), tasks, encoder=encoder, steps=0)
    predicted = paradigms()["general"].fit(job, encoder, split_validation(tasks)[0], rng(3))
    for key, value in predicted.items():
        torch.testing.assert_close(prepared.start.theta[key], value.mean(0))


@pytest.mark.parametrize("name", ["general", "meta-sgd"])
def test_training_never_sees_a_validation_task(
    name: str, job: Job, tasks: Tasks, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the data of the validation tasks spoilt, the training loss stays finite."""
    rows = split_validation(tasks)[1].rows
    spoilt = {}
    for key, value in tasks.data.items():
        own = value.is_floating_point() and value.stride(0) != 0  # what all tasks share is no task's
        spoilt[key] = value.index_fill(0, rows, math.nan) if own else value
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


def test_tuned_quickft_is_no_worse_than_the_recipe(job: Job, tasks: Tasks) -> None:
    """On the tasks it was tuned on; a strawman is no baseline."""
    job = job._replace(steps=2)
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
