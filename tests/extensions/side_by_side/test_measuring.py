"""Tables measured by processes: what is foreseen, the order of jobs, rows as they come, and going on."""

from __future__ import annotations

import heapq
import json
from collections.abc import Callable
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from metapp.cli.evaluate import Evaluation, subjects_of
from metapp.evaluation.cell import Cell
from metapp.evaluation.subject import FEW, Subject
from metapp.evaluation.tables import load_table
from metapp.extensions.side_by_side import measuring
from metapp.extensions.side_by_side.measuring import Job, Pace, _Measuring, _minutes
from metapp.runs.reporter import Reporter, reporting
from metapp.runs.requests.plan import plan
from metapp.runs.requests.request import Request
from metapp.storage.records import read_records


class Heard(Reporter):
    """Keeps what is said."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def say(self, message: str) -> None:
        self.lines.append(message)


def subject_of(app: str, out: Path, data: Path | None = None, *, whole: bool = False) -> Subject:
    return Subject(
        plan(Request(app, "general", recipe="quick", data=data, out=out, device="cpu", quiet=True)),
        run=True,
        strict=True,
        whole=whole,
    )


def measuring_of(subjects: list[Subject], paces: list[Pace], tables: tuple[str, ...] = ("results",)) -> _Measuring:
    pool: Any = SimpleNamespace()
    found = _Measuring(subjects, tables, pool, 2, quiet=False)
    found.paces, found.began = paces, 0.0
    return found


def test_short_jobs_come_first_then_the_longest_and_stages_after_each_other() -> None:
    orders = {"set": (0, False, 9.0), "short": (0, False, 2.0), "long": (0, True, 20.0), "longer": (0, True, 90.0)}
    jobs = [
        (Job(stage, (long, -seconds if long else seconds), seconds, 0), name)
        for name, (stage, long, seconds) in (orders | {"picture": (1, False, 0.1)}).items()
    ]
    heapq.heapify(jobs)
    assert [heapq.heappop(jobs)[1] for _ in range(5)] == ["short", "set", "longer", "long", "picture"]


def test_a_stage_waits_for_the_one_before(tmp_path: Path) -> None:
    found = measuring_of([], [])
    first, second = Job(0, (False, 1.0), 1.0, 0), Job(1, (False, 1.0), 1.0, 0)
    found.waiting = [second]
    assert not found._next_can_begin([first])
    assert found._next_can_begin([second])
    assert not found._next_can_begin([second, second])  # both processes have work
    found.waiting = []
    assert not found._next_can_begin([])


def test_what_a_table_takes_is_steps_times_what_a_step_takes(data: Path, tmp_path: Path) -> None:
    subject, heard = subject_of("brdf", tmp_path, data), Heard()
    pace = Pace(step=0.01, rest=0.5, data=0.0)
    found = measuring_of([subject], [pace])
    with reporting(heard):
        found.foresee()
    steps = {name: fit.steps for name, fit in subject.fits.items()}
    assert found.total == pytest.approx(sum(FEW * (0.5 + 0.01 * count) for count in steps.values()))
    assert heard.lines[0].startswith(f"{3 * len(steps)} fits of {len(steps)} rows have no record yet: about 6 min in 2")
    assert heard.lines[1].startswith(f"Overfit and Finetune are fitted to {FEW} tasks")
    assert len(heard.lines) == 2  # no set to make
    assert (_minutes(89.0), _minutes(91.0), _minutes(600.0)) == ("under 2 min", "about 2 min", "about 10 min")
    found.add_cells(0)
    folder = subject.cell("overfit").folder
    assert folder
    of_overfit = [job for job in found.waiting if job.cell == folder.path]
    assert [len(job.tasks) for job in of_overfit] == [1, 1, 1]  # of 200 s each
    assert sum(job.seconds for job in found.waiting) == pytest.approx(found.total)


def test_sets_that_must_be_made_are_named_with_their_tasks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("METAPP_CACHE", str(tmp_path / "cache"))
    subjects, heard = [subject_of("brdf", tmp_path), subject_of("transport", tmp_path)], Heard()
    assert not any(map(measuring.made, subjects))
    found = measuring_of(subjects, [Pace(0.001, 0.0, 30.0), Pace(0.01, 0.0, 60.0)])
    with reporting(heard):
        found.foresee()
    assert heard.lines[0] == "data sets to make, once, and their tasks: brdf (100), transport (48)"
    counts = {0: 20, 1: 8}  # test tasks
    fits = sum(
        len(evenly) * (fit.steps * (0.001, 0.01)[i])
        for i, subject in enumerate(subjects)
        for fit in subject.fits.values()
        for evenly in (range(FEW if fit.steps > 30 else counts[i]),)
    )
    assert found.total == pytest.approx(90.0 + fits)
    assert not (tmp_path / "cache").exists()  # nothing was made to say so


def test_a_process_that_is_killed_is_an_error_of_one_line(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def dies(self: _Measuring) -> None:
        raise BrokenProcessPool

    monkeypatch.setattr(_Measuring, "run", dies)
    monkeypatch.setattr(measuring, "SMALL", 0)
    with pytest.raises(OSError, match=r"a process ended by itself.*give the command again: it goes on"):
        measuring.measure([subject_of("brdf", tmp_path, data)], [load_table("quickft")], quiet=True)


def test_few_steps_are_taken_without_further_processes(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(measuring, "ProcessPoolExecutor", None)
    subject = subject_of("brdf", tmp_path, data)
    measuring.measure([subject], [load_table("quickft")], quiet=True)
    assert subject.cell("meta").whole


def test_an_application_without_what_its_checkpoints_need_is_left_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("METAPP_CACHE", str(tmp_path))
    monkeypatch.setattr("metapp.apps.app_names", lambda: ["texture", "transport"])
    heard = Heard()
    with reporting(heard):
        assert [one.app.name for one in subjects_of(Evaluation(out=tmp_path))] == ["transport"]
    (line,) = heard.lines
    assert line.startswith("Texture is left out: ")
    assert "metapp data vgg" in line
    with pytest.raises(ValueError, match="metapp data vgg"):
        subjects_of(Evaluation(["texture"], out=tmp_path))


@pytest.mark.long
def test_two_processes_measure_what_one_does_and_go_on(
    metapp: Callable[..., Any], data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    common = ("evaluate", "brdf", "--table", "--which", "quickft", "--data", data)
    one = metapp(*common, "--out", tmp_path / "one", "--json")
    monkeypatch.setattr(measuring, "SMALL", 0)
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    both = metapp(*common, "--out", tmp_path / "two", "--json")
    assert (one.code, both.code) == (0, 0), both.err
    lines = both.err.splitlines()
    assert lines[1] == "timing a step of BRDF"
    assert lines[2].startswith("9 fits of 3 rows have no record yet: under 2 min in 2 processes")
    assert sorted(line.partition(":")[0] for line in lines[4:7]) == ["brdf general", "brdf meta", "brdf quickft"]
    for ours, theirs in zip(both.document["rows"], one.document["rows"], strict=True):
        assert ours["error"] == pytest.approx(theirs["error"], rel=1e-5)
        assert f"brdf {ours['paradigm']}: error {ours['error']:.3f}, " in both.err
        assert (ours["processes"], theirs["processes"]) == (2, 1)
    assert "seconds of 2 fits side by side" in metapp(*common, "--out", tmp_path / "two", "--no-run").out
    # goes on at the record that is missing
    (file,) = (tmp_path / "two").glob("brdf/meta/*/record.jsonl")
    kept = file.read_text().splitlines(keepends=True)
    file.write_text("".join(kept[:2]))
    before = {record["name"] for record in read_records(file)}
    again = metapp(*common, "--out", tmp_path / "two", "--json")
    assert "1 fits of 1 rows have no record yet" in again.err
    assert [json.loads(line) for line in file.read_text().splitlines()[:2]] == [json.loads(line) for line in kept[:2]]
    assert len(read_records(file)) == 3 > len(before)
    assert [row["error"] for row in again.document["rows"]] == pytest.approx(
        [row["error"] for row in both.document["rows"]], rel=1e-5
    )


def test_cells_are_timed_by_their_steps() -> None:
    cell = Cell("brdf x", [], None, lambda tasks: iter(()), 20)
    assert Pace(0.5, 2.0, 100.0).of(cell) == 12.0
