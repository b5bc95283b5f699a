"""Manifests that anybody may have written: every field is checked, and no path leads out of the folder."""

import json
from pathlib import Path

import pytest

from metapp.storage.shards import Entry, Manifest, read_manifest, to_json

GOLD = Entry("gold", "gold.safetensors", "train", "gold.binary", "0" * 64)
SILVER = Entry("silver", "silver.safetensors", "test", "", "1" * 64)
MANIFEST = Manifest("brdf", (GOLD, SILVER), {"angles": "rad"}, {"seed": 7})


def write(folder: Path, **changes: object) -> None:
    (folder / "manifest.json").write_text(json.dumps({**json.loads(to_json(MANIFEST)), **changes}))


def test_round_trip(tmp_path: Path) -> None:
    write(tmp_path)
    assert read_manifest(tmp_path) == MANIFEST
    tasks = [{key: value for key, value in entry._asdict().items() if key != "beside"} for entry in (GOLD, SILVER)]
    write(tmp_path, tasks=tasks)
    assert read_manifest(tmp_path) == MANIFEST


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"schema": 2}, "schema 2, written by a newer metapp, expected 1; update metapp"),
        ({"schema": True}, "'schema' is true, expected a whole number"),
        ({"schema": 0}, "schema 0, expected 1; convert the data again"),
        ({"app": None}, "'app' is null, expected text"),
        ({"tasks": {}}, "'tasks' is {}, expected a list"),
        ({"tasks": [3]}, "task 1: 'name' is null, expected text"),
        ({"units": {"angles": 1}}, "units: 'angles' is 1, expected text"),
        ({"tasks": [GOLD._asdict() | {"name": "silver"}, SILVER._asdict()]}, "two tasks have the same name"),
        *((content, "not readable as JSON") for content in (b"{", b"\xff\xfe", b"", b"[" * 100_000)),
    ],
)
def test_damaged_manifests(tmp_path: Path, changes: dict[str, object] | bytes, message: str) -> None:
    if isinstance(changes, bytes):
        (tmp_path / "manifest.json").write_bytes(changes)
    else:
        write(tmp_path, **changes)
    with pytest.raises(ValueError, match=message):
        read_manifest(tmp_path)


@pytest.mark.parametrize(
    "file", ["../gold.safetensors", "/etc/gold.safetensors", "a/gold.safetensors", "a\\gold.safetensors",
             "..", "C:gold.safetensors", "gold.pkl", ".safetensors", ""],
)  # fmt: skip
def test_paths_that_leave_the_folder(tmp_path: Path, file: str) -> None:
    write(tmp_path, tasks=[{**GOLD._asdict(), "file": file}, SILVER._asdict()])
    with pytest.raises(ValueError, match=r"expected the plain name of a \.safetensors file in the same folder"):
        read_manifest(tmp_path)


def test_a_file_beside_a_shard_is_named_as_it(tmp_path: Path) -> None:
    write(tmp_path, tasks=[{**GOLD._asdict(), "beside": "gold.json"}, SILVER._asdict()])
    assert read_manifest(tmp_path).tasks[0].beside == "gold.json"
    for beside in ("../gold.json", "silver.json", "notes.txt", "gold", "gold.safetensors", "manifest.json"):
        write(tmp_path, tasks=[{**GOLD._asdict(), "beside": beside}, SILVER._asdict()])
        with pytest.raises(ValueError, match=r"expected the name of gold\.safetensors with another suffix"):
            read_manifest(tmp_path)
