"""Tables of `metapp evaluate`: all rows in every format, what they compare, and runs that were killed."""

import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from metapp.cli.evaluation_output import make_rich_table
from metapp.evaluation.evaluation_run import LONG_FIT_TASKS, EvaluationRun
from metapp.evaluation.table import filled_columns
from metapp.learning.app import stack_tasks
from metapp.registry import registry
from metapp.runs.fitting import fit_tasks_of
from tests.evaluation.cli.evaluation_runs import table_rows

KEYS = {"app", "paradigm", "error", "seconds", "tasks", "low", "high", "paper_error", "paper_seconds"}


def test_all_tables_have_all_rows_in_every_format(evaluate: Callable, evaluated_folder: Path) -> None:
    empty = evaluate("--which", "all", "--no-run", "--json")
    assert empty.code == 0, empty.err
    assert all(row["error"] is None for row in empty.json_document["rows"])
    (line, remedy) = empty.err.splitlines()
    total = line.split()[3]
    assert line.startswith(f"brdf: {total} of {total} records missing: general, ")
    assert remedy == "the same command without --no-run measures them"
    common = ("--out", evaluated_folder / "runs", "--no-run")
    full = evaluate(*common, "--which", "all", "--json")
    assert full.code == 0, full.err
    assert "missing" not in full.err
    assert full.json_document["which"] == "all"
    rows = full.json_document["rows"]
    assert {row["table"] for row in rows} == set(registry().tables)
    assert all(set(row) >= KEYS for row in rows)
    for row in (row for row in rows if row["table"] not in ("storage", "samples")):
        assert row["low"] <= row["error"] <= row["high"], row
        has_few = row["paradigm"] == "overfit" or row["table"] in ("convergence", "image")
        assert row["tasks"] == (LONG_FIT_TASKS if has_few else 3), row
    for name in registry().tables:
        one = evaluate(*common, "--which", name, "--json").json_document
        assert one["which"] == name
        assert [row | {"table": name} for row in one["rows"]] == [row for row in rows if row["table"] == name]
    for form, mark in (("rich", "BRDF"), ("markdown", "| --- |"), ("latex", r"\bottomrule"), ("csv", "app,")):
        shown = evaluate(*common, "--which", "all", "--format", form)
        assert shown.code == 0, shown.err
        assert shown.out.count(mark) >= (1 if form == "csv" else len(registry().tables))


def test_rows_are_compared_with_quickft_and_general_on_the_same_tasks(evaluation_run: EvaluationRun) -> None:
    found = {row["paradigm"]: row for row in table_rows(evaluation_run, "results")}
    ours, theirs = ([fit.error for fit in evaluation_run.fits(name)] for name in ("meta", "quickft"))
    pair = found["meta"]["vs_quickft"]
    assert pair
    assert pair.low <= pair.value <= pair.high
    assert pair.value == pytest.approx(sum(ours) / sum(theirs))
    assert pair[3:] == (sum(a < b for a, b in zip(ours, theirs, strict=True)), 3, 3, "ratio")
    assert found["quickft"]["vs_quickft"] is None
    assert found["quickft"]["vs_general"].value < 1
    quickft = table_rows(evaluation_run, "quickft")[2]
    assert quickft["vs_quickft"] == pair
    assert quickft["apart"] is None  # too few tasks
    assert "too few to call a win" in " ".join(evaluation_run.table("quickft").findings)


def test_fits_that_carry_a_warning_are_counted(evaluation_run: EvaluationRun) -> None:
    warnings = {1: "the visible loss rose from 1 to 2", 2: "the visible loss rose from 1 to 2; blobs", 0: "keeps 0.1"}
    for i, record in enumerate(evaluation_run.fits("meta")):
        record.threads, record.warning = 1, warnings.get(i, record.warning)
    for name in ("results", "quickft", "ablation"):
        found = table_rows(evaluation_run, name)
        for kind in ("warnings", "doubtful"):
            assert [row[kind] for row in found] == [2 * (row["paradigm"] == "meta") for row in found]
        notes = evaluation_run.table(name).notes
        assert "meta: 2 of 3 fits ended above their initialisation's loss" in notes
        assert "meta: 2 of 3 fits look doubtful; the entry `warning` of their records says why" in notes
        assert not any("quickft: " in note and ("fits ended" in note or "doubtful" in note) for note in notes)
    assert "threads: 1" in evaluation_run.table("quickft").notes


