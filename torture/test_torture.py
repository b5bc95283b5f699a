"""The harness itself: its inputs repeat, and it finds what is planted."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

import pytest

from metapp.extensions.native import compiler
from metapp.extensions.viewer.live import Live
from metapp.storage import cache
from metapp.storage.cache import cache_folder
from torture import arrays, kills, links, servers
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


@pytest.mark.skipif(compiler.compiler() is None, reason="no C compiler: apt-get install gcc libc6-dev")
@pytest.mark.parametrize("is_checked", [True, False])
def test_a_cache_of_others_is_a_finding_where_nobody_asks_whose_it_is(
    is_checked: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = TARGETS["caches"]
    monkeypatch.setattr(compiler, "cache_folder", cache_folder)  # which other tests share
    target.seeds()
    if not is_checked:
        monkeypatch.setattr(compiler, "_is_whole", lambda *_: True)
        monkeypatch.setattr(cache, "_shared", lambda *_: "")
    faults = []
    for index in range(8):
        (tmp_path / str(index)).mkdir()
        faults.append(fault(target, random.Random(f"1/caches/{index}"), tmp_path / str(index), []))
    assert any("a function that gives 66" in what for what in faults) == (not is_checked)
    assert is_checked == (not any(faults))


@pytest.mark.parametrize(
    ("does", "found"),
    [
        (lambda: Path("home/keys").write_text("x"), "a bad result: home/keys has changed"),
        (lambda: Path("home/new").symlink_to("keys"), "a bad result: home/new has changed"),
        (lambda: _raise(KeyError("x")), "a bad result: KeyError"),
        (lambda: _raise(SystemExit(1)), "a bad result: ''"),
        (lambda: Path("runs").mkdir(), ""),
    ],
)
def test_what_changes_outside_of_a_run_is_a_finding(
    does: Callable[[], object], found: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "home").mkdir()
    (tmp_path / "home" / "keys").write_text("first")
    (tmp_path / links.CASE).write_text('["view"]')
    monkeypatch.setattr("metapp.cli.main", does)
    target = TARGETS["links"]._replace(write=lambda rng, folder: folder / links.CASE)
    assert fault(target, random.Random(0), tmp_path, []).startswith(found)


@pytest.mark.parametrize(
    ("error", "found"),
    [
        (ValueError("object: fine."), ""),
        (ValueError("an array"), "a bad result"),
        (TypeError("object: x"), "TypeError"),
    ],
)
def test_an_array_is_fitted_or_refused_by_name(
    error: BaseException, found: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("metapp.fit", lambda *_, **options: _raise(error))
    what = fault(TARGETS["arrays"], random.Random(0), tmp_path, [])
    assert what.startswith(found)
    assert bool(what) == bool(found)


@pytest.mark.filterwarnings("ignore")  # of torch, of kinds that it gives up
def test_drawn_arrays_are_of_many_kinds() -> None:
    kinds = {type(arrays.draw(random.Random(index))[1]).__name__ for index in range(300)}
    assert {"Image", "MaskedArray", "Tensor", "dict", "function", "list", "ndarray", "tuple"} <= kinds


@pytest.mark.parametrize("is_served", [True, False])
def test_a_page_that_is_gone_after_clients_is_a_finding(is_served: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("CLIENTS", 30), ("SECONDS", 0.5), ("AFTERWARDS", 6.0 if is_served else 0.5)):
        monkeypatch.setattr(servers, name, value)
    live, report = Live(), Report()
    live.tell({"title": "gold", "groups": [{}]}, "", [])
    monkeypatch.setattr("metapp.extensions.viewer.live.html", lambda *_: '"live": "news"')
    if not is_served:
        live.close()
    servers._attack(report, random.Random(1), live.address)
    assert len(report.findings) == (not is_served)
    live.close()


def test_findings_of_one_kind_are_shown_once() -> None:
    report = Report()
    for index in range(3):
        report.add("readers:x", f"KeyError: {index}", f"--index {index}")
    assert sum(line.startswith("FINDING") for line in report.lines()) == 1
    assert "3 alike" in report.lines()[0]
