"""Trainings of checkpoints: what is kept, what they go on from, and which tasks they never see."""

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.nbrdf_network import NBRDF_NETWORK
from metapp.learned_rules import rule_of
from metapp.learning.app import App
from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import ADAM_SEARCH, Adam, Recipe
from metapp.learning.task import Batch, Params, Tasks
from metapp.paradigms import PARADIGMS
from metapp.paradigms.methods import fit_tasks, make_method
from metapp.paradigms.training import TrainState, split_validation, train_phi, validation_error
from metapp.paradigms.trainings import Training, adam_search, general_training, rule_training, trainings_of
from tests.marked import long
from tests.paradigms.small import (
    GENERATING_KINDS_BUT_BRDF_LONG,
    KINDS_AND_RULES,
    KINDS_BUT_BRDF_LONG,
    OWN_RULES,
    best_state,
    seeded_generator,
    small_recipe,
    untrained_checkpoint,
)
from tests.recipe_apps import app_by_recipe, recipes_of

ONE_APP = pytest.mark.parametrize("app", ["brdf"], indirect=True)  # what no application changes


def test_split_keeps_tasks_apart(tasks: Tasks) -> None:
    fit, validate = split_validation(tasks)
    names = tasks.selected_names
    assert set(validate.selected_names) == set(sorted(names)[3::8])
    assert fit.selected_names == tuple(name for name in names if name not in validate.selected_names)
    with pytest.raises(ValueError, match="training set: 3 tasks that show 3 things, expected at least 4"):
        split_validation(tasks.select([0, 1, 2]))


def test_split_keeps_photos_of_one_thing_together() -> None:
    """Their order does not count; validation tasks are spread over families that alternate."""
    names = tuple(f"{i:02d}-{photo}" for photo in range(3) for i in range(12))
    groups = tuple(name.split("-")[0] for name in names)
    fit, validate = split_validation(Tasks(names, {}, torch.arange(36), groups))
    assert {name.split("-")[0] for name in validate.selected_names} == {"03", "11"}
    assert (len(fit), len(validate)) == (30, 6)
    turns = tuple(f"{'abcd'[i % 4]}-{i:02d}" for i in range(64))
    _, validate = split_validation(Tasks(turns, {}, torch.arange(64)))
    assert {name[0] for name in validate.selected_names} == set("abcd")


@pytest.mark.parametrize("name", ["general", "meta"])
@ONE_APP
def test_trainings_follow_the_outer_loss(name: str, app: App, tasks: Tasks) -> None:
    class Judged(Brdf):
        has_outer_loss = True

        def outer_loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
            return 0 * self.loss(theta, batch, loss_parameters) + 7

    judged = Judged(NBRDF_NETWORK)
    (training,) = trainings_of(name, judged, small_recipe(judged))
    phi = training.first_phi(None, tasks, seeded_generator())
    assert training.outer_loss is not None
    loss = training.outer_loss(phi)
    values = loss.value(phi.flatten(), loss.draw(tasks, seeded_generator(), 0.0).batch, {})
    assert torch.equal(values, torch.full_like(values, 7))


@pytest.mark.parametrize("app", ["brdf"], indirect=True)
def test_validation_counts_kinds_alike(app: App, recipe: Recipe, tasks: Tasks) -> None:
    """One material of another kind counts as much as all others."""
    general, start = general_training(app, recipe), MetaParameters(encoder=app.init_encoder(seeded_generator(0)))
    apart = [validation_error(general, start, tasks.select(rows)) for rows in ([0], range(1, len(tasks)))]
    kinds = torch.tensor([[i == 0] for i in range(len(tasks.names))])
    mixed = replace(tasks, data=tasks.data | {"kind": kinds})
    # what the encoder reads is drawn for all tasks at once
    assert validation_error(general, start, mixed) == pytest.approx(sum(apart) / 2, rel=1e-3)
    assert validation_error(general, start, tasks) != pytest.approx(sum(apart) / 2, rel=1e-2)


OTHERS = ("illumination", "svbrdf_nonstationary", "svbrdf_stationary", "texture", "transport")
EVERY = pytest.mark.parametrize(
    ("app", "name"),
    [
        *((app, "general") for app in OWN_RULES),
        *(long(*pair) if pair[0] in OTHERS else pair for pair in KINDS_AND_RULES),
    ],
    indirect=["app"],
)


@pytest.fixture
def training(name: str, app: App, recipe: Recipe) -> Training:
    """The training of the checkpoint of a paradigm or a rule."""
    return training_of(name, app, recipe)


