"""`--budget`: fits stop at the last step that fits; by a clock that each step moves on."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.recipes import RECIPES
from metapp.runs import BadOption
from metapp.runs.requests.request import seconds_of, time_text
from metapp.storage.records import read_records

pytestmark = pytest.mark.usefixtures("small_spheres")
PREPARED, STEP = 0.002, 0.010  # seconds


@pytest.fixture
def steps(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[float]]:
    """A clock that only tasks and steps move on: seconds of each next step, then STEP for ever."""
    now, times = 0.0, list[float]()
    sample, prepare = Brdf().sample, Brdf().prepare

    def slow_sample(*arguments):
        nonlocal now
        now += times.pop(0) if times else STEP
        return sample(*arguments)

    def slow_prepare(task):
        nonlocal now
        now += PREPARED
        return prepare(task)

    monkeypatch.setitem(RECIPES, "quick", replace(RECIPES["quick"], overfit_steps=40))
    monkeypatch.setattr(Brdf, "sample", staticmethod(slow_sample))
    monkeypatch.setattr(Brdf, "prepare", staticmethod(slow_prepare))
    monkeypatch.setattr("metapp.learning.deadline.time", type("clock", (), {"perf_counter": lambda: now}))
    return times


@pytest.fixture
def fit(metapp: Callable, ten_materials: Path) -> Callable:
    def call(budget: str, *more: str):
        told = ("--recipe", "quick", "--data", ten_materials, "--json", *more)
        return metapp("overfit", "brdf", "--budget", budget, *told)

    return call


def test_a_fit_takes_the_steps_that_fit(fit: Callable, steps: list[float]) -> None:
    result = fit("104ms")
    assert result.code == 0, result.err
    assert result.document["budget"] == 0.104
    assert [task["steps"] for task in result.document["tasks"]] == [9, 9]
    assert result.document["seconds"] == pytest.approx(PREPARED + 9 * STEP)
    assert "took longer" not in result.err
    (file,) = Path("runs/brdf/overfit").rglob("record.jsonl")
    assert file.parent.name.endswith("-104ms")
    assert [record["steps"] for record in read_records(file)] == [9, 9]


def test_without_time_for_a_step_the_initialisation_comes_back_and_it_is_said(
    fit: Callable, steps: list[float]
) -> None:
    result = fit("1ms")
    assert result.code == 0, result.err
    assert [task["steps"] for task in result.document["tasks"]] == [0, 0]
    assert "budget: on 2 of 2 tasks even the initialisation took longer than 1ms, up to 2ms" in result.err


def test_times_are_read_with_their_unit(fit: Callable) -> None:
    for text, seconds in {"50ms": 0.05, "2s": 2, "1.5min": 90, ".5 s": 0.5, "1h": 3600}.items():
        found = seconds_of(text)
        assert found == pytest.approx(seconds), text
        assert seconds_of(time_text(found)) == pytest.approx(found), text
    assert seconds_of("") is None
    for text in ("50", "0s", "-1s", "1 day", "ms", "1e3s", "nan s"):
        with pytest.raises(BadOption, match="expected a time above 0 with its unit"):
            seconds_of(text)
        assert fit(text).misuse
