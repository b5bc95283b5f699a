"""Preparation on training tasks: what is kept, what it goes on from, what it never sees."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from typing import Any

import pytest
import torch

from metapp.learning.app import App
from metapp.learning.learn import MetaParameters
from metapp.learning.task import Tasks
from metapp.paradigms import Paradigm, training
from metapp.paradigms.meta import Meta
from metapp.paradigms.training import TrainState, prepare, preparing, split_validation, validation_error
from tests.marked import long
from tests.paradigms.small import ONE_QUICK, OWN_RULES, PAIRS, prepared_for, result, rng

ONE_APP = pytest.mark.parametrize("app", ["brdf"], indirect=True)  # what no application changes


def test_split_keeps_tasks_apart(tasks: Tasks) -> None:
    fit, validate = split_validation(tasks)
    names = tasks.selected_names
    assert set(validate.selected_names) == set(sorted(names)[3::8])
    assert fit.selected_names == tuple(name for name in names if name not in validate.selected_names)
    with pytest.raises(ValueError, match="training set: 3 tasks that show 3 things, expected at least 4"):
        split_validation(tasks.select([0, 1, 2]))


def test_split_keeps_photos_of_one_thing_together() -> None:
    """Whatever their order; and sorting spreads the validation tasks over families that take turns."""
    names = tuple(f"{i:02d}-{photo}" for photo in range(3) for i in range(12))
    groups = tuple(name.split("-")[0] for name in names)
    fit, validate = split_validation(Tasks(names, {}, torch.arange(36), groups))
    assert {name.split("-")[0] for name in validate.selected_names} == {"03", "11"}
    assert (len(fit), len(validate)) == (30, 6)
    turns = tuple(f"{'abcd'[i % 4]}-{i:02d}" for i in range(64))
    _, validate = split_validation(Tasks(turns, {}, torch.arange(64)))
    assert {name[0] for name in validate.selected_names} == set("abcd")


@pytest.mark.parametrize("app", ["brdf"], indirect=True)
def test_validation_counts_kinds_alike(app: App, fits: dict[str, Paradigm], tasks: Tasks) -> None:
    """One material of another kind counts as much as all others."""
    general, start = fits["general"], MetaParameters(encoder=app.init_encoder(rng(0)))
    apart = [validation_error(general, start, tasks.select(rows)) for rows in ([0], range(1, len(tasks)))]
    kinds = torch.tensor([[i == 0] for i in range(len(tasks.names))])
    mixed = replace(tasks, data=tasks.data | {"kind": kinds})
    # what the encoder reads is drawn for all tasks at once
    assert validation_error(general, start, mixed) == pytest.approx(sum(apart) / 2, rel=1e-3)
    assert validation_error(general, start, tasks) != pytest.approx(sum(apart) / 2, rel=1e-2)


OTHERS = ("illumination", "svbrdf_nonstationary", "svbrdf_stationary", "texture", "transport")
EVERY = pytest.mark.parametrize(
    ("app", "name"),
    [*((app, "general") for app in OWN_RULES), *(long(*pair) if pair[0] in OTHERS else pair for pair in PAIRS)],
    indirect=["app"],
)


@pytest.fixture
def trained(name: str, fits: dict[str, Paradigm]) -> Paradigm:
    """What prepares the checkpoint of a name."""
    return preparing(fits["meta"], name)


def look(paradigm: Paradigm, tasks: Tasks, **options: Any) -> TrainState:
    return result(prepare(paradigm, tasks, rng(3), **options))


@EVERY
def test_the_best_state_is_kept(trained: Paradigm, tasks: Tasks) -> None:
    prepared = look(trained, tasks)
    steps, losses, errors = zip(*prepared.curve, strict=True)
    assert steps == (0, 2, 4, 6)
    assert prepared.validation == min(errors) <= errors[0]
    assert steps[errors.index(min(errors))] == prepared.best_step
    assert losses[0] is None
    assert all(loss is not None and math.isfinite(loss) for loss in losses[1:])
    validation = split_validation(tasks)[1]
    assert math.isclose(validation_error(trained, prepared.phi, validation), prepared.validation, rel_tol=1e-6)
    again = look(trained, tasks)
    assert again.curve[1:] == prepared.curve[1:]
    assert all(torch.equal(again.phi.flat()[key], value) for key, value in prepared.phi.flat().items())


@ONE_APP
@pytest.mark.parametrize("name", ["general", "meta-sgd"])
def test_a_start_that_only_gets_worse_is_kept(trained: Paradigm, tasks: Tasks, monkeypatch: pytest.MonkeyPatch) -> None:
    """Iteration 0 is among the states to choose from, and it is not written to afterwards."""
    before, errors = look(trained, tasks, steps=0), itertools.count(1)
    monkeypatch.setattr(training, "validation_error", lambda *_: float(next(errors)))
    prepared = look(trained, tasks)
    assert (prepared.best_step, prepared.validation) == (0, 1.0)
    assert [error for _, _, error in prepared.curve] == [1.0, 2.0, 3.0, 4.0]
    assert all(torch.equal(prepared.phi.flat()[key], value) for key, value in before.phi.flat().items())


@pytest.mark.parametrize("app", ONE_QUICK, indirect=True)
@pytest.mark.parametrize(("name", "steps", "rate"), [("general", 100, 2e-3), ("meta-curvature", 30, 2e-2)])
def test_preparing_improves_what_it_is_prepared_for(
    name: str, steps: int, rate: float, trained: Paradigm, tasks: Tasks
) -> None:
    """By a share of the error's size: errors may be negative."""
    longer = replace(trained.training, steps=steps, rates={"": rate}, validate_every=10)
    changed: dict[str, Any] = {"general": longer} if name == "general" else {"meta": {name: longer}}
    prepared = look(replace(trained, recipe=replace(trained.recipe, **changed)), tasks)
    first = prepared.curve[0][2]
    assert first - prepared.validation > 0.1 * abs(first)