def training_of(name: str, app: App, recipe: Recipe) -> Training:
    return trainings_of(name, app, recipe)[-1] if name in PARADIGMS else rule_training(app, recipe, name)


def look(training: Training, tasks: Tasks, **options: Any) -> TrainState:
    return best_state(train_phi(training, tasks, seeded_generator(3), **options))


@EVERY
def test_the_best_state_is_kept(training: Training, tasks: Tasks) -> None:
    prepared = look(training, tasks)
    steps, losses, errors = zip(*prepared.curve, strict=True)
    assert steps == (0, 2, 4, 6)
    assert prepared.validation == min(errors) <= errors[0]
    assert steps[errors.index(min(errors))] == prepared.best_step
    assert losses[0] is None
    assert all(loss is not None and math.isfinite(loss) for loss in losses[1:])
    validation = split_validation(tasks)[1]
    assert math.isclose(validation_error(training, prepared.phi, validation), prepared.validation, rel_tol=1e-6)
    again = look(training, tasks)
    assert again.curve[1:] == prepared.curve[1:]
    assert all(torch.equal(again.phi.flatten()[key], value) for key, value in prepared.phi.flatten().items())


@ONE_APP
def test_augmented_variants_of_validation_tasks_may_validate(app: App, recipe: Recipe, tasks: Tasks) -> None:
    """Each validation task twice, with the same draws at every validation."""
    changed = replace(recipe.training(recipe.rule), steps=2, validation_variants=2, initialisation="random")
    training = rule_training(app, replace(recipe, meta={recipe.rule: changed}))
    *_, state = train_phi(training, tasks, seeded_generator())
    validation = split_validation(tasks)[1]
    variants = app.augment(validation.select([*range(len(validation))] * 2), seeded_generator(0))
    assert state.validation == pytest.approx(validation_error(training, state.phi, variants), rel=1e-6)


@ONE_APP
@pytest.mark.parametrize("name", ["general", "meta-sgd"])
def test_a_start_that_only_gets_worse_is_kept(training: Training, tasks: Tasks) -> None:
    """Iteration 0 is among the states to choose from, and it is not written to afterwards."""
    before, errors = look(training, tasks, steps=0), itertools.count(1)
    prepared = look(training, tasks, validate=lambda *_: float(next(errors)))
    assert (prepared.best_step, prepared.validation) == (0, 1.0)
    assert [error for _, _, error in prepared.curve] == [1.0, 2.0, 3.0, 4.0]
    assert all(torch.equal(prepared.phi.flatten()[key], value) for key, value in before.phi.flatten().items())


@pytest.mark.parametrize("app", GENERATING_KINDS_BUT_BRDF_LONG, indirect=True)
@pytest.mark.parametrize(("name", "steps", "rate"), [("general", 100, 2e-3), ("meta-curvature", 30, 2e-2)])
def test_preparing_improves_what_it_is_prepared_for(
    name: str, steps: int, rate: float, app: App, recipe: Recipe, tasks: Tasks
) -> None:
    """The improvement is a share of the error's size, since errors may be negative."""
    longer = replace(training_of(name, app, recipe).outer_loop, steps=steps, rates={"": rate}, validate_every=10)
    changed: dict[str, Any] = {"general": longer} if name == "general" else {"meta": {name: longer}}
    prepared = look(training_of(name, app, replace(recipe, **changed)), tasks)
    first = prepared.curve[0][2]
    assert first - prepared.validation > 0.1 * abs(first)


def meta_training(app: App, recipe: Recipe, **settings: Any) -> Training:
    """Return Meta's training by other settings."""
    return rule_training(app, replace(recipe, meta={recipe.rule: replace(recipe.meta[recipe.rule], **settings)}))


def test_meta_starts_from_the_mean_of_general_or_at_random(app: App, recipe: Recipe, tasks: Tasks) -> None:
    """It starts at random where a setting says so, and where there is no General."""
    encoder = untrained_checkpoint("general", app, recipe)
    general = make_method("general", app, recipe, encoder)
    predicted = fit_tasks(general, split_validation(tasks)[0], seeded_generator(3))
    mean = {key: value.mean(0) for key, value in predicted.items()}
    random = {key: value[0] for key, value in app.init(seeded_generator(3), 1).items()}
    for start, given, expected in (("mean", encoder, mean), ("random", encoder, random), ("mean", None, random)):
        phi = look(meta_training(app, recipe, initialisation=start), tasks, general=given, steps=0).phi
        assert not phi.encoder
        for key, value in expected.items():
            if expected is mean:
                torch.testing.assert_close(phi.theta[key], value)
            else:
                assert torch.equal(phi.theta[key], value)


