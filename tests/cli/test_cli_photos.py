"""`metapp data images` and `metapp data flash` end to end."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from metapp.storage.manifest import fingerprint, read_manifest
from metapp.storage.shards import check_shard, read_shard


def photograph(path: Path, seed: int = 0, side: int = 48) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    output = oiio.ImageOutput.create(str(path))
    output.open(str(path), oiio.ImageSpec(side, side, 3, "uint8"))
    output.write_image(np.random.default_rng(seed).integers(0, 256, (side, side, 3), dtype=np.uint8))
    output.close()
    return path


def black(path: Path) -> Path:
    output = oiio.ImageOutput.create(str(path))
    output.open(str(path), oiio.ImageSpec(48, 48, 3, "uint8"))
    output.write_image(np.zeros((48, 48, 3), np.uint8))
    output.close()
    return path


def text(path: Path) -> Path:
    path.write_text("in words")
    return path


def truncated(path: Path) -> Path:
    photograph(path)
    os.truncate(path, path.stat().st_size // 2)
    return path


def test_photographs_become_texture_tasks(metapp: Callable, tmp_path: Path) -> None:
    for index, name in enumerate(("bark", "sand", "grass", "sub/moss", "sub/wall", "rust")):
        photograph(tmp_path / "in" / f"{name}.png", index)
    out = tmp_path / "out"
    assert metapp("data", "images", tmp_path / "in", "--out", out, "--json").document == {
        "app": "texture",
        "out": str(out),
        "train": ["bark", "grass", "rust", "moss", "wall"],
        "test": ["sand"],
        "skipped": [],
    }
    assert check_shard(out) == []
    assert read_manifest(out).notes == {"made_by": "metapp data images", "size": 256, "split": "auto"}
    assert {task.data["image"].shape for task in read_shard(out)} == {(3, 256, 256)}


def test_options(metapp: Callable, tmp_path: Path) -> None:
    photo = photograph(tmp_path / "in" / "bark.png")
    out = tmp_path / "out"
    result = metapp("data", "images", photo, "--out", out, "--split", "test", "--size", "64")
    assert result == (0, "", f"texture: 0 train + 1 test tasks in {out}\n")
    (task,) = read_shard(out, "test", "texture")
    assert task.data["image"].shape == (3, 64, 64)
    assert metapp("data", "images", photo, "--out", tmp_path / "quiet", "--quiet") == (0, "", "")
    for option, value, shown in (
        ("--size", "31", "greater than or equal to 32"),
        ("--size", "x", "valid integer"),
    ):
        result = metapp("data", "images", photo, "--out", tmp_path / "new", option, value)
        assert result.code == 2
        assert shown in result.err
        assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("command", ["images", "flash"])
def test_the_same_photographs_give_the_same_data(metapp: Callable, tmp_path: Path, command: str) -> None:
    paths = [photograph(tmp_path / "in" / f"{name}.jpg", seed) for seed, name in enumerate("abcdef")]
    assert metapp("data", command, tmp_path / "in", "--out", tmp_path / "one").code == 0
    assert metapp("data", command, *reversed(paths), "--out", tmp_path / "two").code == 0
    assert fingerprint(tmp_path / "one") == fingerprint(tmp_path / "two")
    digests = [
        {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in folder.glob("*.safetensors")}
        for folder in (tmp_path / "one", tmp_path / "two")
    ]
    assert digests[0] == digests[1]


@pytest.mark.parametrize("command", ["images", "flash"])
def test_bad_files_of_a_folder_are_skipped_with_one_line_each(metapp: Callable, tmp_path: Path, command: str) -> None:
    photograph(tmp_path / "good.png")
    photograph(tmp_path / "tiny.png", side=1)
    black(tmp_path / "black.png")
    text(tmp_path / "text.jpg")
    text(tmp_path / "notes.txt")
    truncated(tmp_path / "half.jpg")
    result = metapp("data", command, tmp_path, "--out", tmp_path / "out", "--json")
    assert result.code == 0
    assert result.document["train"] == ["good"]
    assert len(result.document["skipped"]) == 5
    *lines, last = result.err.splitlines()
    assert last.endswith("1 train + 0 test tasks in " + str(tmp_path / "out") + "; 5 skipped")
    assert [line.split(":")[2].rpartition("/")[2] for line in lines] == [
        "notes.txt", "black.png", "half.jpg", "text.jpg", "tiny.png",
    ]  # fmt: skip


BAD: dict[str, tuple[Callable[[Path], Path], str]] = {
    "1x1": (lambda folder: photograph(folder / "a.png", side=1), "a.png: 1x1 px, expected 32 px or more"),
    "black": (lambda folder: black(folder / "a.png"), "a.png: one colour all over"),
    "text": (lambda folder: text(folder / "a.jpg"), "a.jpg: not an image ("),
    "text, other suffix": (lambda folder: text(folder / "a.txt"), "a.txt: not an image ("),
    "truncated": (lambda folder: truncated(folder / "a.jpg"), "a.jpg: damaged or incomplete ("),
    "missing": (lambda folder: folder / "a.jpg", "a.jpg: no such file"),
    "empty folder": (lambda folder: folder, "no image in this folder"),
    "same names": (
        lambda folder: [photograph(folder / "one" / "b.png"), photograph(folder / "b.png"), folder][-1],
        "two tasks named",
    ),
}


@pytest.mark.parametrize("command", ["images", "flash"])
@pytest.mark.parametrize("kind", BAD)
def test_bad_paths_end_the_conversion_in_one_line(metapp: Callable, tmp_path: Path, command: str, kind: str) -> None:
    make, message = BAD[kind]
    (tmp_path / "in").mkdir()
    bad = make(tmp_path / "in")
    if (command, kind) == ("flash", "same names"):
        photograph(tmp_path / "in" / "two" / "one" / "b.png")  # of one material, under one name
    result = metapp("data", command, photograph(tmp_path / "good.png"), bad, "--out", tmp_path / "new" / "out")
    assert result.code == 1
    assert result.out == ""
    assert result.err.startswith("error: ")
    assert message in result.err
    assert result.err.count("\n") == 1
    assert not (tmp_path / "new").exists()


def test_a_real_process_says_nothing_else(tmp_path: Path) -> None:
    text(tmp_path / "bad.png")
    truncated(tmp_path / "half.png")  # libpng writes to standard error by itself
    photograph(tmp_path / "good.png")
    call = [sys.executable, "-m", "metapp", "data", "images", tmp_path, "--out", tmp_path / "out"]
    done = subprocess.run(call, capture_output=True, text=True, check=True)
    assert done.stdout == ""
    assert [line.partition(":")[0] for line in done.stderr.splitlines()] == ["warning", "warning", "texture"]
    done = subprocess.run([*call[:5], tmp_path / "half.png", *call[6:]], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr.startswith(f"error: {tmp_path / 'half.png'}: damaged or incomplete")
    assert done.stderr.count("\n") == 1


def test_flash_photographs_are_split_by_material(metapp: Callable, tmp_path: Path) -> None:
    names = [f"train_{material:02d}_{image}" for material in range(6) for image in range(1 + material % 3)]
    for seed, name in enumerate(names):
        photograph(tmp_path / "in" / f"{name}.png", seed)
    text(tmp_path / "in" / "metadata.json")
    result = metapp("data", "flash", tmp_path / "in", "--out", tmp_path / "out", "--size", "32", "--json")
    assert result.document["app"] == "svbrdf_stationary"
    assert result.document["test"] == ["04_0", "04_1"]
    assert len(result.document["train"]) == len(names) - 2
    assert result.document["skipped"] == []
    assert read_manifest(tmp_path / "out").notes == {"made_by": "metapp data flash", "size": 32, "split": "auto"}
    assert {task.data["image"].shape for task in read_shard(tmp_path / "out")} == {(3, 32, 32)}
    for split in ("train", "test"):
        metapp("data", "flash", tmp_path / "in", "--out", tmp_path / "out", "--split", split)
        assert {entry.split for entry in read_manifest(tmp_path / "out").tasks} == {split}


def test_flash_photographs_keep_the_split_they_come_with(metapp: Callable, tmp_path: Path) -> None:
    for seed, name in enumerate(("test/0280/flash", "test/0281/flash", "train/0001/flash", "train/0001/other")):
        photograph(tmp_path / "in" / f"{name}.png", seed)
    document = metapp("data", "flash", tmp_path / "in", "--out", tmp_path / "out", "--json").document
    assert document["train"] == ["0001_flash", "0001_other"]
    assert document["test"] == ["0280_flash", "0281_flash"]
    photograph(tmp_path / "in" / "test" / "0001" / "flash-2.png")
    result = metapp("data", "flash", tmp_path / "in", "--out", tmp_path / "out")
    assert result.code == 1
    assert "training and test photograph of the material '0001'" in result.err
    assert metapp("data", "flash", tmp_path / "in", "--out", tmp_path / "out", "--split", "test").code == 0
