"""What every application and paradigm promises of fits, on tasks small enough to make here."""

from __future__ import annotations

import math
import pickle
from dataclasses import FrozenInstanceError, replace
from typing import Any

import pytest
import torch

from metapp.apps import app_of, recipes_of
from metapp.learning.app import App
from metapp.learning.learn import MetaParameters, last, task_loss
from metapp.learning.recipe import Adam, Guard
from metapp.learning.rules import rule_of
from metapp.learning.task import Batch, Tasks
from metapp.paradigms import Job, paradigms
from tests.marked import long
from tests.paradigms.small import KINDS, PAIRS, prepared_for, rng, untrained

# Fitting

SLOWEST = ("illumination", "svbrdf_nonstationary", "svbrdf_stationary", "texture", "transport")


@pytest.mark.parametrize("name", list(paradigms()))
def test_a_paradigm_fits(name: str, job: Job, tasks: Tasks) -> None:
    """Parameters of the same network, detached, finite, the same for the same seed; errors for every task."""
    paradigm, few = paradigms()[name], tasks.select([0, 5, 2])
    prepared = prepared_for(paradigm, job)
    theta = paradigm.fit(job, prepared, few, rng())
    network = {key: tuple(value.shape) for key, value in job.app.init(rng(), 3).items()}
    given = {key: tuple(value.shape) for key, value in job.app.known(few).items()} if paradigm.count(job) else {}
    assert {key: tuple(value.shape) for key, value in theta.items()} == network | given
    assert {value.dtype for value in theta.values()} == {torch.float32}
    assert not any(value.requires_grad for value in theta.values())
    again = paradigm.fit(job, prepared, few, rng())
    assert all(torch.equal(theta[key], again[key]) for key in theta)
    other = paradigm.fit(job, prepared, few, rng(9))
    # without steps nothing need be random: an encoder may look at all there is
    if name == "overfit" or (paradigm.count(job) and not job.app.deterministic):
        assert not all(torch.equal(theta[key], other[key]) for key in theta)
    elif job.app.deterministic:
        assert all(torch.equal(theta[key], other[key]) for key in theta)
    errors = job.app.errors(theta, few)
    assert {tuple(value.shape) for value in errors.values()} == {(3,)}
    assert torch.isfinite(errors["error"]).all()


def test_the_five_paradigms(job: Job) -> None:
    steps = job.recipe.steps
    expected = {
        "general": (("general",), 0),
        "overfit": ((), 20),
        "finetune": (("general",), 8),
        "quickft": (("general", "quickft"), steps),
        "meta": ((job.rule,), steps),
    }
    assert {name: (each.needs(job), each.count(job)) for name, each in paradigms().items()} == expected
    seven = {name: paradigm.count(job._replace(steps=7)) for name, paradigm in paradigms().items()}
    assert seven == {name: 0 if name == "general" else 7 for name in expected}


@pytest.mark.parametrize(("app", "rule"), [*PAIRS, ("brdf", "adam+curvature"), ("brdf", "sgd+loss")], indirect=["app"])
def test_meta_fits_by_every_rule(rule: str, job: Job, tasks: Tasks) -> None:
    job = job._replace(rule=rule)
    start = prepared_for(paradigms()["meta"], job)
    theta = paradigms()["meta"].fit(job, start, tasks.select([0, 1]), rng())
    assert all(torch.isfinite(value).all() for value in theta.values())
    assert not all(torch.equal(theta[key][0], value) for key, value in start.theta.items())
    longer = paradigms()["meta"].fit(job._replace(steps=job.recipe.steps + 2), start, tasks, rng())
    assert all(torch.isfinite(value).all() for value in longer.values())


@pytest.mark.parametrize("app", [long(kind) if kind in SLOWEST else kind for kind in KINDS], indirect=True)
def test_overfit_learns(job: Job, tasks: Tasks) -> None:
    few, job = tasks.select([0, 1, 2, 3]), job._replace(steps=300)
    before = job.app.errors(job.app.init(rng(), 4), few)["error"]
    after = job.app.errors(paradigms()["overfit"].fit(job, MetaParameters(), few, rng()), few)["error"]
    assert (after < 0.7 * before).all()
    assert after.mean() < 0.5 * before.mean()


def test_without_steps_a_fit_is_its_initialisation(job: Job, tasks: Tasks) -> None:
    """That is General's prediction, of Meta, too, where an encoder was trained through its steps, else theta_0."""
    table, phi, none = paradigms(), untrained(job), job._replace(steps=0)
    general = table["general"].fit(job, phi, tasks, rng())
    coded = phi._replace(theta={})
    fits = [(table[name].fit(none, coded, tasks, rng()), general) for name in ("finetune", "quickft", "meta")]
    theta_0 = {key: value.expand(len(tasks), *value.shape) for key, value in phi.theta.items()}
    fits.append((table["meta"].fit(none, phi._replace(encoder={}), tasks, rng()), theta_0))
    for theta, expected in fits:
        assert all(torch.equal(theta[key], value) for key, value in expected.items())
    moved = table["meta"].fit(job, coded, tasks, rng())
    assert all(value.isfinite().all() for value in moved.values())
    assert not all(torch.equal(moved[key], value) for key, value in general.items())


