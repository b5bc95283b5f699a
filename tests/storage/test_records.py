"""Trained starts and run folders on disk."""

from __future__ import annotations

import json
import multiprocessing
import warnings
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.torch import load_file, save

from metapp.learning.learn import MetaParameters
from metapp.storage.files import PARTIAL
from metapp.storage.records import (
    FIT,
    SCHEMA,
    SMALL_BYTES,
    RunFolder,
    digest,
    file_name,
    load_checkpoint,
    read_records,
    safe_name,
    save_checkpoint,
    tensor_digest,
)
from metapp.storage.text import as_text

START = MetaParameters(
    {"w1": torch.arange(6.0).reshape(2, 3)},
    {"rate.w1": torch.full((1, 2, 3), -1e-3), "beta1": torch.tensor([0.5, 0.25], dtype=torch.float64)},
    {"in.w": torch.ones(3, 2).T.requires_grad_()},
)


def test_checkpoint_round_trip(tmp_path: Path) -> None:
    path, info = tmp_path / "new" / "start.safetensors", {"app": "brdf", "training": {"steps": 3}, "curve": [1.5, None]}
    save_checkpoint(path, START, info)
    start, said = load_checkpoint(path)
    assert said == {**info, "schema": SCHEMA}
    for part, expected in zip(start, START, strict=True):
        torch.testing.assert_close(part, dict(expected), rtol=0, atol=0)  # of the same keys and types
    assert [file.name for file in path.parent.iterdir()] == ["start.safetensors"]
    row = torch.arange(3.0)
    save_checkpoint(tmp_path / "s.safetensors", MetaParameters({"a": row.expand(2, 3), "b": row, "c": row[1:]}), {})
    start, _ = load_checkpoint(tmp_path / "s.safetensors")
    assert start.theta["a"].tolist() == [[0, 1, 2], [0, 1, 2]]
    assert start.theta["c"].tolist() == [1, 2]


def test_missing_and_newer_checkpoints_say_so(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"none.safetensors: no such checkpoint; give --checkpoint"):
        load_checkpoint(tmp_path / "none.safetensors")
    with pytest.raises(ValueError, match="no such checkpoint"):
        load_checkpoint(tmp_path)
    path = tmp_path / "start.safetensors"
    path.write_bytes(save({"theta.x": torch.ones(1)}, {"metapp": json.dumps({"schema": SCHEMA + 1})}))
    with pytest.raises(ValueError, match=rf"schema {SCHEMA + 1}, expected at most {SCHEMA}; update metapp"):
        load_checkpoint(path)


def test_a_checkpoint_takes_the_encoder_of_the_general_beside_it(tmp_path: Path) -> None:
    encoder = {"w": torch.arange(3.0)}
    save_checkpoint(tmp_path / "general.safetensors", MetaParameters(encoder=encoder), {"app": "brdf"})
    path, general = tmp_path / "meta.safetensors", tensor_digest(encoder)
    save_checkpoint(path, MetaParameters(alpha={"rate": torch.ones(1)}), {"general": general})
    assert torch.equal(load_checkpoint(path)[0].encoder["w"], encoder["w"])
    save_checkpoint(tmp_path / "general.safetensors", MetaParameters(encoder={"w": torch.zeros(3)}), {})
    with pytest.raises(ValueError, match=f"meta.safetensors: goes on from General {general}, which is not beside it"):
        load_checkpoint(path)
    for named in ("0123456789ab", 7, None, {"a": 1}):  # one that names itself
        save_checkpoint(tmp_path / "general.safetensors", START, {"general": named})
        with pytest.raises(ValueError, match="goes on from General"):
            load_checkpoint(tmp_path / "general.safetensors")


