"""Folders of earlier versions, whose records and headers say "start" for the checkpoint, are gone on with."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from metapp.storage.packing import Pack, read_pack, write_pack
from metapp.storage.records import RunFolder, key_of, load_checkpoint, read_records, save_checkpoint

pytestmark = pytest.mark.usefixtures("small_spheres")


def as_it_was(runs: Path) -> Path:
    """Rename all that was named otherwise; the run's folder."""
    (runs / "brdf" / "checkpoints").rename(runs / "brdf" / "starts")
    (file,) = runs.rglob("general.safetensors")
    prepared, info = load_checkpoint(file)
    info["start"] = info.pop("checkpoint")
    stamp = file.read_bytes()
    save_checkpoint(file, prepared, info)
    assert file.read_bytes() != stamp
    (records,) = runs.rglob("record.jsonl")
    lines = []
    for line in records.read_text().splitlines():
        record = json.loads(line)
        record["settings"]["start"] = record["settings"].pop("checkpoint")
        lines.append(json.dumps(record))
    records.write_text("\n".join(lines) + "\n")
    return records.parent


@pytest.fixture
def general(metapp: Callable, ten_materials: Path, tmp_path: Path) -> Callable:
    words = ("general", "brdf", "--recipe", "quick", "--data", ten_materials, "--out", tmp_path / "runs", "--json")
    return lambda *more: metapp(*words, *more)


def test_the_key_of_records_is_the_same() -> None:
    assert key_of({"app": "brdf", "checkpoint": "0"}) == key_of({"app": "brdf", "start": "0"})
    assert key_of({"checkpoint": "0"}) != key_of({"checkpoint": "1"})


def test_runs_and_checkpoints_are_found_again(general: Callable, tmp_path: Path) -> None:
    before = general("--train", "--train-steps", "2").document
    folder = as_it_was(tmp_path / "runs")
    again = general()
    assert "/starts/" in again.err
    assert again.document["out"] == before["out"] == str(folder)
    assert [task["error"] for task in again.document["tasks"]] == [task["error"] for task in before["tasks"]]
    assert general("--train", "--train-steps", "3").code == 0
    assert list((tmp_path / "runs" / "brdf" / "starts").rglob("general.previous.safetensors"))  # it is replaced there
    assert not (tmp_path / "runs" / "brdf" / "checkpoints").exists()


def test_a_run_that_was_cut_off_is_completed(general: Callable, metapp: Callable, tmp_path: Path) -> None:
    first = general()  # by the checkpoint that ships, whose header says "start"
    (file,) = (tmp_path / "runs").rglob("record.jsonl")
    record = json.loads(file.read_text().splitlines()[0])
    record["settings"]["start"] = record["settings"].pop("checkpoint")
    file.write_text(json.dumps(record | {"seconds": 1e6}) + "\n")
    assert [task["seconds"] == 1e6 for task in general().document["tasks"]] == [True, False]
    (one, other) = read_records(file)
    assert one["settings"] == other["settings"]
    assert RunFolder(file.parent, other["settings"]).finished().keys() == {one["name"], other["name"]}
    assert metapp("rerun", first.document["out"], "--quiet").code == 0
    packed = Path(metapp("pack", first.document["out"], "--json", "--quiet").document["file"])
    names, tensors, about = read_pack(packed)
    about["settings"]["start"] = about["settings"].pop("checkpoint")
    write_pack(packed, Pack(names, tensors, about))
    assert metapp("unpack", packed, "--out", tmp_path / "unpacked", "--quiet").code == 0