@pytest.mark.parametrize("app", KINDS_BUT_BRDF_LONG, indirect=True)
def test_meta_goes_on_from_general(app: App, recipe: Recipe, tasks: Tasks) -> None:
    """The encoder itself is then trained through the steps, beside the rule, and another checkpoint there is none."""
    encoder = untrained_checkpoint("general", app, recipe)
    first = look(meta_training(app, recipe, initialisation="encoder"), tasks, general=encoder, steps=0).phi
    assert not first.theta
    assert all(torch.equal(first.encoder[key], value) for key, value in encoder.encoder.items())
    meta = meta_training(app, recipe, initialisation="encoder", steps=20, rates={"": 1e-3}, validate_every=5)
    prepared = look(meta, tasks, general=encoder)
    assert prepared.best_step > 0
    assert prepared.validation < prepared.curve[0][2]
    assert not prepared.phi.theta
    assert not all(torch.equal(prepared.phi.encoder[key], value) for key, value in encoder.encoder.items())
    assert not all(torch.equal(prepared.phi.alpha[key], value) for key, value in first.alpha.items())
    validation = split_validation(tasks)[1]
    assert math.isclose(validation_error(meta, prepared.phi, validation), prepared.validation, rel_tol=1e-6)


@pytest.mark.parametrize(
    ("app", "name"), [*((app, "general") for app in OWN_RULES), ("brdf", "meta-sgd")], indirect=["app"]
)
def test_training_never_sees_a_validation_task(training: Training, tasks: Tasks) -> None:
    """With the data of the validation tasks spoilt, the training loss stays finite."""
    rows = split_validation(tasks)[1].rows
    spoilt = {}
    for key, value in tasks.data.items():
        has_task_axis = value.stride(0) != 0  # what all tasks share is no task's
        spoilt[key] = value.float().index_fill(0, rows, math.nan) if has_task_axis else value
    prepared = look(training, Tasks(tasks.names, spoilt, tasks.rows), steps=12, validate=lambda *_: 1.0)
    assert all(loss is not None and math.isfinite(loss) for _, loss, _ in prepared.curve[1:])


# The search of an Adam on validation tasks


# The search of QuickFT's Adam, on errors in closed form


GENERAL = MetaParameters(encoder={"w": torch.ones(2)})
TASKS = Tasks(tuple("abcd"), {}, torch.arange(4))
BEST = Adam(rate=0.05, beta1=0.5, beta2=0.97, eps=1e-4, final_rate_share=0.1)


def bowl(adam: Adam) -> float:
    """0 at BEST, and rising with the distance from it in each quantity."""
    away = [
        math.log(adam.rate / BEST.rate),
        3 * (adam.beta1 - BEST.beta1),
        10 * (adam.beta2 - BEST.beta2),
        math.log(adam.eps / BEST.eps) / 10,
        adam.final_rate_share - BEST.final_rate_share,
    ]
    return sum(difference * difference for difference in away)


class Search:
    """A search from an Adam on that is told errors in closed form, and what it looked at."""

    def __init__(self, first: Adam, error: Callable[[Adam], float] = bowl) -> None:
        self.training = adam_search(app_by_recipe("brdf"), replace(recipes_of("brdf")["quick"], quickft=first))
        self.looked: list[Adam] = []

        def told(training: Training, prepared: MetaParameters, tasks: Any) -> float:
            assert training == self.training
            self.looked.append(self.adam_of(prepared))
            return error(self.looked[-1])

        self.path = list(train_phi(self.training, TASKS, seeded_generator(), general=GENERAL, validate=told))
        self.tuned = best_state(self.path)
        self.found = self.adam_of(self.tuned.phi)

    def adam_of(self, phi: MetaParameters) -> Adam:
        """Return the Adam of fits from phi."""
        adam = self.training.method(phi).adam
        assert adam is not None
        return adam


@pytest.mark.parametrize(
    "first", [Adam(1e-2), Adam(5e-2, 0.9, 0.99, 1e-8, 0.0), Adam(1.0, 0.3, 0.8), Adam(2e-3, 0.9, 0.999, 1e-3)]
)
def test_the_search_finds_the_best_adam(first: Adam) -> None:
    """It does so from a rate 25 times too small or 20 times too large, to a third of the step of the grid of rates."""
    search = Search(first)
    found = search.found
    assert (found.beta1, found.beta2, found.final_rate_share) == (BEST.beta1, BEST.beta2, BEST.final_rate_share)
    assert found.eps == pytest.approx(BEST.eps)
    assert abs(math.log2(found.rate / BEST.rate)) < 1 / 6
    assert search.tuned.validation == pytest.approx(bowl(found))