def test_a_checkpoint_of_a_protocol_takes_the_general_of_its_protocol(tmp_path: Path) -> None:
    """Whatever else lies beside it, such as a training's own file."""
    encoder, other = {"w": torch.arange(3.0)}, {"w": torch.zeros(3)}
    (tmp_path / "general-photo.training.safetensors").write_bytes(b"no checkpoint")
    for name, each in (("general", other), ("general-photo", encoder)):
        save_checkpoint(tmp_path / f"{name}.safetensors", MetaParameters(encoder=each), {"app": "brdf"})
    path = tmp_path / "meta-encoder-photo.safetensors"
    save_checkpoint(path, MetaParameters(alpha={"rate": torch.ones(1)}), {"general": tensor_digest(encoder)})
    assert torch.equal(load_checkpoint(path)[0].encoder["w"], encoder["w"])


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


def fit_folder(path: Path) -> RunFolder:
    run = RunFolder(path, {"steps": 10}, FIT)
    run.add(record("gold", seconds=0.1), THETA)
    run.add(record("tin", seconds=0.1), THETA)
    return run


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


def test_lines_of_other_settings_stay_until_their_parameters_are_replaced(tmp_path: Path) -> None:
    old, new = RunFolder(tmp_path, {"steps": 10}), RunFolder(tmp_path, {"steps": 20})
    for name in ("gold", "tin"):
        old.add(record(name), THETA)
    assert new.finished() == {}
    new.add(record("tin"), {"w": torch.zeros(3)})
    assert list(old.finished()) == ["gold"]  # tin's parameters on disk are another run's now
    assert list(new.finished()) == ["tin"]
    assert [each["name"] for each in read_records(new.file)] == ["gold", "tin"]


@pytest.mark.parametrize("keep", [0, 1, 20, -2, -1])
def test_a_cut_off_line_gives_way_to_the_next(tmp_path: Path, keep: int) -> None:
    """Of -1 nothing but its end is missing: it stays."""
    run = fit_folder(tmp_path)
    first, second = run.file.read_bytes().splitlines(keepends=True)
    run.file.write_bytes(first + second[:keep])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert list(run.finished()) == ["gold", *(["tin"] if keep == -1 else [])]
    run.add(record("tin" if keep != -1 else "zinc", seconds=0.1), THETA)
    assert run.file.read_bytes() == first + second + (b"" if keep != -1 else run.file.read_bytes().splitlines(True)[-1])
    assert list(run.finished()) == ["gold", "tin", *(["zinc"] if keep == -1 else [])]


def test_a_task_that_runs_again_replaces_its_line_alone(tmp_path: Path) -> None:
    run = fit_folder(tmp_path)
    nan = {"ssim": float("nan"), "curve": [(1, float("inf"))]}  # JSON has no such numbers
    run.add(record("gold", seconds=0.1) | {"error": 7.0} | nan, THETA)
    assert [(line["name"], line["error"]) for line in read_records(run.file)][1:] == [("gold", 7.0)]
    assert {name: line["error"] for name, line in run.finished().items()} == {"gold": 7.0, "tin": 0.5}
    assert (run.finished()["gold"]["ssim"], run.finished()["gold"]["curve"]) == (None, [[1, None]])


def test_a_task_that_runs_many_times_leaves_a_small_file(tmp_path: Path) -> None:
    """Else the n-th repetition reads n records; what else is in the file stays."""
    settings = {"steps": 10, "long": "x" * 1000}
    run, other = RunFolder(tmp_path, settings, FIT), RunFolder(tmp_path, {"steps": 20}, FIT)
    other.add(record("zinc", seconds=0.1))
    run.add(record("tin", seconds=0.1))
    with run.file.open("ab") as file:
        file.write(b"no record\n" + json.dumps(record("gold", key=run.key, settings=settings)).encode() + b"\n")
    sizes = []
    for repetition in range(300):
        run.add(record("gold", seconds=float(repetition)))
        sizes.append(run.file.stat().st_size)
    assert max(sizes) < 1.2 * SMALL_BYTES
    lines = run.file.read_bytes().splitlines()
    assert b"no record" in lines
    assert sum(b'"gold"' in line and b"seconds" not in line for line in lines) == 1  # of another form
    with pytest.warns(UserWarning, match="no record"):
        finished = run.finished()
    assert {name: line["seconds"] for name, line in finished.items()} == {"tin": 0.1, "gold": 299.0}
    with pytest.warns(UserWarning, match="no record"):
        assert list(other.finished()) == ["zinc"]
    assert not list(tmp_path.glob(f"{PARTIAL}*"))


