"""The harness itself: its inputs repeat, and it finds what is planted."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from torture import kills
from torture.report import Report, fault_of_message
from torture.targets import TARGETS, BadResult, Target, mutated
from torture.worker import fault


def test_an_input_depends_on_seed_and_index_alone(tmp_path: Path) -> None:
    target = TARGETS["record"]
    contents = []
    for turn in range(2):
        folder = tmp_path / str(turn)
        folder.mkdir()
        contents.append(mutated(random.Random("1/record/7"), target, folder, target.seeds()).read_bytes())
    assert contents[0] == contents[1] != target.seeds()[0]["record.jsonl"]


def _raise(error: BaseException) -> None:
    raise error


@pytest.mark.parametrize(
    ("error", "found"),
    [
        (KeyError("x"), "KeyError"),
        (RecursionError("deep"), "RecursionError"),
        (MemoryError(), "MemoryError"),
        (UnicodeDecodeError("utf-8", b"\xff", 0, 1, "bad"), "UnicodeDecodeError"),
        (BadResult("NaN"), "a bad result"),
        (ValueError("no name of the file"), "does not name"),
        (ValueError("input: two\nlines"), ""),
        (ValueError("input: fine."), ""),
    ],
)
def test_all_but_one_line_that_names_the_file_is_a_finding(tmp_path: Path, error: BaseException, found: str) -> None:
    folder = tmp_path / "input"
    folder.mkdir()
    target = Target(lambda: [], lambda *_: _raise(error))
    what = fault(target, random.Random(0), folder, [{"a.bin": b"abcd"}])
    assert what.startswith(found) or (found and found in what)
    assert bool(what) == bool(found)


def test_long_messages_are_findings() -> None:
    assert "301 characters" in fault_of_message("x" * 301)
    assert fault_of_message("x" * 300) == ""


def test_kills_compare_every_result(tmp_path: Path) -> None:
    for name in ("whole", "killed"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "a.safetensors").write_bytes(name.encode())
    (tmp_path / "whole" / "record.jsonl").write_text('{"name": "a", "error": 1, "seconds": 3}\n')
    (tmp_path / "killed" / "b.npy").write_bytes(b"")
    found = kills.differences(kills.results(tmp_path / "whole"), kills.results(tmp_path / "killed"))
    assert found == ["record.jsonl is missing", "b.npy is not there without kills", "a.safetensors differs"]


def test_findings_of_one_kind_are_shown_once() -> None:
    report = Report()
    for index in range(3):
        report.add("readers:x", f"KeyError: {index}", f"--index {index}")
    assert sum(line.startswith("FINDING") for line in report.lines()) == 1
    assert "3 alike" in report.lines()[0]
