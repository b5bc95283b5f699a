"""The rule study: trainings and fits of all rules from one command."""

from __future__ import annotations

import functools
import json
import shutil
import statistics
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from benchmarks import bench_rules
from benchmarks import rule_study as studies
from benchmarks.rule_figure import rules
from benchmarks.rule_study import COMPOSED, QUICKFT, Case, Design, Study, training_for
from benchmarks.rule_table import Studied, fit_cell, train_cell
from metapp import door
from metapp.apps import recipes_of
from metapp.apps.brdf.recipes import RECIPES
from metapp.learning.names import rule_names
from metapp.learning.recipe import Adam
from metapp.learning.rules import rule as rule_table
from metapp.learning.rules import rule_of
from metapp.paradigms import tuning
from metapp.runs.requests.plan import Plan, plan
from metapp.runs.requests.request import Request
from metapp.storage.records import load_checkpoint
from tests.small_spheres import shrink_spheres

FEW = ("--train-steps", "2", "--steps", "2", "3", "--seeds", "2")
SEARCHED: Any = ([{"rate": 0.5}, {"rate": 2.0}],)


@pytest.fixture(autouse=True)
def few(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Small trainings, without a compiler, of three rules beside QuickFT."""
    quick = RECIPES["quick"]
    trainings = {rule: replace(each, tasks=2, warmup=0, validate_every=1) for rule, each in quick.meta.items()}
    general = replace(quick.general, steps=2, tasks=2, validate_every=1)
    monkeypatch.setitem(RECIPES, "quick", replace(quick, general=general, meta=trainings, batch=16))
    monkeypatch.setattr("metapp.extensions.native.fastest.can_compile", lambda: False)
    monkeypatch.setattr(tuning, "SEARCHED", SEARCHED)
    monkeypatch.setattr(studies, "rule_names", lambda: ["meta-sgd", "meta-lgd"])
    monkeypatch.setattr(studies, "COMPOSED", ("sgd", "sgd+loss", "loss+meta-sgd", "adam"))
    shrink_spheres(monkeypatch)
    return


@pytest.fixture
def data(neural_fits: Callable[[int], Path], metapp: Callable, tmp_path: Path) -> Path:
    folder = tmp_path / "materials"
    assert metapp("data", "nbrdf", neural_fits(8), "--out", folder, "--samples", "256").code == 0
    return folder


@pytest.fixture
def bench(data: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs the study; what it prints."""

    def call(*arguments: str) -> str:
        bench_rules.main(["brdf", "--data", str(data), "--out", str(tmp_path / "runs"), "--quiet", *FEW, *arguments])
        return capsys.readouterr().out

    return call


def plan_of(**options: Any) -> Plan:
    return plan(Request("brdf", "general", recipe="quick", device="cpu", quiet=True, **options))


def studied(data: Path, out: Path) -> Studied:
    return Studied(plan_of(data=data, out=out), Design(train_steps=2, steps=[2, 3], seeds=2))


# From one command


@pytest.mark.long
def test_one_command_trains_fits_and_says_what_came_of_it(bench: Callable, data: Path, tmp_path: Path) -> None:
    rows = {(row["rule"], row["steps"]): row for row in json.loads(bench("--format", "json"))["rows"]}
    names = ("quickft (tuned Adam)", "meta-sgd", "sgd+loss", "adam")  # each once; meta-lgd does not apply
    assert list(rows) == [(name, steps) for steps in (2, 3) for name in names]
    subject = studied(data, tmp_path / "runs")
    for (name, steps), row in rows.items():
        rule = name.partition(" ")[0]
        cells = [fit_cell(subject, Case(rule, steps, seed)) for seed in (0, 1)]
        errors = [[record["error"] for record in cell.records()] for cell in cells]
        assert row["error"] == pytest.approx(statistics.fmean(errors[0] + errors[1]))
        assert row["seeds"] == 2
        assert row["low"] <= row["error"] <= row["high"]
        assert errors[0] != errors[1]
        trained = [train_cell(subject, Case(rule, steps, seed)).records()[0] for seed in (0, 1)]
        assert row["validation"] == pytest.approx(statistics.fmean(each["error"] for each in trained))
        assert row["train_seconds"] == pytest.approx(statistics.fmean(each["seconds"] for each in trained))
        if rule == QUICKFT:
            assert trained[0] == trained[1]  # the search draws nothing: one is enough
            assert row["vs_quickft"] is None
        else:
            assert row["vs_quickft"] == pytest.approx(row["error"] / rows["quickft (tuned Adam)", steps]["error"])
    assert [file.name for file in (tmp_path / "runs" / "figures").iterdir()] == ["brdf-rules.png"]
    text = bench()
    for note in ("trained for 2 outer steps (the recipe: 20,000)", "meta-lgd: does not apply, no parameter lies on"):
        assert note in text
    for steps in (2, 3):  # each case is trained through its own number of steps
        prepared, info = load_checkpoint(Path(subject.study.checkpoint(Case("adam", steps, 1)).source))
        assert len(prepared.alpha["rate.w1"]) == info["inner_steps"] == steps
        assert (info["seed"], info["training"]["steps"]) == (1, 2)
        adam = subject.study.checkpoint(Case(QUICKFT, steps, 1)).prepared
        assert adam.encoder
        assert set(adam.alpha) == {"rate", "beta1", "beta2", "eps", "final"}
    drawn = rules(subject)
    assert drawn
    assert [axis.get_title() for axis in drawn.figure.axes] == ["2 steps", "3 steps"]
    shutil.rmtree(tmp_path / "runs" / "brdf" / "rules")
    assert rules(subject) is None


def test_a_training_that_diverges_is_said_once_and_ends_nothing(
    bench: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    train, tried = Study.train, []

    def diverging(self: Study, case: Case) -> Any:
        tried.append(case)
        if case.rule == "adam":
            raise FloatingPointError("m0: the loss is not finite at step 1.")
        return train(self, case)

    monkeypatch.setattr(Study, "train", diverging)
    assert {row["rule"] for row in json.loads(bench("--format", "json"))["rows"]} == {
        "quickft (tuned Adam)",
        "meta-sgd",
        "sgd+loss",
    }
    count = len(tried)
    text = bench()
    assert len(tried) == count
    assert "2 steps: training diverged: adam" in text


# What is studied


def test_new_names_of_rules_are_studied(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    study = functools.partial(Study, plan_of(), Design())
    rules = study().rules
    assert [rule_of(name).name for name in COMPOSED] == list(COMPOSED)
    assert set(rules) == ({rule_of(name).name for name in (*rule_names(), *COMPOSED)}) - {"meta-lgd", "ridge"}
    # of its own, so that other tests find the rules that there were
    monkeypatch.setattr(rule_table, "_composed", functools.cache(rule_table._composed.__wrapped__))
    with door.extended("new", [door.Rule("meta-new", "rates+betas+eps")]):
        assert "meta-new" in study().rules


def test_rules_without_moments_are_trained_as_the_papers() -> None:
    recipe = RECIPES["quick"]
    assert training_for(recipe, "sgd+loss") is recipe.meta["meta-sgd"]
    assert training_for(recipe, "rates+loss").first == Adam(0.1)
    assert training_for(recipe, "adam+curvature") is recipe.meta["meta-curvature"]
    assert training_for(recipe, "adam+loss") is recipe.meta["meta-curvature"]
    no_sgd = recipes_of("illumination")["quick"]
    assert training_for(no_sgd, "meta-sgd") == replace(no_sgd.meta[no_sgd.rule], tuned=True)
    assert training_for(no_sgd, "adam") is no_sgd.meta[no_sgd.rule]


def test_cases_of_few_steps_come_first() -> None:
    cases = Study(plan_of(seed=4), Design(steps=(9, 2), seeds=2, rule="adam")).cases()
    assert cases == [Case(rule, steps, seed) for seed in (4, 5) for steps in (2, 9) for rule in (QUICKFT, "adam")]
