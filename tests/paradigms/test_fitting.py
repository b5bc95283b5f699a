"""What every application and paradigm promises of fits, on tasks small enough to make here."""

import math
import pickle
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import FrozenInstanceError, replace
from typing import Any

import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from metapp.learned_rules import rule_of
from metapp.learning import learn as learning
from metapp.learning.app import App, stack_tasks
from metapp.learning.learn import MetaParameters, check_finite_losses, descend, final_item, task_loss
from metapp.learning.recipe import Adam, Guard, Recipe
from metapp.learning.task import Batch, Params, Tasks
from metapp.paradigms import PARADIGMS
from metapp.paradigms.methods import descend_tasks, fit_tasks, make_method, number_of_steps
from metapp.paradigms.trainings import trainings_of
from tests.marked import long
from tests.paradigms.small import (
    KINDS_AND_RULES,
    NETWORK_KINDS,
    OWN_RULES,
    QUILTED_TEXTURE,
    SMALL_APPLICATIONS,
    seeded_generator,
    small_app,
    small_recipe,
    untrained_checkpoint,
    untrained_phi,
)
from tests.recipe_apps import app_names, observations_of, recipes_of

# Fitting

SLOWEST = ("illumination", "svbrdf_nonstationary", "svbrdf_stationary", "texture", "transport")


@pytest.mark.parametrize("name", list(PARADIGMS))
def test_each_paradigm_fits_tasks(name: str, app: App, recipe: Recipe, tasks: Tasks) -> None:
    """Parameters of the same network, detached, finite, the same for the same seed; errors for every task."""
    method, few_tasks = make_method(name, app, recipe, untrained_checkpoint(name, app, recipe)), tasks.select([0, 5, 2])
    theta = fit_tasks(method, few_tasks, seeded_generator())
    network = {key: tuple(value.shape) for key, value in app.init(seeded_generator(), 3).items()}
    given = {key: tuple(value.shape) for key, value in app.task_parameters(few_tasks).items()}
    shapes = {key: tuple(value.shape) for key, value in theta.items()}
    # an encoder's prediction may have the parameters that tasks determine, which steps need
    assert shapes == network | given or (not method.steps and shapes == network)
    assert {value.dtype for value in theta.values()} == {torch.float32}
    assert not any(value.requires_grad for value in theta.values())
    again = fit_tasks(method, few_tasks, seeded_generator())
    torch.testing.assert_close(theta, again, rtol=0, atol=0)
    other = fit_tasks(method, few_tasks, seeded_generator(9))
    # without steps nothing need be random: an encoder may look at all there is
    if name == "overfit" or (method.steps and not app.deterministic):
        assert not all(torch.equal(theta[key], other[key]) for key in theta)
    elif app.deterministic:
        assert all(torch.equal(theta[key], other[key]) for key in theta)
    errors = app.errors(theta, few_tasks)
    assert {tuple(value.shape) for value in errors.values()} == {(3,)}
    assert torch.isfinite(errors["error"]).all()


def test_five_paradigms_differ_in_initialisation_rule_and_steps(app: App, recipe: Recipe) -> None:
    def names(paradigm: str) -> tuple[str, ...]:
        return tuple(training.name for training in trainings_of(paradigm, app, recipe))

    expected = {
        "general": (("general",), 0),
        "overfit": ((), 20),
        "finetune": (("general",), 8),
        "quickft": (("general", "quickft"), recipe.steps),
        "meta": ((recipe.rule,), recipe.steps),
    }
    assert {name: (names(name), number_of_steps(name, recipe)) for name in PARADIGMS} == expected
    for name, (_, steps) in expected.items():
        phi = untrained_checkpoint(name, app, recipe)
        methods = [make_method(name, app, recipe, phi, steps=requested) for requested in (None, 7)]
        assert [method.steps for method in methods] == [steps, number_of_steps(name, recipe, 7)]
        assert number_of_steps(name, recipe, 7) == (0 if name == "general" else 7)
        adam = {"overfit": recipe.overfit, "finetune": recipe.finetune, "quickft": recipe.quickft}.get(name)
        assert [method.adam for method in methods] == [adam, adam]


