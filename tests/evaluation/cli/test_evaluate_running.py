"""Cells of tables that are run: their order, the time left, threads."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch

from metapp.evaluation.cell import Cell, Clock, Record, run_cells
from metapp.learning.task import Params, Task
from metapp.runs.reporter import Reporter, duration, reporting
from metapp.runs.request import Portion
from metapp.runs.surroundings import find_device, threads_of
from metapp.storage.records import RunFolder
from tests.quick import app_by


def cell(title: str, path: Path, names: list[str], log: list[str], *, steps: int, stage: int = 0) -> Cell:
    folder = RunFolder(path / title.replace(" ", "-"), {"title": title})

    def measure(missing: list[Task]) -> Iterator[tuple[Record, None]]:
        for task in missing:
            log.append(f"{title} {task.name}")
            yield {"name": task.name, "error": 1.0}, None

    return Cell(title, [Task(name, {}) for name in names], folder, measure, steps, f"run {title}", stage)


def test_cells_run_once_by_stage_and_steps(tmp_path: Path) -> None:
    log: list[str] = []
    late = cell("brdf late", tmp_path, ["a"], log, steps=0, stage=1)
    long = cell("brdf long", tmp_path, ["a", "b"], log, steps=100)
    short = cell("brdf short", tmp_path, ["a"], log, steps=1)
    assert long.folder
    long.folder.add({"name": "a", "error": 1.0})
    run_cells([late, long, short, long, short], quiet=True)
    assert log == ["brdf short a", "brdf long b", "brdf late a"]
    run_cells([late, long, short], quiet=True)
    assert len(log) == 3


def test_portions_are_disjoint_and_whole_cells_stay_whole(tmp_path: Path) -> None:
    log: list[str] = []
    divided = cell("brdf divided", tmp_path, list("abcde"), log, steps=1)
    whole = [cell(f"brdf whole{i}", tmp_path, ["x", "y"], log, steps=1)._replace(number=i) for i in range(3)]
    counts = [run_cells([divided, *whole], Portion(part, 2), quiet=True) for part in (1, 2)]
    assert counts == [3 + 4, 2 + 2]
    first, second = log[:7], log[7:]
    assert first == [*(f"brdf divided {name}" for name in "ace"), *(f"brdf whole{i} {n}" for i in (0, 2) for n in "xy")]
    assert second == ["brdf divided b", "brdf divided d", "brdf whole1 x", "brdf whole1 y"]
    assert run_cells([divided, *whole], quiet=True) == 0


def test_the_time_left_is_by_gradient_steps(tmp_path: Path) -> None:
    long = cell("brdf long", tmp_path, ["a", "b"], [], steps=99)
    other = cell("texture long", tmp_path, ["a"], [], steps=49)
    clock = Clock([(long, list(long.tasks)), (other, list(other.tasks))])
    assert clock.left() == 0
    clock.add(long, 10.0)
    assert clock.left() == pytest.approx(10.0 + 5.0)  # the other takes the mean rate as long as it has none
    clock.add(other, 1.0)
    assert clock.left() == pytest.approx(10.0)
    assert [duration(seconds) for seconds in (5, 300, 7200)] == ["5 s", "5 min", "2.0 h"]


def test_the_time_left_counts_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By a clock that stands still but for what a task takes: steps 0.1 s each, pictures 30 s where 20 were guessed."""
    now, told = [0.0], []
    monkeypatch.setattr("metapp.evaluation.cell.time.perf_counter", lambda: now[0])

    class Hears(Reporter):
        def clock(self) -> Any:
            return contextlib.nullcontext(lambda note, spent, left: told.append((note.partition(",")[0], spent, left)))

    def taking(made: Cell, seconds: float) -> Cell:
        def measure(missing: list[Task]) -> Iterator[tuple[Record, Params | None]]:
            for each in made.measure(missing):
                now[0] += seconds
                yield each

        return made._replace(measure=measure)

    fits = taking(cell("transport fit", tmp_path, ["a", "b"], [], steps=9), 1.0)
    pictures = cell("transport pictures", tmp_path, ["a", "b"], [], steps=0, stage=1)
    with reporting(Hears()):
        run_cells([fits, taking(pictures._replace(guess=20.0), 30.0)], quiet=False)
    assert told == [
        ("transport fit", 0.0, 0.0),
        ("transport fit a", 1.0, pytest.approx(1.0 + 40.0)),
        ("transport fit b", 2.0, pytest.approx(40.0)),
        ("transport pictures", 2.0, pytest.approx(40.0)),
        ("transport pictures a", 32.0, pytest.approx(30.0)),  # as measured
        ("transport pictures b", 62.0, 0.0),
    ]


def test_fits_have_the_threads_of_their_application_whatever_ran_before(tmp_path: Path) -> None:
    found: list[tuple[str, int]] = []
    before = torch.get_num_threads()

    def with_threads(name: str, threads: int | None) -> Cell:
        made = cell(name, tmp_path, ["a"], [], steps=1)

        def measure(missing: list[Task]) -> Iterator[tuple[Record, Params | None]]:
            for each in made.measure(missing):
                found.append((name, torch.get_num_threads()))
                yield each

        return made._replace(measure=measure, threads=threads)

    try:
        torch.set_num_threads(2)
        run_cells([with_threads("one", 1), with_threads("three", 3), with_threads("as it is", None)], quiet=True)
        assert found == [("one", 1), ("three", 3), ("as it is", 2)]
        assert torch.get_num_threads() == 2
        for name, expected in (("illumination", 1), ("texture", None)):
            app = app_by(name)
            find_device("cpu", app)
            assert torch.get_num_threads() == 2  # looking for a device changes nothing
            assert threads_of(app) == expected
    finally:
        torch.set_num_threads(before)
