"""`--watch`: one picture that is rewritten as steps go by, whose time does not count."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from PIL import Image

from metapp.apps.brdf.app import Brdf
from metapp.learning.deadline import Stopwatch
from metapp.learning.learn import Step
from metapp.learning.task import Task
from metapp.runs import watching
from metapp.runs.watching import Watched

pytestmark = pytest.mark.usefixtures("small_spheres")


def test_a_watched_fit_is_the_same_and_leaves_its_last_picture(
    metapp: Callable, ten_materials: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    titles = []
    write = watching.write_sheet
    monkeypatch.setattr(
        watching, "write_sheet", lambda tasks, title, *more: (titles.append(title), write(tasks, title, *more))
    )
    monkeypatch.setattr(watching, "EVERY", 0.0)
    told = ("overfit", "brdf", "--steps", "3", "--data", ten_materials, "--json", "--out")
    plain, watched = metapp(*told, Path("plain")), metapp(*told, Path("watched"), "--watch")
    errors = [[task["error"] for task in run.document["tasks"]] for run in (plain, watched)]
    assert errors[0] == errors[1]
    picture = Path(watched.document["out"]) / "watch.png"
    assert f"watch: {picture}; the time that it takes" in watched.err
    assert Image.open(picture).size[1] > 2 * watching.SIDE  # the reference above the fit
    assert titles[0] == "BRDF, overfit: step 0 of 3"
    assert titles[-1] == "BRDF, overfit: after 3 steps"
    assert not list(picture.parent.glob(".partial*"))


def test_pictures_come_at_most_so_often_and_the_last_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    now, drawn = 100.0, []
    monkeypatch.setattr(watching, "time", type("clock", (), {"monotonic": lambda: now}))
    monkeypatch.setattr(watching, "write_sheet", lambda tasks, title, *_: drawn.append((now, title)))
    monkeypatch.setattr(watching, "presentation_of", lambda app: type("none", (), {"outputs": lambda *_: {}}))
    watched = Watched(Brdf(), "meta", Path("watch.png"))
    descent = (Step(step, {}, {}) for step in range(40))
    for _ in watched.shown(descent, Task("gold", {}), 40, Stopwatch(torch.device("cpu"))):
        now += 0.03
    times = [time for time, _ in drawn]
    assert len(times) == 5
    assert all(after - before >= watching.EVERY for before, after in itertools.pairwise(times))
    watched.finish()
    watched.finish()
    assert drawn[5:] == [(now, "BRDF, meta: step 39 of 40")]


def test_time_of_pictures_does_not_count(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 5.0
    monkeypatch.setattr("metapp.learning.deadline.time", type("clock", (), {"perf_counter": lambda: now}))
    clock = Stopwatch(torch.device("cpu"))
    now += 1.0
    with clock.paused():
        now += 10.0
    now += 0.5
    assert clock() == pytest.approx(1.5)
