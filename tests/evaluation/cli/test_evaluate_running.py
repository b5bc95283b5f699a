"""Cells of tables that are run: their order, progress, threads, and what is left out."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch

from metapp.cli.evaluate import Evaluation, subjects_of
from metapp.evaluation.cell import Cell, run_cells
from metapp.learning.task import Task
from metapp.runs.reporter import Bar
from metapp.runs.surroundings import find_device, threads_of
from metapp.storage.fits import Fits, Record
from tests.quick import app_by

Make = Callable[..., Cell]


@pytest.fixture
def log() -> list[str]:
    """What was measured, in order."""
    return []


@pytest.fixture
def cell(tmp_path: Path, log: list[str]) -> Make:
    """A cell of tasks with one letter, which logs them; `during` is called for each."""

    def make(title: str, names: str, steps: int = 1, during: Callable[[], None] = lambda: None, **more: Any) -> Cell:
        def measure(tasks: list[Task]) -> Iterator[tuple[Record, None]]:
            for task in tasks:
                log.append(f"{title} {task.name}")
                during()
                yield {"name": task.name, "error": 1.0}, None

        fits = Fits(tmp_path / title.replace(" ", "-"), {"title": title})
        return Cell(title, [Task(name, {}) for name in names], fits, measure, steps, **more)

    return make


def test_cells_run_once_by_stage_and_steps(cell: Make, log: list[str]) -> None:
    late, long, short = cell("brdf late", "a", 0, stage=1), cell("brdf long", "ab", 100), cell("brdf short", "a", 1)
    assert long.fits
    long.fits.write({"name": "a", "error": 1.0})
    run_cells([late, long, short, long, short], quiet=True)
    assert log == ["brdf short a", "brdf long b", "brdf late a"]
    run_cells([late, long, short], quiet=True)
    assert len(log) == 3


def test_the_progress_counts_gradient_steps(cell: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    lines: list[tuple[int, int | None, str]] = []
    monkeypatch.setattr(Bar, "at", lambda _, *line: lines.append(line))
    run_cells([cell("brdf long", "ab", 99), cell("texture short", "a", 9)], quiet=True)
    assert lines == [
        (0, 210, "texture short, cell 1 of 2"),
        (10, 210, "texture short a, cell 1 of 2"),
        (10, 210, "brdf long, cell 2 of 2"),
        (110, 210, "brdf long a, cell 2 of 2"),
        (210, 210, "brdf long b, cell 2 of 2"),
    ]


def test_fits_have_the_threads_of_their_application_whatever_ran_before(cell: Make) -> None:
    counts: list[int] = []
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        for i, threads in enumerate((1, 3, None)):
            run_cells(
                [cell(f"{i}", "a", 1, lambda: counts.append(torch.get_num_threads()), threads=threads)], quiet=True
            )
        find_device("cpu", app_by("illumination"))  # looking for a device changes nothing
        assert [*counts, torch.get_num_threads()] == [1, 3, 2, 2]
    finally:
        torch.set_num_threads(before)
    assert (threads_of(app_by("illumination")), threads_of(app_by("texture"))) == (1, None)


def test_an_application_without_what_its_checkpoints_need_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("METAPP_CACHE", str(tmp_path))
    monkeypatch.setattr("metapp.apps.app_names", lambda: ["texture", "transport"])
    lines: list[str] = []
    monkeypatch.setattr("metapp.cli.evaluate.say", lines.append)
    assert [one.app.name for one in subjects_of(Evaluation(out=tmp_path))] == ["transport"]
    (line,) = lines
    assert line.startswith("Texture is left out: ")
    assert "metapp data vgg" in line
    with pytest.raises(ValueError, match="metapp data vgg"):
        subjects_of(Evaluation(["texture"], out=tmp_path))
