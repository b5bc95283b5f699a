"""`metapp data images`, `metapp data flash` and `metapp data laval` end to end."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from metapp.storage.manifest import fingerprint, read_manifest
from metapp.storage.shards import check_shard, read_shard
from tests.pictures import environment, noise, photograph, text, truncated, write


def black(path: Path) -> Path:
    return write(path, 0 * noise(48, 48))


def half(path: Path) -> Path:
    return truncated(photograph(path) if path.suffix != ".hdr" else environment(path))


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


@pytest.mark.parametrize(
    ("command", "skipped"),
    [
        ("images", ["notes.txt", "black.png", "half.jpg", "text.jpg", "tiny.png"]),
        ("flash", ["notes.txt", "black.png", "half.jpg", "text.jpg", "tiny.png"]),
        ("laval", ["notes.txt", "black.png", "half.jpg", "text.jpg", "tiny.png", "bad.exr", "half.hdr"]),
    ],
)
def test_bad_files_of_a_folder_are_skipped_with_one_line_each(
    metapp: Callable, tmp_path: Path, command: str, skipped: list[str]
) -> None:
    photograph(tmp_path / "tiny.png", side=1)
    black(tmp_path / "black.png")
    for name in ("text.jpg", "notes.txt", *(["bad.exr"] if command == "laval" else [])):
        text(tmp_path / name)
    half(tmp_path / "half.jpg")
    if command == "laval":
        half(tmp_path / "half.hdr")
        environment(tmp_path / "good.exr")
    else:
        photograph(tmp_path / "good.png")
    result = metapp("data", command, tmp_path, "--out", tmp_path / "out", "--json")
    assert result.code == 0
    assert result.document["train"] == ["good"]
    assert len(result.document["skipped"]) == len(skipped)
    *lines, last = result.err.splitlines()
    assert last.endswith(f"1 train + 0 test tasks in {tmp_path / 'out'}; {len(skipped)} skipped")
    assert [line.split(":")[2].rpartition("/")[2] for line in lines] == skipped


PHOTOGRAPHS: dict[str, tuple[Callable[[Path], object], str, str]] = {
    "text": (lambda folder: text(folder / "a.jpg"), "a.jpg", "not an image ("),
    "truncated": (lambda folder: half(folder / "a.jpg"), "a.jpg", "damaged or incomplete ("),
    "missing": (lambda folder: None, "a.jpg", "no such file"),
    "empty folder": (lambda folder: None, "", "no image in this folder"),
    "same names": (
        lambda folder: [photograph(folder / name / "one" / "b.png") for name in ("", "two")],  # of one material
        "",
        "two tasks named",
    ),
}
MAPS: dict[str, tuple[Callable[[Path], object], str, str]] = {
    "text": (lambda folder: text(folder / "a.exr"), "a.exr", "not an image ("),
    "truncated": (lambda folder: truncated(environment(folder / "a.exr")), "a.exr", "damaged or incomplete ("),
    "missing": (lambda folder: None, "a.exr", "no such file"),
    "empty folder": (lambda folder: None, "", "no image in this folder"),
    "same names": (
        lambda folder: [environment(folder / name) for name in ("one/b.exr", "b.hdr")],
        "",
        "two tasks named 'b'",
    ),
}


BAD = {"images": PHOTOGRAPHS, "flash": PHOTOGRAPHS, "laval": MAPS}


@pytest.mark.parametrize(("command", "kind"), [(command, kind) for command in BAD for kind in BAD[command]])
def test_bad_paths_end_the_conversion_in_one_line(metapp: Callable, tmp_path: Path, command: str, kind: str) -> None:
    make, name, message = BAD[command][kind]
    good = environment(tmp_path / "good.exr") if command == "laval" else photograph(tmp_path / "good.png")
    (tmp_path / "in").mkdir()
    make(tmp_path / "in")
    result = metapp("data", command, good, tmp_path / "in" / name, "--out", tmp_path / "new" / "out")
    assert message in result.refusal
    assert name in result.refusal
    assert not (tmp_path / "new").exists()


def test_maps_become_a_data_set(metapp: Callable, tmp_path: Path) -> None:
    for seed, name in enumerate(("a.exr", "b.hdr", "deep/er/c.exr", "deep/d.EXR", "e.exr")):
        environment(tmp_path / "in" / name, seed)
    out = tmp_path / "out"
    result = metapp("data", "laval", tmp_path / "in", tmp_path / "in" / "a.exr", "--out", out, "--json")
    assert result.err == f"illumination: 4 train + 1 test tasks in {out}\n"
    assert sorted(result.document["train"]) == ["a", "b", "c", "d"]
    assert (result.document["app"], result.document["test"]) == ("illumination", ["e"])
    assert check_shard(out) == []
    assert read_manifest(out).notes == {"made_by": "metapp data laval", "rows": 64, "split": "auto"}
    (task,) = read_shard(out, "test", "illumination")
    shapes = {"map": (3, 64, 128), "scale": (), "photos": (4, 3, 64, 64)}
    assert {key: tuple(value.shape) for key, value in task.data.items()} == shapes


def test_options_of_maps(metapp: Callable, tmp_path: Path) -> None:
    path = environment(tmp_path / "a.exr")
    assert metapp("data", "laval", path, "--out", tmp_path / "one", "--split", "test", "--quiet") == (0, "", "")
    assert [entry.split for entry in read_manifest(tmp_path / "one").tasks] == ["test"]
    assert metapp("data", "laval", path, "--out", tmp_path / "two", "--split", "test").code == 0
    assert fingerprint(tmp_path / "one") == fingerprint(tmp_path / "two")
    for arguments in (("--split", "some"), ("--size", "8"), ("--rows", "64")):
        assert metapp("data", "laval", path, "--out", tmp_path / "new", *arguments).code == 2
    assert not (tmp_path / "new").exists()


def test_a_real_process_says_nothing_else(tmp_path: Path) -> None:
    text(tmp_path / "bad.png")
    half(tmp_path / "half.png")  # libpng writes to standard error by itself
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


def test_a_real_process_reads_other_colours_quietly(tmp_path: Path) -> None:
    # Neither colour-science's warning nor OpenImageIO's notices at exit are for the user.
    environment(tmp_path / "good.exr", oiio_ColorSpace="ACEScg")
    truncated(environment(tmp_path / "half.exr"))
    call = [sys.executable, "-m", "metapp", "data", "laval", tmp_path, "--out", tmp_path / "out"]
    done = subprocess.run(call, capture_output=True, text=True, check=True)
    assert done.stdout == ""
    assert [line.partition(":")[0] for line in done.stderr.splitlines()] == ["warning", "illumination"]


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
    assert "training and test photograph of the material '0001'" in result.refusal
    assert metapp("data", "flash", tmp_path / "in", "--out", tmp_path / "out", "--split", "test").code == 0
