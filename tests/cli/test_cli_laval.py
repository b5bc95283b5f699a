"""`metapp data laval` end to end."""

from __future__ import annotations

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


def environment(path: Path, seed: int = 0, space: str = "") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    spec = oiio.ImageSpec(64, 32, 3, "float")
    if space:
        spec.attribute("oiio:ColorSpace", space)
    output = oiio.ImageOutput.create(str(path))
    output.open(str(path), spec)
    output.write_image(np.random.default_rng(seed).uniform(0.1, 9, (32, 64, 3)).astype(np.float32))
    output.close()
    return path


def truncated(path: Path) -> Path:
    environment(path)
    os.truncate(path, path.stat().st_size // 2)
    return path


def text(path: Path) -> Path:
    path.write_text("in words")
    return path


def test_maps_become_a_data_set(metapp: Callable, tmp_path: Path) -> None:
    for seed, name in enumerate(("a.exr", "b.hdr", "deep/er/c.exr", "deep/d.EXR", "e.exr")):
        environment(tmp_path / "in" / name, seed)
    out = tmp_path / "out"
    result = metapp("data", "laval", tmp_path / "in", tmp_path / "in" / "a.exr", "--out", out, "--json")
    assert result.code == 0
    assert result.err == f"illumination: 4 train + 1 test tasks in {out}\n"
    assert sorted(result.document["train"]) == ["a", "b", "c", "d"]
    assert result.document["test"] == ["e"]
    assert result.document["app"] == "illumination"
    assert check_shard(out) == []
    assert read_manifest(out).notes == {"made_by": "metapp data laval", "rows": 64, "split": "auto"}
    task = read_shard(out, "test", "illumination")[0]
    assert {key: tuple(value.shape) for key, value in task.data.items()} == {
        "map": (3, 64, 128), "scale": (), "photos": (4, 3, 64, 64)
    }  # fmt: skip


def test_options(metapp: Callable, tmp_path: Path) -> None:
    path = environment(tmp_path / "a.exr")
    assert metapp("data", "laval", path, "--out", tmp_path / "one", "--split", "test", "--quiet") == (0, "", "")
    assert [entry.split for entry in read_manifest(tmp_path / "one").tasks] == ["test"]
    assert metapp("data", "laval", path, "--out", tmp_path / "two", "--split", "test").code == 0
    assert fingerprint(tmp_path / "one") == fingerprint(tmp_path / "two")
    for arguments in (("--split", "some"), ("--size", "8"), ("--rows", "64")):
        assert metapp("data", "laval", path, "--out", tmp_path / "new", *arguments).code == 2
    assert not (tmp_path / "new").exists()


def test_bad_files_of_a_folder_are_skipped_with_one_line_each(metapp: Callable, tmp_path: Path) -> None:
    environment(tmp_path / "good.exr")
    text(tmp_path / "bad.exr")
    truncated(tmp_path / "half.hdr")
    text(tmp_path / "notes.txt")
    output = oiio.ImageOutput.create("a.png")
    output.open(str(tmp_path / "good.png"), oiio.ImageSpec(64, 64, 3, "uint8"))
    output.write_image(np.full((64, 64, 3), 99, np.uint8))
    output.close()
    result = metapp("data", "laval", tmp_path, "--out", tmp_path / "out", "--json")
    assert result.code == 0
    assert result.document["train"] == ["good"]
    *lines, last = result.err.splitlines()
    assert last.endswith("; 4 skipped")
    assert [line.split(":")[2].rpartition("/")[2] for line in lines] == [
        "notes.txt", "good.png", "bad.exr", "half.hdr",
    ]  # fmt: skip


BAD: dict[str, tuple[Callable[[Path], Path], str]] = {
    "text": (lambda folder: text(folder / "a.exr"), "a.exr: not an image ("),
    "truncated": (lambda folder: truncated(folder / "a.exr"), "a.exr: damaged or incomplete ("),
    "missing": (lambda folder: folder / "a.exr", "a.exr: no such file"),
    "empty folder": (lambda folder: folder, "no image in this folder"),
    "same names": (
        lambda folder: [environment(folder / "one" / "b.exr"), environment(folder / "b.hdr"), folder][-1],
        "two tasks named 'b'",
    ),
}


@pytest.mark.parametrize("kind", BAD)
def test_bad_paths_end_the_conversion_in_one_line(metapp: Callable, tmp_path: Path, kind: str) -> None:
    make, message = BAD[kind]
    (tmp_path / "in").mkdir()
    bad = make(tmp_path / "in")
    result = metapp("data", "laval", environment(tmp_path / "good.exr"), bad, "--out", tmp_path / "new" / "out")
    assert result.code == 1
    assert result.out == ""
    assert result.err.startswith("error: ")
    assert message in result.err
    assert result.err.count("\n") == 1
    assert not (tmp_path / "new").exists()


def test_a_real_process_says_nothing_else(tmp_path: Path) -> None:
    # Neither colour-science's warning nor OpenImageIO's notices at exit are for the user.
    environment(tmp_path / "good.exr", space="ACEScg")
    truncated(tmp_path / "half.exr")
    call = [sys.executable, "-m", "metapp", "data", "laval", tmp_path, "--out", tmp_path / "out"]
    done = subprocess.run(call, capture_output=True, text=True, check=True)
    assert done.stdout == ""
    assert [line.partition(":")[0] for line in done.stderr.splitlines()] == ["warning", "illumination"]
