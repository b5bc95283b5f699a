"""The search of an Adam on validation tasks."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch

from metapp.apps import recipes_of
from metapp.learning.app import App
from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import Adam
from metapp.learning.task import Tasks
from metapp.paradigms import Paradigm, training
from metapp.paradigms.meta import Meta
from metapp.paradigms.quickft import QuickFT
from metapp.rules import rule_of
from tests.paradigms.small import result, rng
from tests.quick import app_by

# The search of QuickFT's Adam, on errors in closed form


GENERAL = MetaParameters(encoder={"w": torch.ones(2)})
TASKS = Tasks(tuple("abcd"), {}, torch.arange(4))
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


class Search:
    """A search from an Adam on that is told errors in closed form, and what it looked at."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, first: Adam, error: Callable[[Adam], float] = bowl) -> None:
        self.quickft = QuickFT(app_by("brdf"), replace(recipes_of("brdf")["quick"], quickft=first))
        self.looked: list[Adam] = []

        def told(paradigm: Paradigm, prepared: MetaParameters, tasks: Any) -> float:
            assert paradigm is self.quickft
            self.looked.append(self.quickft.adam(prepared))
            return error(self.looked[-1])

        monkeypatch.setattr(training, "validation_error", told)
        self.path = list(training.prepare(self.quickft, TASKS, rng(), general=GENERAL))
        self.tuned = result(self.path)
        self.found = self.quickft.adam(self.tuned.phi)


@pytest.mark.parametrize(
    "first", [Adam(1e-2), Adam(5e-2, 0.9, 0.99, 1e-8, 0.0), Adam(1.0, 0.3, 0.8), Adam(2e-3, 0.9, 0.999, 1e-3)]
)
def test_the_search_finds_the_best_adam(first: Adam, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also from a rate that is 25 times too small or 20 times too large; the rate to a third of its grid's step."""
    search = Search(monkeypatch, first)
    found = search.found
    assert (found.beta1, found.beta2, found.final) == (BEST.beta1, BEST.beta2, BEST.final)
    assert found.eps == pytest.approx(BEST.eps)
    assert abs(math.log2(found.rate / BEST.rate)) < 1 / 6
    assert search.tuned.validation == pytest.approx(bowl(found))


def test_the_search_goes_on_around_the_best_so_far(monkeypatch: pytest.MonkeyPatch) -> None:
    """One line of choices at a time changes its own quantities, and those before it stay at their best."""
    first = Adam(0.05, 0.9, 0.999, 1e-8, 1.0)
    search = Search(monkeypatch, first)
    looked, lines = search.looked, [len(line) for line in training.SEARCHED]
    assert (looked[0], len(looked)) == (first, 1 + sum(lines))
    for i, now in enumerate(search.path, 1):
        assert (now.step, now.total, now.searched) == (i, len(looked), tuple(map(bowl, looked[:i])))
        assert f"rate {looked[i - 1].rate:.1e}, validation" in now.note
        best, found = min(looked[:i], key=bowl), result([now])
        assert search.quickft.adam(found.phi) == best == looked[found.best_step - 1]
        assert found.validation == found.curve[-1][2] == bowl(best)
    for each in looked[1 : 1 + lines[0]]:
        assert replace(each, rate=first.rate) == first
    for each in looked[1 + sum(lines[:2]) : sum(lines)]:
        assert (each.beta1, each.beta2) == (BEST.beta1, BEST.beta2)
    errors = [error for _, _, error in search.tuned.curve]
    assert errors == sorted(errors, reverse=True)


def test_a_recipe_that_nothing_beats_is_kept_and_one_that_diverges_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    first = Adam(0.0123, 0.77, 0.95, 3e-5, 0.2)
    for error in (lambda adam: 1.0, lambda adam: 0.5 if adam == first else math.inf):
        search = Search(monkeypatch, first, error)
        assert search.found == first
        assert (search.tuned.best_step, len(search.tuned.curve)) == (1, 1)
    search = Search(monkeypatch, Adam(10.0), lambda adam: bowl(adam) if adam.rate < 3 else math.inf)
    assert math.isfinite(search.tuned.validation)
    assert search.found.rate < 3


@pytest.mark.parametrize(("name", "count"), [("brdf", 30), ("texture", 8), ("svbrdf_stationary", 8)])
def test_searches_look_at_all_validation_tasks_where_fits_are_cheap(
    name: str, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    quickft = QuickFT(app_by(name), recipes_of(name)["quick"])
    names = tuple(f"{i:03d}" for i in range(240))
    looked: list[int] = []

    def told(paradigm: Paradigm, prepared: MetaParameters, tasks: Tasks) -> float:
        looked.append(len(tasks))
        return 1.0

    monkeypatch.setattr(training, "validation_error", told)
    data = Tasks(names, {}, torch.arange(240))
    assert len(list(training.prepare(quickft, data, rng(), general=GENERAL, steps=3))) == 3
    assert looked == [count] * 3


@pytest.mark.parametrize("app", ["texture"], indirect=True)
@pytest.mark.parametrize("outer", [0, 2])
@pytest.mark.parametrize("rule", ["meta-axes", "meta-basis"])
def test_a_rule_is_tuned_as_quickft_is(
    rule: str, outer: int, app: App, fits: dict[str, Paradigm], tasks: Tasks, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its Adam is searched on validation tasks, in the bases of the training tasks; outer steps go on from there."""
    monkeypatch.setattr(training, "SEARCHED", ([{"rate": 0.5}, {"rate": 2.0}], [{"beta1": 0.3, "rate": 1.0}]))
    recipe = fits["meta"].recipe
    tuned = replace(recipe.meta[rule], initialisation="encoder", tuned=True, steps=outer)
    meta = Meta(app, replace(recipe, meta={rule: tuned}), rule)
    encoder = MetaParameters(encoder=app.init_encoder(rng()))
    made = result(training.prepare(meta, tasks, rng(), general=encoder))
    plain = rule_of(rule).alpha(app, {key: v[0] for key, v in app.init(rng(), 1).items()}, 3, tuned.first)
    assert made.phi.alpha.keys() == plain.keys()
    assert not made.phi.theta
    for name, value in made.phi.alpha.items():
        if name.startswith(("out.", "in.")):
            torch.testing.assert_close(value @ value.mT, torch.eye(value.shape[-1])[None], atol=1e-4, rtol=0)
            assert value.shape[-1] == 1 or not torch.equal(value, plain[name])
    if not outer:
        assert len(made.curve) >= 1
        assert made.validation == min(error for _, _, error in made.curve)
