"""`metapp rerun`: rows that agree, rows that do not, and what is said where something has changed since."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from metapp.extensions.reruns.rerun import ELSEWHERE, ROUNDING
from metapp.runs.checkpoints.shipped import shipped_path
from metapp.storage.records import load_checkpoint, read_records, save_checkpoint
from tests.conftest import Result

pytestmark = pytest.mark.usefixtures("small_spheres")


@pytest.fixture
def networks(neural_fits: Callable[[int], Path]) -> Path:
    """Two networks that a test may change."""
    return neural_fits(2).rename("networks")


@pytest.fixture
def run(metapp: Callable, networks: Path) -> Path:
    """A run of both by Meta's gradient rule."""
    return Path(metapp("meta", "brdf", networks, "--rule", "meta-curvature", "--json", "--quiet").document["out"])


def change(run: Path, edit: Callable[[dict[str, Any]], None]) -> None:
    """Write a run's records anew, each after an edit."""
    records = read_records(run / "record.jsonl")
    for record in records:
        edit(record)
    (run / "record.jsonl").write_text("".join(json.dumps(record) + "\n" for record in records))


def test_rows_agree_to_rounding_and_nothing_is_written(metapp: Callable, run: Path) -> None:
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    document = metapp("rerun", run, "--json").done
    assert document["agrees"]
    assert [row["name"] for row in document["tasks"]] == ["m0", "m1"]
    for row in document["tasks"]:
        assert row["found"] == row["recorded"]
        assert (row["difference"], row["tolerance"], row["differs"]) == (0.0, ROUNDING, {})
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before
    result = metapp("rerun", run / "record.jsonl", "--task", "m1")
    assert result.code == 0
    assert "m1" in result.out
    assert "m0" not in result.out
    assert "the figure agrees with the record" in result.err
    assert "no record of task 'm7', expected one of m0, m1." in metapp("rerun", run, "--task", "m7").error


def test_a_figure_that_was_altered_does_not_agree(metapp: Callable, run: Path) -> None:
    change(run, lambda record: record.update(error=record["error"] * (1.001 if record["name"] == "m1" else 1)))
    result = metapp("rerun", run, "--json")
    assert result.code == 1
    assert [row["agrees"] for row in result.document["tasks"]] == [True, False]
    assert result.document["tasks"][1]["difference"] == pytest.approx(1 - 1 / 1.001, rel=1e-3)
    assert "1 of 2 figures do not agree: m1" in result.err
    assert metapp("rerun", run, "--tolerance", "0.002", "--quiet").code == 0


@pytest.mark.long
def test_other_versions_machines_and_threads_are_named_and_allowed_for(metapp: Callable, run: Path) -> None:
    def edit(record: dict[str, Any]) -> None:
        record["settings"]["versions"]["torch"] = "2.0.0"
        record["origin"]["machine"] = "another"

    change(run, lambda record: record.update(threads=1000))  # it runs on as many as there are processors
    result = metapp("rerun", run, "--task", "m0", "--json")
    assert result.done["tasks"][0]["differs"] == {"threads": [1000, os.cpu_count()]}
    change(run, lambda record: record.update(threads=1))
    change(run, edit)
    result = metapp("rerun", run, "--task", "m0", "--json")
    (row,) = result.done["tasks"]
    assert row["tolerance"] == ELSEWHERE
    assert row["differs"]["torch"][0] == "2.0.0"
    assert "note: machine: another then" in result.err


def error_of(result: Result) -> str:
    """The only line beside warnings."""
    (line,) = (each for each in result.err.splitlines() if not each.startswith("warning: "))
    assert line == result.error
    return line


def test_data_that_changed_are_named_with_a_remedy(
    metapp: Callable, run: Path, networks: Path, neural_fits: Callable[[int], Path]
) -> None:
    (networks / "m1").rename(networks / "other")
    line = error_of(metapp("rerun", run))
    assert line.startswith("error: m1: no such task in networks-")
    assert line.endswith("; give what was fitted after RECORD, or --data.")
    assert metapp("rerun", run, neural_fits(2), "--quiet").code == 0


def test_a_checkpoint_that_changed_is_named_with_a_remedy(metapp: Callable, networks: Path) -> None:
    shipped, path = shipped_path("brdf", "general"), Path("mine.safetensors")
    path.write_bytes(shipped.read_bytes())
    words = ("general", "brdf", networks, "--recipe", "quick", "--checkpoint", path)
    run = metapp(*words, "--json", "--quiet").document["out"]
    assert metapp("rerun", run, "--quiet").code == 0
    checkpoint, info = load_checkpoint(path)
    save_checkpoint(path, checkpoint, info | {"note": "another"})
    line = error_of(metapp("rerun", run))
    assert line.startswith("error: m0: checkpoint ")
    assert "as recorded; give that file by --checkpoint." in line
    assert metapp("rerun", run, "--checkpoint", shipped, "--quiet").code == 0


def test_other_settings_are_named_and_fits_without_reference_judged(metapp: Callable, run: Path) -> None:
    change(run, lambda record: record.update(error=None))
    result = metapp("rerun", run, "--task", "m0", "--json")
    assert result.code == 1  # the record has no error, the fit has one
    assert result.document["tasks"][0]["difference"] is None
    change(run, lambda record: record["settings"].update(batch=100))
    said = "error: m0: batch 512, expected 100 as recorded; repeat it by the version of metapp"
    assert said in metapp("rerun", run).error


MISSING = object()
DAMAGED = {
    "error": (MISSING, "x"),
    "seconds": ("x", None),
    "threads": (0.5, -1, 0, 10**18, True, "x"),
    "settings.rule": (7, MISSING, ["ridge"]),
    "settings.paradigm": ([], {}),
    "settings.steps": (10**18, -1, "x"),
    "settings.seed": (0.5, MISSING),
    "settings.versions": (None, [], {"torch": {}}),
    "settings.data": (MISSING, 0.5),
    "origin": (None, "x", []),
    "origin.inputs": (7, [None], [[]]),
    "origin.inputs.0": (7,),
}


def _damage(record: dict[str, Any], place: str, value: Any) -> None:
    *above, last = place.split(".")
    for key in above:
        record = record[int(key) if isinstance(record, list) else key]
    if value is MISSING:
        del record[last]
    else:
        record[int(last) if isinstance(record, list) else last] = value


@pytest.mark.parametrize("place", DAMAGED)
def test_a_record_of_other_types_is_refused_in_a_line(metapp: Callable, run: Path, place: str) -> None:
    whole = (run / "record.jsonl").read_text()
    for value in DAMAGED[place]:
        (run / "record.jsonl").write_text(whole)
        change(run, lambda record, value=value: record["name"] == "m1" and _damage(record, place, value))
        for words in (("rerun", run), ("rerun", run, "--task", "m1")):
            line = error_of(metapp(*words))
            assert "unexpected" not in line, (value, line)


@pytest.mark.slow
def test_rows_of_all_tables_are_repeated_or_refused_by_name(metapp: Callable, ten_materials: Path) -> None:
    out = Path("runs")
    for table in ("results", "ablation", "baselines", "convergence"):
        words = ("--data", ten_materials, "--out", out, "--which", table)
        assert metapp("evaluate", "brdf", *words, "--quiet", "--json").code == 0
    for record in sorted(out.glob("brdf/**/record.jsonl")):
        result = metapp("rerun", record, "--json")
        if record.parent.parent.name == "trace":
            assert "a record of" in result.err
            continue
        assert result.code == 0, (record, result.err)
        assert all(row["found"] == row["recorded"] for row in result.document["tasks"])
