"""`metapp data` end to end: what is written where, exit codes, and one line for every kind of bad input."""

from __future__ import annotations

import json
import math
import os
import shutil
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from data_tools.readers.nbrdf import SHAPES
from metapp.storage.manifest import read_manifest
from metapp.storage.shards import check_shard, read_shard

FEW = ("--samples", "64")


@pytest.fixture(scope="module")
def gold(tmp_path_factory: pytest.TempPathFactory) -> Path:
    planes = np.full((3, 90, 90, 180), 300.0)
    path = tmp_path_factory.mktemp("merl") / "gold.binary"
    path.write_bytes(struct.pack("<3i", 90, 90, 180) + planes.tobytes())
    return path


def make_network(folder: Path) -> Path:
    folder.mkdir(parents=True)
    rng = np.random.default_rng(0)
    for part, shape in SHAPES.items():
        np.save(folder / f"{part}.npy", rng.normal(0, 0.3, shape).astype(np.float32))
    return folder


# What works


@pytest.mark.usefixtures("small_spheres")
def test_merl_files_become_a_data_set(metapp: Callable, gold: Path, tmp_path: Path) -> None:
    result = metapp("data", "merl", gold, "--out", tmp_path / "out", *FEW)
    assert result == (0, "", f"brdf: 1 train + 0 test tasks in {tmp_path / 'out'}\n")
    (task,) = read_shard(tmp_path / "out", "train", "brdf")
    assert task.name == "gold"
    assert task.data["angles"].shape == (64, 3)
    assert task.data["reflectance"][0].tolist() == pytest.approx([0.2, 0.23, 0.332])
    assert check_shard(tmp_path / "out") == []
    assert read_manifest(tmp_path / "out").notes == {"made_by": "metapp data merl", "samples": 64, "split": "auto"}


@pytest.mark.usefixtures("small_spheres")
def test_networks_become_a_data_set_split_by_the_rule(metapp: Callable, tmp_path: Path) -> None:
    for name in ("tin", "brass", "sub/gold", "felt", "sub/wood", "ink"):
        make_network(tmp_path / "in" / name)
    out = tmp_path / "new" / "out"
    result = metapp("data", "nbrdf", tmp_path / "in", tmp_path / "in" / "tin", "--out", out, *FEW, "--json")
    assert result.code == 0
    assert list(result.document) == ["app", "out", "train", "test", "skipped"]
    assert result.document["app"] == "brdf"
    assert result.document["out"] == str(out)
    assert sorted(result.document["train"]) == ["brass", "felt", "gold", "ink", "wood"]
    assert result.document["test"] == ["tin"]
    assert "5 train + 1 test tasks" in result.err
    assert metapp("data", "nbrdf", tmp_path / "in", "--out", out, "--split", "test", "--quiet", *FEW) == (0, "", "")
    assert {task.split for task in read_manifest(out).tasks} == {"test"}


def test_bad_files_of_a_folder_are_skipped_with_one_line_each(metapp: Callable, gold: Path, tmp_path: Path) -> None:
    shutil.copy(gold, tmp_path / "good.binary")
    (tmp_path / "notes.txt").write_text("about")
    with shutil.copy(gold, tmp_path / "bad.binary").open("r+b") as stream:
        stream.seek(12)
        stream.write(struct.pack("<d", math.nan))
    result = metapp("data", "merl", tmp_path, "--out", tmp_path / "out", *FEW, "--json")
    assert result.code == 0
    assert result.document["train"] == ["good"]
    assert len(result.document["skipped"]) == 2
    lines = result.err.splitlines()
    assert [line.startswith("warning: skipped: ") for line in lines] == [True, True, False]
    assert "notes.txt: 5 bytes" in lines[0]
    assert "bad.binary: 1 values are NaN" in lines[1]
    assert lines[2].endswith("; 2 skipped")


