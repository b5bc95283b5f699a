"""Data sets: written whole or not at all, read back, checked against what their manifest says."""

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch
from msgspec.structs import asdict

from metapp.learning.task import Task
from metapp.storage.files import file_name
from metapp.storage.shards import (
    Manifest,
    ManifestEntry,
    fingerprint,
    list_data_set_problems,
    read_data_set,
    read_manifest,
    split_auto,
    write_data_set,
)

UNITS = {"angles": "rad", "reflectance": "1/sr"}


def make_task(name: str, value: float = 1.0) -> Task:
    return Task(name, {"angles": torch.full((4, 3), value), "reflectance": torch.arange(12.0).reshape(4, 3)})


def make_shard(
    folder: Path, names: tuple[str, ...] = ("gold", "silver"), app: str = "brdf", overwrite: bool = False
) -> Path:
    tasks = [
        (make_task(name, index), "test" if index else "train", f"/somewhere/{name}.binary")
        for index, name in enumerate(names)
    ]
    write_data_set(folder, app, UNITS, tasks, {"seed": 7}, overwrite=overwrite)
    return folder


def tamper(folder: Path, **changes: object) -> None:
    path = folder / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


def tamper_task(folder: Path, **changes: object) -> None:
    tasks = json.loads((folder / "manifest.json").read_text())["tasks"]
    tamper(folder, tasks=[{**tasks[0], **changes}, *tasks[1:]])


def test_data_sets_read_back_whole_and_by_split(tmp_path: Path) -> None:
    folder = make_shard(tmp_path / "größe" / "data")
    tasks = read_data_set(folder, app="brdf")
    assert [task.name for task in tasks] == ["gold", "silver"]
    assert torch.equal(tasks[1].data["angles"], torch.ones(4, 3))
    assert torch.equal(tasks[0].data["reflectance"], torch.arange(12.0).reshape(4, 3))
    manifest = read_manifest(folder)
    assert (manifest.app, manifest.units, manifest.notes) == ("brdf", UNITS, {"seed": 7})
    assert manifest.tasks[0].source == "gold.binary"
    assert list_data_set_problems(folder) == []
    assert {path.name for path in folder.iterdir()} == {"gold.safetensors", "manifest.json", "silver.safetensors"}
    assert [task.name for task in read_data_set(folder, "train")] == ["gold"]
    assert [task.name for task in read_data_set(folder, "test")] == ["silver"]
    with pytest.raises(ValueError, match="split 'valid', expected 'train' or 'test'"):
        read_data_set(folder, "valid")
    read_data_set(folder)[0].data["angles"].fill_(5)
    assert list_data_set_problems(folder) == []


def test_texts_are_files_beside(tmp_path: Path) -> None:
    def text(content: str) -> Task:
        return Task(content, {"text": torch.tensor(list(f"[{content!r}]   ".encode()), dtype=torch.uint8)})

    def make(*names: str) -> None:
        tasks = [(text(name), "train", "") for name in names]
        write_data_set(tmp_path, "brdf", {"text": "UTF-8"}, tasks, beside=("text", ".json"), overwrite=True)

    make("gold", "manifest")
    assert {path.name for path in tmp_path.iterdir()} == {
        "gold.safetensors", "gold.json", "manifest-2.safetensors", "manifest-2.json", "manifest.json"
    }  # fmt: skip
    assert (tmp_path / "gold.json").read_bytes() == b"['gold']\n"
    assert list_data_set_problems(tmp_path) == []
    make("silver")
    assert {path.name for path in tmp_path.iterdir()} == {"silver.safetensors", "silver.json", "manifest.json"}


def test_names_become_safe_file_names(tmp_path: Path) -> None:
    names = ("../../escape", "a b", "a/b", "Gold", "gold", "..", "aux", "x" * 300)
    folder = make_shard(tmp_path / "data", names)
    assert [task.name for task in read_data_set(folder)] == list(names)
    files = [entry.file.removesuffix(".safetensors") for entry in read_manifest(folder).tasks]
    assert len({file.lower() for file in files}) == len(names)  # also where capitals do not count
    assert all(file == file_name(file) for file in files)
    assert (files[3], files[4][:6]) == ("Gold", "gold-2")
    assert all((folder / f"{file}.safetensors").is_file() for file in files)
    assert [path.name for path in tmp_path.iterdir()] == ["data"]
    assert list_data_set_problems(folder) == []