@pytest.mark.parametrize(
    ("app", "rule"), [*KINDS_AND_RULES, ("brdf", "meta-adam"), ("brdf", "meta-sgd-loss")], indirect=["app"]
)
def test_meta_fits_by_every_rule(rule: str, app: App, recipe: Recipe, tasks: Tasks) -> None:
    start = untrained_checkpoint("meta", app, recipe, rule)
    theta = fit_tasks(make_method("meta", app, recipe, start, rule=rule), tasks.select([0, 1]), seeded_generator())
    assert all(torch.isfinite(value).all() for value in theta.values())
    assert not all(torch.equal(theta[key][0], value) for key, value in start.theta.items())
    longer = make_method("meta", app, recipe, start, rule=rule, steps=recipe.steps + 2)
    assert all(torch.isfinite(value).all() for value in fit_tasks(longer, tasks, seeded_generator()).values())


# quilts have low errors before the first step; tests/apps/test_quilted_texture.py says what steps change
@pytest.mark.parametrize(
    "app",
    [long(kind) if kind in SLOWEST else kind for kind in NETWORK_KINDS if kind != QUILTED_TEXTURE],
    indirect=True,
)
def test_overfit_lowers_the_error(app: App, recipe: Recipe, tasks: Tasks) -> None:
    few_tasks = tasks.select([0, 1, 2, 3])
    overfit = make_method("overfit", app, recipe, MetaParameters(), steps=300)
    before = app.errors(app.init(seeded_generator(), 4), few_tasks)["error"]
    after = app.errors(fit_tasks(overfit, few_tasks, seeded_generator()), few_tasks)["error"]
    assert (after < 0.7 * before).all()
    assert after.mean() < 0.5 * before.mean()


def test_without_steps_a_fit_is_its_initialisation(app: App, recipe: Recipe, tasks: Tasks) -> None:
    """That is General's prediction, of Meta, too, where an encoder was trained through its steps, else theta_0."""

    def fit(name: str, phi: MetaParameters, steps: int | None = 0) -> Params:
        return fit_tasks(make_method(name, app, recipe, phi, steps=steps), tasks, seeded_generator())

    phi = untrained_phi(app, recipe)
    coded = phi._replace(theta={})
    general = fit("general", phi)
    result = [(fit(name, coded._replace(alpha={})), general) for name in ("finetune", "quickft")]
    theta_0 = {key: value.expand(len(tasks), *value.shape) for key, value in phi.theta.items()}
    result += [(fit("meta", coded), general), (fit("meta", phi._replace(encoder={})), theta_0)]
    for theta, expected in result:
        assert all(torch.equal(theta[key], value) for key, value in expected.items())
    moved = fit("meta", coded, steps=None)
    assert all(value.isfinite().all() for value in moved.values())
    assert not all(torch.equal(moved[key], value) for key, value in general.items())


@pytest.mark.parametrize("name", list(PARADIGMS))
def test_fits_side_by_side_are_as_if_each_were_alone(name: str, app: App, recipe: Recipe, tasks: Tasks) -> None:
    """With a generator for each task, its fit does not depend on those beside it, to rounding."""
    method = make_method(name, app, recipe, untrained_checkpoint(name, app, recipe), steps=3)
    rows = [4, 0, 7]
    several, loss = tasks.select(rows), task_loss(app, recipe.samples)
    together = final_item(descend_tasks(method, several, tuple(seeded_generator(row) for row in rows)))
    starts = method.start(several, tuple(seeded_generator(row) for row in rows))
    drawn = loss.draw(several, tuple(seeded_generator(row) for row in rows), 0.0).batch
    assert (method.guard is not None) == (name == "meta")  # only learned rules are guarded
    assert (None if together.guarded is None else together.guarded.shape) == ((3,) if name == "meta" else None)
    errors = app.errors(together.theta, several)["error"]
    for i, row in enumerate(rows):
        one = tasks.select([row])
        for key, value in method.start(one, seeded_generator(row)).items():
            torch.testing.assert_close(starts[key][i : i + 1], value)
        for key, value in loss.draw(one, seeded_generator(row), 0.0).batch.items():
            assert torch.equal(drawn[key][i : i + 1], value)
        alone = final_item(descend_tasks(method, one, seeded_generator(row)))
        if together.guarded is not None:
            assert alone.guarded is not None
            assert bool(alone.guarded[0]) == bool(together.guarded[i])
        # of errors, as Adam turns rounding of a gradient near 0 into a step of any sign
        torch.testing.assert_close(errors[i : i + 1], app.errors(alone.theta, one)["error"], rtol=1e-3, atol=1e-5)