def test_check_says_what_a_set_holds_and_what_is_wrong(metapp: Callable, gold: Path, tmp_path: Path) -> None:
    metapp("data", "merl", gold, "--out", tmp_path, *FEW)
    result = metapp("data", "check", tmp_path)
    assert result.code == 0
    assert result.err == ""
    assert "brdf, 1 train + 0 test tasks, 0.2 MB" in result.out
    assert "reflectance: 1/sr; linear RGB" in result.out
    assert result.out.endswith("no problems\n")
    payload = bytearray((tmp_path / "gold.safetensors").read_bytes())
    payload[-1] ^= 1
    (tmp_path / "gold.safetensors").write_bytes(payload)
    (tmp_path / "extra").write_bytes(b"")
    result = metapp("data", "check", tmp_path)
    assert result.code == 1
    assert [line.split(":")[0] for line in result.err.splitlines()] == ["problem", "problem"]
    result = metapp("data", "check", tmp_path, "--json")
    assert result.code == 1
    assert result.document["app"] == "brdf"
    assert result.document["train"] == 1
    assert len(result.document["problems"]) == 2


# What does not: data is exit code 1 with one line, usage is 2


def truncated(gold: Path, folder: Path) -> Path:
    path = shutil.copy(gold, folder / "short.binary")
    os.truncate(path, 2**25)
    return path


def written(folder: Path, name: str, content: str) -> Path:
    (folder / name).write_text(content)
    return folder / name


# what is wrong with a file, tests/readers holds; here, what a command makes of it
BAD_MERL: dict[str, tuple[Callable[[Path, Path], Path], str]] = {
    "truncated": (truncated, "33,554,432 bytes, expected 34,992,012"),
    "text": (lambda gold, folder: written(folder, "text.binary", "a BRDF"), "text.binary: 6 bytes"),
    "missing": (lambda gold, folder: folder / "none.binary", "none.binary: no such file"),
    "empty folder": (lambda gold, folder: folder, "no MERL file, expected *.binary files"),
}


@pytest.mark.parametrize("kind", BAD_MERL)
def test_bad_merl_files(metapp: Callable, gold: Path, tmp_path: Path, kind: str) -> None:
    make, message = BAD_MERL[kind]
    (tmp_path / "in").mkdir()
    bad = make(gold, tmp_path / "in")
    assert message in metapp("data", "merl", gold, bad, "--out", tmp_path / "new" / "out", *FEW).refusal
    if bad.exists():  # the same, found in a folder that holds nothing else
        assert message in metapp("data", "merl", tmp_path / "in", "--out", tmp_path / "new" / "out", *FEW).refusal
    assert not (tmp_path / "new").exists()


def with_nan(network: Path) -> None:
    np.save(network / "b3.npy", np.full(3, np.nan, np.float32))


BAD_NETWORKS: dict[str, tuple[Callable[[Path], None], str]] = {
    "missing file": (lambda network: (network / "b2.npy").unlink(), "no file for b2, expected fc1.npy"),
    "nan": (with_nan, "b3.npy: holds NaN"),
    "missing folder": (shutil.rmtree, "bad: no such folder"),
}


@pytest.mark.parametrize("kind", BAD_NETWORKS)
def test_bad_networks(metapp: Callable, tmp_path: Path, kind: str) -> None:
    damage, message = BAD_NETWORKS[kind]
    good, bad = make_network(tmp_path / "good"), make_network(tmp_path / "bad")
    damage(bad)
    assert message in metapp("data", "nbrdf", good, bad, "--out", tmp_path / "out", *FEW).refusal
    assert not (tmp_path / "out").exists()


def test_a_folder_of_bad_networks_only(metapp: Callable, tmp_path: Path) -> None:
    for name in ("a", "b"):
        with_nan(make_network(tmp_path / "in" / name))
    result = metapp("data", "nbrdf", tmp_path / "in", "--out", tmp_path / "out", *FEW)
    assert result.code == 1
    assert [line.split(":")[0] for line in result.err.splitlines()] == ["warning", "warning", "error"]
    assert "2 NBRDF networks, none usable" in result.err
    assert not (tmp_path / "out").exists()


def test_two_sources_of_one_name(metapp: Callable, tmp_path: Path) -> None:
    networks = [make_network(tmp_path / name / "gold") for name in ("a", "b")]
    assert "two tasks named 'gold'" in metapp("data", "nbrdf", *networks, "--out", tmp_path / "out", *FEW).refusal