@pytest.mark.parametrize("name", list(paradigms()))
def test_fits_side_by_side_are_as_if_each_were_alone(name: str, job: Job, tasks: Tasks) -> None:
    """With a generator for each task, its fit does not depend on those beside it, to rounding."""
    paradigm, rows, job = paradigms()[name], [4, 0, 7], job._replace(steps=3)
    prepared, several = prepared_for(paradigm, job), tasks.select(rows)
    together = last(paradigm.descend(job, prepared, several, tuple(rng(row) for row in rows)))
    starts = paradigm.initialisation(job, prepared, several, tuple(rng(row) for row in rows))
    drawn = task_loss(job.app, job.recipe.batch).draw(several, tuple(rng(row) for row in rows), 0.0).batch
    assert (paradigm.guard(job) is not None) == (name == "meta")  # only learned rules are guarded
    assert (None if together.guarded is None else together.guarded.shape) == ((3,) if name == "meta" else None)
    errors = job.app.errors(together.theta, several)["error"]
    for i, row in enumerate(rows):
        one = tasks.select([row])
        for key, value in paradigm.initialisation(job, prepared, one, rng(row)).items():
            torch.testing.assert_close(starts[key][i : i + 1], value)
        for key, value in task_loss(job.app, job.recipe.batch).draw(one, rng(row), 0.0).batch.items():
            assert torch.equal(drawn[key][i : i + 1], value)
        alone = last(paradigm.descend(job, prepared, one, rng(row)))
        if together.guarded is not None:
            assert alone.guarded is not None
            assert bool(alone.guarded[0]) == bool(together.guarded[i])
        # of errors, as Adam turns rounding of a gradient near 0 into a step of any sign
        torch.testing.assert_close(errors[i : i + 1], job.app.errors(alone.theta, one)["error"], rtol=1e-3, atol=1e-5)


def test_a_rule_that_fails_is_guarded(job: Job, tasks: Tasks) -> None:
    """With absurd rates no task ends above its initialisation on what it sees, in any application."""
    app, meta, few = job.app, paradigms()["meta"], tasks.select([0, 1, 2])
    prepared = prepared_for(meta, job)
    alpha = rule_of(job.rule).alpha(app, prepared.theta, job.recipe.steps, Adam(1e4))
    found = last(meta.descend(job, prepared._replace(alpha=alpha), few, rng()))
    assert found.guarded is not None
    if not rule_of(job.rule).has("solve"):  # which has no rates
        assert found.guarded.tolist() == [True] * 3
    first, batch = meta.initialisation(job, prepared, few, rng()), app.sample(few, rng(), job.recipe.batch)
    assert (app.loss(found.theta, batch, {}) <= app.loss(first, batch, {})).all()
    assert all(value.isfinite().all() for value in found.theta.values())


def test_what_is_doubtful_is_known_of_named_rules_after_their_own_steps(app: App) -> None:
    recipe, meta = recipes_of(app.name)["quick"], paradigms()["meta"]
    plain = Guard(recipe.quickft)
    for rule, training in recipe.meta.items():
        job = Job(app, recipe, rule)
        assert meta.guard(job) == (training.guard or plain)
        assert meta.guard(job._replace(steps=recipe.steps + 1)) == plain
        assert 0 < meta.guard(job).fall <= 1
    assert meta.guard(Job(app, recipe, "sgd+loss")) == plain


# What an application makes of tasks


def shapes(batch: Batch) -> dict[str, Any]:
    return {key: (value.shape, value.dtype) for key, value in batch.items()}


def test_made_up_tasks_do_what_tasks_do(job: Job, tasks: Tasks) -> None:
    """As many, with names that say so, for the same network, of the same shapes; the tasks themselves stay."""
    app, few, before = job.app, tasks.select([4, 1, 7]), {key: value.clone() for key, value in tasks.data.items()}
    made = app.augment(few, rng())
    assert len(made) == len(made.names) == 3
    assert not set(made.names) & set(tasks.names)
    drawn = app.sample(made, rng(), job.recipe.batch)
    assert shapes(drawn) == shapes(app.sample(few, rng(), job.recipe.batch))
    assert shapes(app.condition(made, rng())) == shapes(app.condition(few, rng()))
    theta = app.encode(app.init_encoder(rng()), app.condition(made, rng()))
    assert app.loss(theta, drawn, {}).shape == (3,)
    assert app.loss(theta, drawn, {}).isfinite().all()
    again, other = app.augment(few, rng()), app.augment(few, rng(1))
    assert all(torch.equal(again.data[key], value) for key, value in made.data.items())
    assert not all(torch.equal(other.data[key], value) for key, value in made.data.items())
    app.augment(tasks, rng())
    assert all(torch.equal(tasks.data[key], value) for key, value in before.items())


def test_augmentation_sees_the_tasks_of_its_view_alone(app: App, tasks: Tasks) -> None:
    """Those that validate must not get into training."""
    hidden = {key: value.clone() if value.stride(0) else value for key, value in tasks.data.items()}
    for value in (each for each in hidden.values() if each.stride(0)):  # others are the same tensor for all tasks
        value[3:] = math.nan if value.is_floating_point() else 0
    for seed in range(3):
        made, plain = (
            app.augment(replace(tasks, data=data).select([0, 1, 2]), rng(seed)) for data in (hidden, tasks.data)
        )
        assert all(torch.equal(made.data[key], value) for key, value in plain.data.items())


def test_an_application_is_plain_data(app: App) -> None:
    """By every recipe: frozen, equal where its fields are, pickled; and what errors depend on is said."""
    recipes = recipes_of(app.name)
    assert {"paper", "quick"} <= set(recipes)
    for recipe in recipes.values():
        again = app_of(app.name, recipe)
        assert again == replace(recipe.app, protocol=again.protocol)
        with pytest.raises(FrozenInstanceError):
            again.network = None
        assert pickle.loads(pickle.dumps(again)) == again
        assert recipe.rule in recipe.meta
        assert all(isinstance(value, str) and value for value in again.conditions().values())