def test_a_rule_that_fails_is_guarded(app: App, recipe: Recipe, tasks: Tasks) -> None:
    """With absurd rates no task ends above its initialisation on what it sees, in any application."""
    few_tasks, phi, rule = tasks.select([0, 1, 2]), untrained_checkpoint("meta", app, recipe), rule_of(recipe.rule)
    alpha = rule.initial_alpha(app, phi.theta, recipe.steps, Adam(1e4))
    meta = make_method("meta", app, recipe, phi._replace(alpha=alpha))
    found = final_item(descend_tasks(meta, few_tasks, seeded_generator()))
    assert found.guarded is not None
    if rule.name != "ridge":  # which has no rates
        assert found.guarded.tolist() == [True] * 3
    first = meta.start(few_tasks, seeded_generator())
    batch = app.sample(few_tasks, seeded_generator(), recipe.samples)
    assert (app.loss(found.theta, batch, {}) <= app.loss(first, batch, {})).all()
    assert all(value.isfinite().all() for value in found.theta.values())


def test_guard_thresholds_hold_for_named_rules_with_the_recipes_steps(app: App) -> None:
    recipe = recipes_of(app.name)["quick"]

    def guard_of(rule: str, steps: int | None = None) -> Guard | None:
        return make_method("meta", app, recipe, MetaParameters(), rule=rule, steps=steps).guard

    plain = Guard(recipe.quickft)
    for rule, training in recipe.meta.items():
        guard = guard_of(rule)
        assert guard == (training.guard or plain)
        assert guard_of(rule, recipe.steps + 1) == plain
        assert 0 < guard.max_loss_share <= 1
    assert guard_of("meta-sgd-loss") == plain


# What an application makes of tasks


def shapes(batch: Batch) -> dict[str, Any]:
    return {key: (value.shape, value.dtype) for key, value in batch.items()}


def test_augmented_tasks_work_like_tasks(app: App, tasks: Tasks) -> None:
    """There are as many, with names that tell, of equal shapes, for the same network.

    The tasks themselves stay unchanged.
    """
    few_tasks, before = tasks.select([4, 1, 7]), {key: value.clone() for key, value in tasks.data.items()}
    samples = small_recipe(app).samples
    variants = app.augment(few_tasks, seeded_generator())
    assert len(variants) == len(variants.names) == 3
    assert not set(variants.names) & set(tasks.names)
    drawn = app.sample(variants, seeded_generator(), samples)
    assert shapes(drawn) == shapes(app.sample(few_tasks, seeded_generator(), samples))
    read, expected = (app.encoder_input(some, seeded_generator()) for some in (variants, few_tasks))
    assert shapes(read) == shapes(expected)
    theta = app.encode(app.init_encoder(seeded_generator()), app.encoder_input(variants, seeded_generator()))
    assert app.loss(theta, drawn, {}).shape == (3,)
    assert app.loss(theta, drawn, {}).isfinite().all()
    again, other = app.augment(few_tasks, seeded_generator()), app.augment(few_tasks, seeded_generator(1))
    assert all(torch.equal(again.data[key], value) for key, value in variants.data.items())
    assert not all(torch.equal(other.data[key], value) for key, value in variants.data.items())
    app.augment(tasks, seeded_generator())
    assert all(torch.equal(tasks.data[key], value) for key, value in before.items())