@pytest.mark.parametrize(
    ("task", "split", "message"),
    [
        (make_task("gold"), "train", "gold: two tasks of this name"),
        (make_task(" "), "train", "a task with an empty name"),
        (Task("x", {}), "train", "x: a task without tensors"),
        (Task("x", {"colour": torch.ones(1)}), "train", "x: tensor 'colour' has no unit"),
        (Task("x", {"angles": torch.tensor([float("nan")])}), "train", "x: tensor 'angles' holds NaN"),
        (make_task("x"), "valid", "x: split 'valid', expected 'train', 'test' or 'auto'"),
    ],
)
def test_refused_tasks_leave_nothing(tmp_path: Path, task: Task, split: str, message: str) -> None:
    ended = []

    def tasks() -> Iterator[tuple[Task, str, str]]:
        try:
            yield from ((make_task("gold"), "train", ""), (task, split, ""))
        finally:
            ended.append(True)

    with pytest.raises(ValueError, match=message) as caught:
        write_data_set(tmp_path / "new" / "data", "brdf", UNITS, tasks())
    assert ended, caught  # before the error is shown
    assert list(tmp_path.iterdir()) == []


def test_invalid_notes_and_empty_sets_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="notes hold Object of type Tensor"):
        write_data_set(tmp_path, "brdf", UNITS, [], {"seed": torch.ones(1)})
    with pytest.raises(ValueError, match="0 tasks to write"):
        write_data_set(tmp_path, "brdf", UNITS, [])


def test_an_interruption_leaves_what_was_there(tmp_path: Path) -> None:
    folder = make_shard(tmp_path)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}

    def interrupted() -> Iterator[tuple[Task, str, str]]:
        yield make_task("gold", 9), "train", ""
        assert len(list(folder.iterdir())) == 4
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_data_set(folder, "brdf", UNITS, interrupted(), overwrite=True)
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before


def test_failure_while_publishing_leaves_no_manifest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = make_shard(tmp_path)
    replace, calls = os.replace, []

    def fail_second(source: Path, target: Path) -> None:
        calls.append(target)
        if len(calls) == 2:
            raise OSError("disk full")
        replace(source, target)

    monkeypatch.setattr(os, "replace", fail_second)
    with pytest.raises(OSError, match="disk full"):
        make_shard(folder, overwrite=True)
    assert not (folder / "manifest.json").exists()
    assert not list(folder.glob(".partial*"))


def test_a_new_data_set_replaces_the_old_one(tmp_path: Path) -> None:
    folder = make_shard(tmp_path, ("gold", "silver"))
    unfinished = folder / ".partial-1a2b3c4d-tasks"
    unfinished.mkdir()
    os.utime(unfinished, (0, 0))
    with pytest.raises(ValueError, match="holds a data set of 2 tasks, expected a new folder; add --overwrite"):
        make_shard(folder, ("gold", "tin"))
    make_shard(folder, ("gold", "tin"), overwrite=True)
    assert not unfinished.exists()
    assert [task.name for task in read_data_set(folder)] == ["gold", "tin"]
    assert list_data_set_problems(folder) == []
    with pytest.raises(ValueError, match=r"holds tasks of 'brdf', expected an empty folder or tasks of 'texture'"):
        make_shard(folder, app="texture")


def test_missing_parts_wrong_kinds_and_links_out_are_refused(tmp_path: Path) -> None:
    (tmp_path / "data").write_bytes(b"")
    with pytest.raises(ValueError, match="a file, expected a folder"):
        make_shard(tmp_path / "data")
    with pytest.raises(ValueError, match="a file, expected the folder"):
        read_data_set(tmp_path / "data")
    with pytest.raises(ValueError, match="no such folder, expected the folder of a data set"):
        read_data_set(tmp_path / "none")
    with pytest.raises(ValueError, match=r"no manifest.json, expected one beside the tasks"):
        read_data_set(tmp_path)
    folder = make_shard(tmp_path / "set")
    with pytest.raises(ValueError, match="holds tasks of 'brdf', expected 'texture'"):
        read_data_set(folder, app="texture")
    (folder / "silver.safetensors").unlink()
    with pytest.raises(ValueError, match=r"silver.safetensors: missing"):
        read_data_set(folder)
    assert len(list_data_set_problems(folder)) == 1
    folder = make_shard(tmp_path / "linked")
    (folder / "gold.safetensors").rename(tmp_path / "gold.safetensors")
    (folder / "gold.safetensors").symlink_to(tmp_path / "gold.safetensors")
    with pytest.raises(ValueError, match="a link that leads out"):
        read_data_set(folder)


def test_check_finds_tampering(tmp_path: Path) -> None:
    folder = make_shard(tmp_path, ("gold", "silver", "tin"))
    payload = bytearray((folder / "gold.safetensors").read_bytes())
    payload[-4:] = b"\0\0\xc0\x7f"  # NaN
    (folder / "gold.safetensors").write_bytes(payload)
    (folder / "silver.safetensors").write_bytes(b"junk")
    for name in ("extra.txt", ".DS_Store"):
        (folder / name).write_bytes(b"")
    problems = list_data_set_problems(folder)
    assert len(problems) == 4
    assert "gold.safetensors: SHA-256" in problems[0]
    assert "gold.safetensors: tensor 'reflectance' holds NaN" in problems[1]
    assert "silver.safetensors: not readable as safetensors" in problems[2]
    assert "extra.txt: not listed" in problems[3]
    tamper_task(make_shard(tmp_path / "other"), sha256="0" * 64)
    assert "expected 000000000000" in list_data_set_problems(tmp_path / "other")[0]
    tamper(folder, schema=2)  # the one problem
    assert len(list_data_set_problems(folder)) == 1
    with pytest.raises(ValueError, match="schema 2"):
        read_data_set(folder)