def test_another_applications_folder_is_not_overwritten(metapp: Callable, tmp_path: Path) -> None:
    manifest = {"app": "texture", "schema": 1, "tasks": [], "units": {}, "notes": {}}
    written(tmp_path, "manifest.json", json.dumps(manifest))
    make_network(tmp_path / "in")
    assert "holds tasks of 'texture'" in metapp("data", "nbrdf", tmp_path / "in", "--out", tmp_path, *FEW).refusal


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "no manifest.json"), ("{", "not readable as JSON"), ('{"schema": 7}', "schema 7, written by a newer")],
)
def test_check_refuses_what_is_no_data_set(metapp: Callable, tmp_path: Path, content: str | None, message: str) -> None:
    if content:
        written(tmp_path, "manifest.json", content)
    assert message in metapp("data", "check", tmp_path).refusal
    result = metapp("data", "check", tmp_path, "--json")
    assert result.code == 1
    assert result.document["app"] is None
    assert message in result.document["problems"][0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("merl", "IN", "--out", "OUT", "--split", "valid"), "'valid' is not one of 'train', 'test', 'auto'"),
        (("merl", "IN", "--out", "FILE"), "a file, expected a folder to write to"),
        (("nbrdf", "IN", "--out", "FILE/below"), "a file, expected a folder to write to"),
        (("merl", "IN"), "Missing option '--out'"),
        (("nbrdf", "IN", "--out", "OUT", "--samples", "1"), "'--samples': "),
        (("nbrdf", "IN", "--out", "OUT", "--samples", "few"), "'--samples': "),
        (("synth", "brdf", "--count", "0"), "'--count': "),
        (("synth", "brdf", "--seed", "-1"), "'--seed': "),
        (("synth", "glass"), "'glass' has no embedded data set, expected one of brdf"),
        (("synth", "brdf", "--as", "exr"), "'exr' is not one of 'shards', 'merl'"),
        (("synth", "brdf", "--as", "merl"), "expected a folder for the MERL files"),
        (("synth", "brdf", "--out", "FILE"), "a file, expected a folder to write to"),
    ],
)
def test_bad_usage(metapp: Callable, tmp_path: Path, arguments: tuple[str, ...], message: str) -> None:
    places = {"IN": tmp_path / "in", "OUT": tmp_path / "out", "FILE": written(tmp_path, "file", "")}
    make_network(tmp_path / "in")
    filled = []
    for argument in arguments:
        key, *rest = argument.split("/")
        filled.append("/".join([str(places.get(key, key)), *rest]))
    result = metapp("data", *filled)
    assert result.code == 2
    assert result.out == ""
    errors = [line for line in result.err.splitlines() if line.startswith("Error: ")]
    assert len(errors) == 1
    assert message in errors[0]
    assert not (tmp_path / "out").exists()


def test_a_process_of_its_own_says_one_line_too(tmp_path: Path) -> None:
    arguments = [sys.executable, "-m", "metapp", "data", "merl", str(tmp_path), "--out", str(tmp_path / "out")]
    done = subprocess.run(arguments, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"error: {tmp_path}: no MERL file, expected *.binary files")


def test_help_of_every_command_needs_no_torch() -> None:
    commands = [[], ["synth"], ["merl"], ["nbrdf"], ["check"]]
    lines = "import sys\nfrom metapp.cli import main\n"
    lines += f"for words in {commands}:\n    sys.argv = ['metapp', 'data', *words, '--help']\n"
    lines += "    try:\n        main()\n    except SystemExit:\n        print(words, 'torch' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", lines], capture_output=True, text=True, check=True)
    assert done.stdout.count("Usage") == len(commands)
    assert [line for line in done.stdout.splitlines() if line.startswith("[")] == [f"{each} False" for each in commands]


@pytest.mark.usefixtures("small_spheres")
def test_join_keeps_each_task_in_its_split(metapp: Callable, tmp_path: Path) -> None:
    for split, name in (("train", "tin"), ("test", "ink")):
        made = metapp("data", "nbrdf", make_network(tmp_path / name), "--out", tmp_path / split, "--split", split, *FEW)
        assert made.code == 0
    joined = tmp_path / "joint"
    result = metapp("data", "join", tmp_path / "train", tmp_path / "test", "--out", joined, "--json")
    assert (result.document["train"], result.document["test"]) == (["tin"], ["ink"])
    assert [task.name for task in read_shard(joined, "test", "brdf")] == ["ink"]
    assert check_shard(joined) == []
    again = metapp("data", "join", tmp_path / "train", tmp_path / "train", "--out", joined)
    assert again.code == 1
    assert "two tasks of this name" in again.err
    assert metapp("data", "join", joined, tmp_path / "test", "--out", joined).code == 1
    assert metapp("data", "join", tmp_path / "none", "--out", joined).code == 1