def test_augmentation_sees_the_tasks_of_its_view_alone(app: App, tasks: Tasks) -> None:
    """Those that validate must not get into training."""
    hidden = {key: value.clone() if value.stride(0) else value for key, value in tasks.data.items()}
    for value in (tensor for tensor in hidden.values() if tensor.stride(0)):  # others are the same tensor for all tasks
        value[3:] = math.nan if value.is_floating_point() else 0
    for seed in range(3):
        variants, plain = (
            app.augment(replace(tasks, data=data).select([0, 1, 2]), seeded_generator(seed))
            for data in (hidden, tasks.data)
        )
        assert all(torch.equal(variants.data[key], value) for key, value in plain.data.items())


def test_an_application_is_plain_data(app: App) -> None:
    """Applications of every recipe are frozen, equal where their fields are, and can be pickled."""
    recipes = recipes_of(app.name)
    assert {"paper", "quick"} <= set(recipes)
    for recipe in recipes.values():
        again = recipe.app
        assert again == replace(recipe.app)
        with pytest.raises(FrozenInstanceError):
            again.network = None
        assert pickle.loads(pickle.dumps(again)) == again
        assert recipe.rule in recipe.meta
        assert all(isinstance(value, str) and value for value in again.recorded_conditions().values())


# Steps read nothing back


READS = ("item", "tolist", "cpu", "numpy", "__bool__", "__int__", "__float__", "__index__")
STEPS = 3
# stationary svBRDFs cut windows out whose places they draw: the only numbers that a fit reads at each step
KNOWN = {"svbrdf_stationary": ("tolist",)}


class Ops(TorchDispatchMode):
    """Refuse what waits by itself: numbers that are read, and masks, of which must be counted what they leave."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name = func.overloadpacket.__name__
        masks = name in ("index", "index_put", "index_put_") and any(
            index is not None and index.dtype == torch.bool for index in args[1]
        )
        if masks or name in ("_local_scalar_dense", "nonzero", "masked_select", "unique", "_unique2"):
            raise AssertionError(f"a step waits for {name}")
        return func(*args, **(kwargs or {}))


@contextmanager
def reading_nothing(allowed: tuple[str, ...]) -> Iterator[None]:
    """Fail where a number is read back in another way than those that are allowed."""

    def refuse(name: str) -> Any:
        def read(*args: Any, **kwargs: Any) -> Any:
            raise AssertionError(f"a step calls Tensor.{name}")

        return read

    with pytest.MonkeyPatch.context() as patch, Ops():
        for name in set(READS) - set(allowed):
            patch.setattr(Tensor, name, refuse(name))
        yield


@pytest.mark.usefixtures("second_scene")
@pytest.mark.parametrize(
    ("kind", "protocol"),
    [
        (kind, protocol)
        for kind in NETWORK_KINDS
        for protocol in (observations_of(kind) if kind in app_names() else [""])
    ],
)
def test_steps_do_not_synchronise_with_the_device(kind: str, protocol: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Only the check that the first loss is finite reads a value back."""
    app = small_app(kind, protocol)
    recipe, rule = small_recipe(app), OWN_RULES[kind]
    phi = untrained_checkpoint("meta", app, recipe, rule)
    meta = make_method("meta", app, recipe, phi, rule=rule, steps=STEPS)
    tasks = stack_tasks(app, SMALL_APPLICATIONS[app.name].tasks()[:2])
    assert meta.rule is not None

    def fit(where: AbstractContextManager[None]) -> None:
        theta = meta.start(tasks, seeded_generator())
        rule, draws = meta.rule(theta), seeded_generator()
        with where:
            final_item(check_finite_losses(descend(theta, rule, tasks, meta.loss, steps=STEPS, rng=draws), every=0))

    fit(nullcontext())  # constants are made at their first use
    monkeypatch.setattr(learning, "_require_finite", lambda *args: None)
    fit(reading_nothing(KNOWN.get(kind, ())))
