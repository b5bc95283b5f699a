"""`--watch`: the page that follows a fit, whose time does not count."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from metapp.apps.brdf.app import Brdf
from metapp.extensions.viewer import watching
from metapp.extensions.viewer.view import View
from metapp.extensions.viewer.watching import Watched
from metapp.learning.deadline import Stopwatch
from metapp.learning.learn import Step
from metapp.learning.task import Task

pytestmark = pytest.mark.usefixtures("small_spheres")


def test_a_watched_fit_is_the_same(metapp: Callable, ten_materials: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(watching, "EVERY", 0.0)
    told = ("overfit", "brdf", "--steps", "3", "--data", ten_materials, "--json", "--out")
    plain, watched = metapp(*told, Path("plain")), metapp(*told, Path("watched"), "--watch")
    errors = [[task["error"] for task in run.document["tasks"]] for run in (plain, watched)]
    assert errors[0] == errors[1]


def test_the_page_is_drawn_at_most_so_often_and_the_last_step_is(monkeypatch: pytest.MonkeyPatch) -> None:
    now, drawn = 100.0, []

    class Page:
        """Takes the place of the server."""

        address = "http://127.0.0.1"

        def tell(self, document: dict, text: str, curve: list, *, done: bool = False) -> None:
            drawn.append((now, document["title"], text, done))

    monkeypatch.setattr(watching, "time", type("clock", (), {"monotonic": lambda: now}))
    monkeypatch.setattr(watching, "Live", Page)
    monkeypatch.setattr(watching, "view_of", lambda *_, quick: View("pictures"))
    watched = Watched(Brdf(), "meta")
    descent = (Step(step, {}, {}) for step in range(40))
    for _ in watched.follow(descent, Task("gold", {}), 40, Stopwatch(torch.device("cpu"))):
        now += 0.03
    times = [time for time, *_ in drawn]
    assert len(times) == 5
    assert all(after - before >= watching.EVERY for before, after in itertools.pairwise(times))
    watched.finish()
    last = "step 39 of 40"
    assert drawn[5:] == [(now, "BRDF, meta", last, False), (now, "BRDF, meta", f"{last}; the fit is over", True)]


def test_time_of_pictures_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 5.0
    monkeypatch.setattr("metapp.learning.deadline.time", type("clock", (), {"perf_counter": lambda: now}))
    clock = Stopwatch(torch.device("cpu"))
    now += 1.0
    with clock.paused():
        now += 10.0
    now += 0.5
    assert clock() == pytest.approx(1.5)