def test_a_record_is_kept_where_there_is_no_room_to_remove_replaced_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(path: Path, write: Any) -> None:
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr("metapp.storage.records.SMALL_BYTES", 0)
    monkeypatch.setattr("metapp.storage.records.write_atomically", full)
    run = RunFolder(tmp_path, {}, FIT)
    for repetition in range(5):
        run.add(record("gold", seconds=float(repetition)))
    assert run.finished()["gold"]["seconds"] == 4
    assert len(run.file.read_bytes().splitlines()) == 5


def test_parameters_are_there_before_their_record(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = RunFolder(tmp_path, {})
    monkeypatch.setattr("metapp.storage.records.json.dumps", lambda *_, **__: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        run.add(record("gold"), THETA)
    assert (tmp_path / "params" / "gold.safetensors").is_file()
    assert not run.file.exists()


def add_many(path: Path, writer: int, count: int) -> None:
    run = RunFolder(path, {"steps": 10}, FIT)
    for i in range(count):
        run.add(record(f"task-{writer}-{i}", seconds=0.1, note="x" * 10_000))


def test_what_several_programs_add_at_once_stays(tmp_path: Path) -> None:
    writers = [multiprocessing.get_context("fork").Process(target=add_many, args=(tmp_path, i, 20)) for i in range(4)]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert len(RunFolder(tmp_path, {"steps": 10}, FIT).finished()) == 80


# Names

ANY = st.characters(exclude_categories=["Zs"]) | st.sampled_from(" ./\\\ud800\x1b\u2028")
ODD = ["größe" * 60, "日" * 200, "\x1b[31mred", "caf\udce9", "a\u2028b", "x" * 101]
APART = ["gold", "a b", "a_b", "a/b", "a\\b", "..", ".", "", "/", ".hidden", "hidden", "a\0b", "-x", "task", *ODD]


@settings(max_examples=200, derandomize=True, database=None, deadline=None)
@given(st.text(ANY, max_size=150))
def test_names_of_files_and_tasks_are_safe_and_short(name: str) -> None:
    for make in (safe_name, file_name):
        safe = make(name)
        assert len(safe.encode()) <= 100
        assert safe.isprintable()
        assert make(safe) == safe
    assert file_name(name)[0] != "."
    assert not set(file_name(name)) & set('/\\:*?"<>| \0')


def test_other_names_are_other_files_and_good_names_stay(tmp_path: Path) -> None:
    assert len({file_name(name) for name in APART}) == len(APART)
    assert file_name("gold-1.5_x") == "gold-1.5_x"
    assert safe_name("x" * 101) != safe_name("x" * 102)
    for name in ("gold", "red felt/2", "größe", "x" * 100, ""):
        assert safe_name(name) == name
    run = RunFolder(tmp_path, {}, FIT)
    for index, name in enumerate(ODD):
        run.add(record(name, seconds=0.1), {"w": torch.tensor([index])})
    assert list(run.finished()) == list(map(as_text, ODD))
    for index, name in enumerate(ODD):
        assert run.theta(name)["w"] == run.theta(as_text(name))["w"] == index


def test_names_in_records_of_others_turn_no_text(tmp_path: Path) -> None:
    names = ["a\u202egnp.b", "z\u200bw", "\u0639\u0631\u0628\u064a", "e\u0301tude"]
    (tmp_path / "record.jsonl").write_text("".join(f"{json.dumps({'name': name})}\n" for name in names))
    read = [record["name"] for record in read_records(tmp_path / "record.jsonl")]
    assert read == ["a_gnp.b", "z_w", *names[2:]]