@pytest.mark.parametrize(
    ("cpu_seconds", "said"), [(None, ""), (1.0, ""), (1.9, ""), (0.81, ""), (0.5, "meta 0.50"), (0.79, "meta 0.79")]
)
def test_rows_whose_fits_got_little_cpu_are_named(
    cpu_seconds: float | None, said: str, evaluation_run: EvaluationRun
) -> None:
    for name in evaluation_run.specs:
        for record in evaluation_run.fits(name):
            record.seconds = record.cpu_seconds = 2.0  # whatever this machine does beside the tests
            if name == "meta" and cpu_seconds is None:
                record.cpu_seconds = None
            elif name == "meta":
                record.cpu_seconds = 2 * cpu_seconds
    for name in ("results", "quickft"):
        notes = [note for note in evaluation_run.table(name).notes if note.startswith("seconds are too long")]
        assert [note.rpartition(": ")[2] for note in notes] == [said] * bool(said)


@pytest.mark.parametrize(("other_seconds", "own_seconds"), [(0.5, 0.0), (0.0, 0.5)])
def test_fits_record_the_cpu_seconds_that_they_got(
    other_seconds: float, own_seconds: float, evaluation_run: EvaluationRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stack(*arguments: Any) -> Any:
        time.sleep(other_seconds)  # as if another program had the CPU
        end = time.process_time() + own_seconds
        while time.process_time() < end:
            pass
        return stack_tasks(*arguments)

    monkeypatch.setattr("metapp.runs.fitting.stack_tasks", stack)
    (fit,) = fit_tasks_of(evaluation_run.fitters["general"], evaluation_run.tasks[:1])
    seconds, cpu_seconds = fit.seconds, fit.cpu_seconds
    assert seconds is not None
    assert cpu_seconds is not None
    assert seconds > 0.5
    assert cpu_seconds >= own_seconds
    assert seconds - cpu_seconds >= 0.9 * other_seconds
    assert "cpu_seconds" not in fit.errors


@pytest.mark.parametrize("width", [60, 120, 200])
def test_a_terminal_shows_as_many_columns_as_it_has_room_for(width: int, evaluation_run: EvaluationRun) -> None:
    from rich.console import Console

    for name in registry().tables:
        table = evaluation_run.table(name)
        if not table.rows:
            continue
        console = Console(width=width)
        with console.capture() as shown:
            console.print(make_rich_table(table, width))
        text = shown.get()
        assert max(map(len, text.splitlines())) <= width
        assert "…" not in text
        if width == 200:
            assert len(make_rich_table(table, width).columns) == len(filled_columns([table]))
        for row in table.rows:
            assert table.columns[0].text(row) in text, name


def test_notes_are_numbered_below_all_tables(evaluate: Callable, evaluated_folder: Path) -> None:
    common = ("--out", evaluated_folder / "runs", "--no-run")
    lines = evaluate(*common, "--whole").out.splitlines()
    assert max(map(len, lines)) <= 100
    assert lines[0].startswith("BRDF, 3 unseen tasks: mean error x100, median seconds of inference [1, 2, ")
    below = lines[lines.index(next(line for line in lines if line.startswith("[1] "))) :]
    first_lines = [line for line in below if line.startswith("[")]  # on a busy machine a note on it takes two lines
    assert [line.split()[0] for line in first_lines] == [f"[{number}]" for number in re.findall(r"\d+", lines[0])[2:]]
    assert below[0].startswith("[1] vs quickft: ratio of mean errors, 95 % interval")
    many = evaluate(*common, "--which", "all").out
    titles = re.findall(r"^BRDF, [^\[]*\[([\d,\s]+)\]$", many, re.MULTILINE)
    cited = {number for numbers in titles for number in re.findall(r"\d+", numbers)}
    printed = re.findall(r"^\[(\d+)\] ", many, re.MULTILINE)
    assert printed == [str(number) for number in range(1, 1 + len(printed))]
    assert cited == set(printed)
    assert len(printed) > 10


@pytest.mark.parametrize("form", ["rich", "markdown", "latex", "csv", "json"])
def test_no_figure_of_the_paper_stands_beside_own_data(
    form: str, evaluate: Callable, evaluated_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "250")  # a terminal with room for all columns
    result = evaluate("--out", evaluated_folder / "runs", "--no-run", "--which", "all", "--format", form)
    assert result.code == 0, result.err
    if form in ("csv", "json"):
        shown = evaluate("--out", evaluated_folder / "runs", "--no-run", "--which", "all", "--json").json_document
        figures = {key: value for row in shown["rows"] for key, value in row.items() if key.startswith("paper_")}
        assert {"paper_error", "paper_seconds", "paper_saved", "paper_further"} <= set(figures)
        assert set(figures.values()) == {None}
    else:
        assert "paper" not in result.out


def test_the_papers_figures_stand_beside_embedded_tasks_wherever_they_lie(
    metapp: Callable,
    write_nbrdf_networks: Callable[[int], Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It is what the set holds that counts, not whether --data names it; a set that is joined with own data is own."""
    monkeypatch.chdir(tmp_path)
    assert metapp("data", "synth", "brdf", "--count", "2", "--out", "embedded", "--quiet").code == 0
    assert metapp("data", "nbrdf", write_nbrdf_networks(1), "--split", "test", "--out", "own", "--quiet").code == 0
    assert metapp("data", "join", "embedded", "own", "--out", "joined", "--quiet").code == 0
    for folder, expected in (("embedded", 0.72), ("joined", None), ("own", None)):
        shown = metapp("evaluate", "brdf", "--data", folder, "--no-run", "--format", "json")
        rows = {row["paradigm"]: row for row in shown.json_document["rows"]}
        assert (rows["meta"]["paper_error"], rows["meta"]["paper_seconds"] is None) == (expected, expected is None)
        table = metapp("evaluate", "brdf", "--data", folder, "--no-run").out
        assert ("paper" in table) == (expected is not None)


def test_tables_are_printed_before_pictures_are_drawn(
    evaluate: Callable, evaluated_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def draw(*_: object) -> None:
        raise OSError("no pictures")

    monkeypatch.setattr(EvaluationRun, "draw_fits", draw)
    result = evaluate("--out", evaluated_folder / "runs", "--no-run")
    assert "error: no pictures" in result.err
    assert "[1] " in result.out


def test_fits_of_a_command_fill_the_table(evaluate: Callable, metapp: Callable, data: Path, tmp_path: Path) -> None:
    words = ("--recipe", "quick", "--out", tmp_path / "runs", "--quiet")
    result = metapp("quickft", "brdf", "--data", data, *words)
    assert result.code == 0, result.err
    rows = {row["paradigm"]: row for row in evaluate("--no-run", "--json").json_document["rows"]}
    assert {name: row["tasks"] for name, row in rows.items() if row["tasks"]} == {"quickft": 3}


def test_long_rows_are_of_few_tasks_unless_all_are_asked_for(evaluation_run: EvaluationRun) -> None:
    short_evaluation = EvaluationRun(
        evaluation_run.given, evaluation_run.options, is_measuring=True, whole=False, long_fit_tasks=2
    )
    whole, few = (
        {row["paradigm"]: row for row in table_rows(one, "results")} for one in (evaluation_run, short_evaluation)
    )
    assert [name for name in few if few[name]["few"]] == ["overfit"]  # of 40 steps; the others have 10 at most
    assert [row["tasks"] for row in few.values()] == [3 - (name == "overfit") for name in few]
    assert few["meta"]["error"] == whole["meta"]["error"]
    names = [task.name for task in short_evaluation.tasks_of("overfit")]
    for name, row in few.items():
        errors = {fit.name: fit.error for fit in evaluation_run.fits(name)}
        assert row["shared_error"] == pytest.approx(sum(errors[task] for task in names) / 2)
        assert whole[name]["shared_error"] == pytest.approx(whole[name]["error"])
    # the gap closed is of the tasks that all three have
    gap = (few["general"]["shared_error"] - few["meta"]["shared_error"]) / (
        few["general"]["shared_error"] - few["overfit"]["shared_error"]
    )
    table = short_evaluation.table("results")
    assert table.findings[1].startswith(f"gap closed {gap:.2f}*, speed-up of Meta (meta-curvature) over")
    assert "*: on 2 evenly spaced tasks; --whole measures all" in table.notes
    assert [table.columns[1].text(row).endswith("*") for row in few.values()] == [row["few"] for row in few.values()]
    assert not any("*" in note for note in evaluation_run.table("results").notes)
    # what is measured for one table counts for the other
    short_evaluation.is_measuring = False
    for name in ("image", "convergence", "baselines"):
        assert short_evaluation.table(name).rows
    assert all(len(tasks) == len(fits) for tasks, fits in short_evaluation.requested.values())