def test_the_search_goes_on_around_the_best_so_far() -> None:
    """One line of choices at a time changes its own quantities, and those before it stay at their best."""
    first = Adam(0.05, 0.9, 0.999, 1e-8, 1.0)
    search = Search(first)
    looked, lines = search.looked, [len(line) for line in ADAM_SEARCH]
    assert (looked[0], len(looked)) == (first, 1 + sum(lines))
    for i, now in enumerate(search.path, 1):
        assert (now.step, now.total, now.searched) == (i, len(looked), tuple(map(bowl, looked[:i])))
        assert f"rate {looked[i - 1].rate:.1e}, validation" in now.note
        best, found = min(looked[:i], key=bowl), best_state([now])
        assert search.adam_of(found.phi) == best == looked[found.best_step - 1]
        assert found.validation == found.curve[-1][2] == bowl(best)
    for sighting in looked[1 : 1 + lines[0]]:
        assert replace(sighting, rate=first.rate) == first
    for sighting in looked[1 + sum(lines[:2]) : sum(lines)]:
        assert (sighting.beta1, sighting.beta2) == (BEST.beta1, BEST.beta2)
    errors = [error for _, _, error in search.tuned.curve]
    assert errors == sorted(errors, reverse=True)


def test_the_best_recipe_is_kept_and_a_diverging_one_is_left() -> None:
    first = Adam(0.0123, 0.77, 0.95, 3e-5, 0.2)
    for error in (lambda adam: 1.0, lambda adam: 0.5 if adam == first else math.inf):
        search = Search(first, error)
        assert search.found == first
        assert (search.tuned.best_step, len(search.tuned.curve)) == (1, 1)
    search = Search(Adam(10.0), lambda adam: bowl(adam) if adam.rate < 3 else math.inf)
    assert math.isfinite(search.tuned.validation)
    assert search.found.rate < 3


@pytest.mark.parametrize(("name", "count"), [("brdf", 30), ("texture", 8), ("svbrdf_stationary", 8)])
def test_searches_use_all_validation_tasks_if_fits_are_cheap(name: str, count: int) -> None:
    training = adam_search(app_by_recipe(name), recipes_of(name)["quick"])
    names = tuple(f"{i:03d}" for i in range(240))
    looked: list[int] = []

    def told(training: Training, prepared: MetaParameters, tasks: Tasks) -> float:
        looked.append(len(tasks))
        return 1.0

    data = Tasks(names, {}, torch.arange(240))
    states = train_phi(training, data, seeded_generator(), general=GENERAL, steps=3, validate=told)
    assert len(list(states)) == 3
    assert looked == [count] * 3


@pytest.mark.parametrize("app", ["texture"], indirect=True)
@pytest.mark.parametrize("outer", [0, 2])
@pytest.mark.parametrize("rule", ["meta-axes", "meta-basis"])
def test_a_rule_is_tuned_as_quickft_is(rule: str, outer: int, app: App, recipe: Recipe, tasks: Tasks) -> None:
    """The rule's Adam is searched on validation tasks, in the bases of the training tasks, before outer steps begin."""
    search = ([{"rate": 0.5}, {"rate": 2.0}], [{"beta1": 0.3, "rate": 1.0}])
    recipe = replace(recipe, search=search)
    tuned = replace(recipe.meta[rule], initialisation="encoder", searches_adam=True, steps=outer)
    training = rule_training(app, replace(recipe, meta={rule: tuned}), rule)
    encoder = MetaParameters(encoder=app.init_encoder(seeded_generator()))
    result = best_state(train_phi(training, tasks, seeded_generator(), general=encoder))
    plain = rule_of(rule).initial_alpha(
        app, {key: v[0] for key, v in app.init(seeded_generator(), 1).items()}, 3, tuned.initial_adam
    )
    assert result.phi.alpha.keys() == plain.keys()
    assert not result.phi.theta
    for name, value in result.phi.alpha.items():
        if name.startswith(("out.", "in.")):
            torch.testing.assert_close(value @ value.mT, torch.eye(value.shape[-1])[None], atol=1e-4, rtol=0)
            assert value.shape[-1] == 1 or not torch.equal(value, plain[name])
    if not outer:
        assert len(result.curve) >= 1
        assert result.validation == min(error for _, _, error in result.curve)
