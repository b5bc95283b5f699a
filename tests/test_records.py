"""Trained starts and run folders on disk."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file, save_file

from metapp.learning import MetaParameters
from metapp.records import SCHEMA, RunFolder, digest, file_name, load_start, read_records, save_start

START = MetaParameters(
    {"w1": torch.arange(6.0).reshape(2, 3)},
    {"rate.w1": torch.full((1, 2, 3), -1e-3), "beta1": torch.tensor([0.5, 0.25], dtype=torch.float64)},
    {"in.w": torch.ones(3, 2).T.requires_grad_()},
)


def test_start_round_trip(tmp_path: Path) -> None:
    path, info = tmp_path / "new" / "start.safetensors", {"app": "brdf", "training": {"steps": 3}, "curve": [1.5, None]}
    save_start(path, START, info)
    start, said = load_start(path)
    assert said == {**info, "schema": SCHEMA}
    for part, expected in zip(start, START, strict=True):
        assert set(part) == set(expected)
        for key, value in expected.items():
            assert part[key].dtype == value.dtype
            assert torch.equal(part[key], value)
    assert [file.name for file in path.parent.iterdir()] == ["start.safetensors"]


def test_tensors_that_share_memory(tmp_path: Path) -> None:
    row = torch.arange(3.0)
    save_start(tmp_path / "s.safetensors", MetaParameters({"a": row.expand(2, 3), "b": row, "c": row[1:]}), {})
    start, _ = load_start(tmp_path / "s.safetensors")
    assert start.theta["a"].tolist() == [[0, 1, 2], [0, 1, 2]]
    assert start.theta["c"].tolist() == [1, 2]


def test_no_start(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"none.safetensors: no such start; give --checkpoint"):
        load_start(tmp_path / "none.safetensors")
    with pytest.raises(ValueError, match="no such start"):
        load_start(tmp_path)


def write(path: Path, tensors: dict[str, torch.Tensor], metadata: dict[str, str] | None) -> None:
    save_file(tensors, path, metadata)


ONE = {"theta.x": torch.ones(1)}
GOOD = {"metapp": json.dumps({"schema": SCHEMA})}


@pytest.mark.parametrize(
    ("tensors", "metadata"),
    [
        (ONE, None),
        (ONE, {"format": "pt"}),
        (ONE, {"metapp": "{"}),
        (ONE, {"metapp": "[]"}),
        (ONE, {"metapp": "{}"}),
        (ONE, {"metapp": json.dumps({"schema": "new"})}),
        ({"other.x": torch.ones(1)}, GOOD),
        ({"theta": torch.ones(1)}, GOOD),
    ],
    ids=["bare", "stranger", "cut", "list", "empty", "schema", "part", "undotted"],
)
def test_files_that_are_no_starts(
    tmp_path: Path, tensors: dict[str, torch.Tensor], metadata: dict[str, str] | None
) -> None:
    path = tmp_path / "start.safetensors"
    write(path, tensors, metadata)
    with pytest.raises(ValueError, match=r"start.safetensors: not a start that metapp wrote") as caught:
        load_start(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("keep", [0, 4, 8, 60, -1])
def test_cut_off_starts(tmp_path: Path, keep: int) -> None:
    path = tmp_path / "start.safetensors"
    save_start(path, START, {})
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(ValueError, match=r"start.safetensors: not a start that metapp wrote") as caught:
        load_start(path)
    assert "\n" not in str(caught.value)


def test_noise_is_no_start(tmp_path: Path) -> None:
    path = tmp_path / "start.safetensors"
    for content in (b"\xff" * 64, b"\x80\x04N.", b'{"schema": 1}', bytes(range(256)) * 4):
        path.write_bytes(content)
        with pytest.raises(ValueError, match="not a start that metapp wrote"):
            load_start(path)


def test_a_newer_schema_says_so(tmp_path: Path) -> None:
    path = tmp_path / "start.safetensors"
    write(path, ONE, {"metapp": json.dumps({"schema": SCHEMA + 1})})
    with pytest.raises(ValueError, match=rf"schema {SCHEMA + 1}, expected at most {SCHEMA}; update metapp"):
        load_start(path)


def test_digest(tmp_path: Path) -> None:
    assert digest({"a": 1, "b": [2]}) == digest({"b": [2], "a": 1})
    assert digest({"a": 1}) != digest({"a": 2})
    assert len(digest({})) == 12
    (tmp_path / "x").write_bytes(b"1")
    before = digest(tmp_path / "x")
    (tmp_path / "x").write_bytes(b"2")
    assert digest(tmp_path / "x") != before


# Run folders

THETA = {"w": torch.arange(3.0)}


def record(name: str, **more: Any) -> dict[str, Any]:
    return {"name": name, "error": 0.5, **more}


def test_run_folder_keeps_tasks(tmp_path: Path) -> None:
    run = RunFolder(tmp_path / "run", {"steps": 10})
    assert run.finished() == {}
    run.add(record("gold"), THETA)
    run.add(record("red felt/2", note="größe\u2028\nx"), {"w": torch.ones(2, 3, requires_grad=True).T})
    again = RunFolder(tmp_path / "run", {"steps": 10}).finished()
    assert list(again) == ["gold", "red felt/2"]
    assert again["red felt/2"] == record(
        "red felt/2", note="größe\u2028\nx", key=digest({"steps": 10}), settings={"steps": 10}
    )
    files = sorted(file.name for file in (tmp_path / "run" / "params").iterdir())
    assert files == sorted(f"{file_name(name)}.safetensors" for name in again)
    assert torch.equal(load_file(tmp_path / "run" / "params" / "gold.safetensors")["w"], THETA["w"])
    assert torch.equal(load_file(tmp_path / f"run/params/{file_name('red felt/2')}.safetensors")["w"], torch.ones(3, 2))


def test_a_task_again_replaces_its_line(tmp_path: Path) -> None:
    run = RunFolder(tmp_path, {})
    for error in (0.5, 0.25):
        run.add({"name": "gold", "error": error}, THETA)
    assert len(read_records(run.file)) == 1 or run.finished()["gold"]["error"] == 0.25
    assert run.finished()["gold"]["error"] == 0.25


def test_other_settings_drop_old_lines_at_the_first_write(tmp_path: Path) -> None:
    old, new = RunFolder(tmp_path, {"steps": 10}), RunFolder(tmp_path, {"steps": 20})
    old.add(record("gold"), THETA)
    assert new.finished() == {}
    assert list(old.finished()) == ["gold"]
    new.add(record("tin"), THETA)
    assert old.finished() == {}
    assert [each["name"] for each in read_records(new.file)] == ["tin"]


@pytest.mark.parametrize("keep", [0, 1, 20, -1])
def test_a_cut_off_line_counts_as_absent(tmp_path: Path, keep: int) -> None:
    run = RunFolder(tmp_path, {})
    for name in ("gold", "tin"):
        run.add(record(name), THETA)
    first, second = run.file.read_text().splitlines()
    run.file.write_text(f"{first}\n{second[:keep]}")
    assert list(run.finished()) == ["gold"]
    run.add(record("tin"), THETA)
    assert run.file.read_text() == f"{first}\n{second}\n"


def test_strange_lines_count_as_absent(tmp_path: Path) -> None:
    run = RunFolder(tmp_path, {})
    run.add(record("gold"), THETA)
    line = run.file.read_bytes()
    run.file.write_bytes(b'\n[1]\n3\nnull\n{"error": 1}\n' + line + b'{"name": "tin"}\n\xff\xfe\n')
    assert list(run.finished()) == ["gold"]


def test_a_task_that_runs_again_replaces_its_line_alone(tmp_path: Path) -> None:
    run = RunFolder(tmp_path, {})
    run.add(record("gold"), THETA)
    run.add(record("tin"), THETA)
    run.add({**record("gold"), "error": 7.0}, THETA)
    assert [(line["name"], line["error"]) for line in read_records(run.file)][1:] == [("gold", 7.0)]
    assert set(run.finished()) == {"gold", "tin"}


def test_parameters_are_there_before_their_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = RunFolder(tmp_path, {})
    monkeypatch.setattr("metapp.records.json.dumps", lambda *_, **__: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run.add(record("gold"), THETA)
    assert (tmp_path / "params" / "gold.safetensors").is_file()
    assert not run.file.exists()


def test_file_names_are_safe_and_distinct() -> None:
    names = [
        "gold",
        "a b",
        "a_b",
        "a/b",
        "a\\b",
        "..",
        ".",
        "",
        "/",
        ".hidden",
        "hidden",
        "größe",
        "a\0b",
        "-x",
        "task",
    ]
    files = [file_name(name) for name in names]
    assert len(set(files)) == len(names)
    for name, file in zip(names, files, strict=True):
        assert not file.startswith("."), name
        assert not set(file) & set('/\\:*?"<>| \0'), name
    assert file_name("gold-1.5_x") == "gold-1.5_x"