def meta_by(meta: Paradigm, **settings: Any) -> Paradigm:
    """Meta with other settings of its training."""
    recipe = meta.recipe
    return Meta(meta.app, replace(recipe, meta={recipe.rule: replace(recipe.meta[recipe.rule], **settings)}))


def test_meta_starts_from_the_mean_of_general_or_at_random(app: App, fits: dict[str, Paradigm], tasks: Tasks) -> None:
    """At random where it is told to, and where there is no General."""
    encoder = prepared_for(fits["general"])
    predicted = fits["general"].fit(encoder, split_validation(tasks)[0], rng(3))
    mean = {key: value.mean(0) for key, value in predicted.items()}
    random = {key: value[0] for key, value in app.init(rng(3), 1).items()}
    for start, given, expected in (("mean", encoder, mean), ("random", encoder, random), ("mean", None, random)):
        phi = look(meta_by(fits["meta"], initialisation=start), tasks, general=given, steps=0).phi
        assert not phi.encoder
        for key, value in expected.items():
            if expected is mean:
                torch.testing.assert_close(phi.theta[key], value)
            else:
                assert torch.equal(phi.theta[key], value)


@pytest.mark.parametrize("app", ONE_QUICK, indirect=True)
def test_meta_goes_on_from_general(fits: dict[str, Paradigm], tasks: Tasks) -> None:
    """The encoder itself is then trained through the steps, beside the rule, and another checkpoint there is none."""
    encoder, meta = prepared_for(fits["general"]), meta_by(fits["meta"], initialisation="encoder")
    first = look(meta, tasks, general=encoder, steps=0).phi
    assert not first.theta
    assert all(torch.equal(first.encoder[key], value) for key, value in encoder.encoder.items())
    meta = meta_by(meta, steps=20, rates={"": 1e-3}, validate_every=5)
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
def test_training_never_sees_a_validation_task(
    trained: Paradigm, tasks: Tasks, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the data of the validation tasks spoilt, the training loss stays finite."""
    rows = split_validation(tasks)[1].rows
    spoilt = {}
    for key, value in tasks.data.items():
        own = value.stride(0) != 0  # what all tasks share is no task's
        spoilt[key] = value.float().index_fill(0, rows, math.nan) if own else value
    monkeypatch.setattr(training, "validation_error", lambda *_: 1.0)
    prepared = look(trained, Tasks(tasks.names, spoilt, tasks.rows), steps=12)
    assert all(loss is not None and math.isfinite(loss) for _, loss, _ in prepared.curve[1:])