def test_fingerprints_depend_on_content_alone(tmp_path: Path) -> None:
    first = fingerprint(make_shard(tmp_path / "a"))
    assert len(first) == 12
    assert fingerprint(make_shard(tmp_path / "b")) == first
    tamper(tmp_path / "b", notes={})
    assert fingerprint(tmp_path / "b") == first
    assert fingerprint(make_shard(tmp_path / "c", ("gold", "tin"))) != first
    tamper_task(tmp_path / "b", split="test")
    assert fingerprint(tmp_path / "b") != first


def test_splits_follow_the_rule(tmp_path: Path) -> None:
    split = split_auto(f"{index:02}" for index in range(80))
    assert list(split.values()).count("test") == 16
    assert [name for name, part in split.items() if part == "test"][:3] == ["04", "09", "14"]
    assert split_auto("abcda") == dict.fromkeys("abcd", "train")
    tasks = [(make_task(name), "auto", "") for name in "gfedcb"] + [(make_task("a"), "test", "")]
    splits = {entry.name: entry.split for entry in write_data_set(tmp_path, "brdf", UNITS, tasks)}
    assert splits == {**split_auto("bcdefg"), "a": "test"}
    assert [entry.split for entry in read_manifest(tmp_path).tasks] == list(splits.values())
    assert [name for name, split in splits.items() if split == "test"] == ["f", "a"]


# Manifests that anybody may have written


GOLD = ManifestEntry("gold", "gold.safetensors", "train", "gold.binary", "0" * 64)
SILVER = ManifestEntry("silver", "silver.safetensors", "test", "", "1" * 64)
MANIFEST = Manifest("brdf", (GOLD, SILVER), {"angles": "rad"}, {"seed": 7})


def write(folder: Path, **changes: object) -> None:
    plain = asdict(MANIFEST) | {"tasks": [asdict(GOLD), asdict(SILVER)]}
    (folder / "manifest.json").write_text(json.dumps({**plain, **changes}))


def test_manifests_are_read_as_they_are(tmp_path: Path) -> None:
    write(tmp_path)
    assert read_manifest(tmp_path) == MANIFEST


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"schema": 2}, "schema 2, written by a newer metapp, expected 1; update metapp"),
        ({"schema": True}, r"damaged, .*Expected `int`, got `bool` - at `\$.schema`"),
        ({"schema": 0}, "schema 0, expected 1; convert the data again"),
        ({"app": None}, r"Expected `str`, got `null` - at `\$.app`"),
        ({"tasks": [3]}, r"Expected `object`, got `int` - at `\$.tasks\[0\]`"),
        ({"tasks": [{"name": "gold"}]}, "file '', expected the plain name"),
        ({"tasks": [asdict(GOLD) | {"name": "silver"}, asdict(SILVER)]}, "two tasks have the same name"),
        *(
            (content, "damaged, expected the manifest of a data set")
            for content in (b"{", b"\xff\xfe", b"", b"[" * 100_000)
        ),
    ],
)
def test_damaged_manifests_are_refused(tmp_path: Path, changes: dict[str, object] | bytes, message: str) -> None:
    if isinstance(changes, bytes):
        (tmp_path / "manifest.json").write_bytes(changes)
    else:
        write(tmp_path, **changes)
    with pytest.raises(ValueError, match=message):
        read_manifest(tmp_path)
    before = (tmp_path / "manifest.json").read_bytes()
    with pytest.raises(ValueError, match="To keep what is there, choose another folder"):
        make_shard(tmp_path, ("tin",))
    assert (tmp_path / "manifest.json").read_bytes() == before


@pytest.mark.parametrize(
    "file", ["../gold.safetensors", "/etc/gold.safetensors", "a/gold.safetensors", "a\\gold.safetensors",
             "..", "C:gold.safetensors", "gold.pkl", ".safetensors", ""],
)  # fmt: skip
def test_paths_that_leave_the_folder_are_refused(tmp_path: Path, file: str) -> None:
    write(tmp_path, tasks=[{**asdict(GOLD), "file": file}, asdict(SILVER)])
    with pytest.raises(ValueError, match=r"expected the plain name of a \.safetensors file in the same folder"):
        read_manifest(tmp_path)
