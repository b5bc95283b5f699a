"""`metapp data` end to end: what is written where, exit codes, and one line for every kind of bad input."""

from __future__ import annotations

import shutil
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from metapp.storage.shards import check_shard, read_manifest, read_shard
from tests.conftest import Result

FEW = ("--samples", "64")


@pytest.fixture(scope="module")
def gold(tmp_path_factory: pytest.TempPathFactory) -> Path:
    planes = np.full((3, 90, 90, 180), 300.0)
    path = tmp_path_factory.mktemp("merl") / "gold.binary"
    path.write_bytes(struct.pack("<3i", 90, 90, 180) + planes.tobytes())
    return path


@pytest.fixture
def network_at(network: Path) -> Callable[..., Path]:
    """Copies a network to a place."""
    return lambda *place: Path(shutil.copytree(network, Path(*place)))


# What works


@pytest.mark.usefixtures("small_spheres")
def test_merl_files_become_a_data_set(metapp: Callable, gold: Path) -> None:
    result = metapp("data", "merl", gold, "--out", "out", *FEW)
    assert result == (0, "", "brdf: 1 train + 0 test tasks in out\n")
    (task,) = read_shard(Path("out"), "train", "brdf")
    assert task.name == "gold"
    assert task.data["angles"].shape == (64, 3)
    assert task.data["reflectance"][0].tolist() == pytest.approx([0.2, 0.23, 0.332])
    assert check_shard(Path("out")) == []
    assert read_manifest(Path("out")).notes == {"made_by": "metapp data merl", "samples": 64, "split": "auto"}


@pytest.mark.usefixtures("small_spheres")
def test_networks_become_a_data_set_split_by_the_rule(metapp: Callable, network_at: Callable) -> None:
    for name in ("tin", "brass", "sub/gold", "felt", "sub/wood", "ink"):
        network_at("in", name)
    result = metapp("data", "nbrdf", "in", "in/tin", "--out", "new/out", *FEW, "--json")
    train = result.done.pop("train")
    assert sorted(train) == ["brass", "felt", "gold", "ink", "wood"]
    assert list(result.document) == ["app", "out", "train", "test", "skipped"]
    assert result.document == {"app": "brdf", "out": "new/out", "train": train, "test": ["tin"], "skipped": []}
    assert "5 train + 1 test tasks" in result.err
    again = ("--split", "test", "--overwrite", "--quiet", *FEW)
    assert metapp("data", "nbrdf", "in", "--out", "new/out", *again) == (0, "", "")
    assert {task.split for task in read_manifest(Path("new/out")).tasks} == {"test"}


def test_check_says_what_a_set_holds_and_what_is_wrong(metapp: Callable, gold: Path) -> None:
    metapp("data", "merl", gold, "--out", "out", *FEW)
    code, out, err = metapp("data", "check", "out")
    assert (code, err) == (0, "")
    assert "brdf, 1 train + 0 test tasks, 0.2 MB" in out
    assert "reflectance: 1/sr; linear RGB" in out
    assert out.endswith("no problems\n")
    shard = Path("out/gold.safetensors")
    payload = bytearray(shard.read_bytes())
    payload[-1] ^= 1
    shard.write_bytes(payload)
    Path("out/extra").write_bytes(b"")
    code, _, err = metapp("data", "check", "out")
    assert code == 1
    assert [line.split(":")[0] for line in err.splitlines()] == ["problem", "problem"]
    result = metapp("data", "check", "out", "--json")
    assert (result.code, result.document["app"], result.document["train"]) == (1, "brdf", 1)
    assert len(result.document["problems"]) == 2


# What does not: data is exit code 1 with one line, usage is 2


def test_bad_inputs_are_one_line_and_write_nothing(metapp: Callable, gold: Path, network_at: Callable) -> None:
    """What is wrong with a file, tests/readers hold; here, what a command makes of it."""
    for name in ("bad", "worse"):
        np.save(network_at("in", name) / "b3.npy", np.full(3, np.nan, np.float32))
    same = [network_at(name, "gold") for name in ("c", "d")]
    for words, message in (
        (("merl", gold, "none.binary"), "none.binary: no such file"),
        (("nbrdf", "in/bad", same[0]), "b3.npy: holds NaN"),
        (("nbrdf", *same), "two tasks named 'gold'"),
    ):
        assert message in metapp("data", *words, "--out", "out", *FEW).refusal
    result = metapp("data", "nbrdf", "in", "--out", "out", *FEW)
    assert result.code == 1
    assert [line.split(":")[0] for line in result.err.splitlines()] == ["warning", "warning", "error"]
    assert "in: 2 sources, none usable" in result.err
    assert not Path("out").exists()


BAD_USAGE = """
merl in --out out --split valid    | 'valid' is not one of 'train', 'test', 'auto'
nbrdf in --out file/below          | a file, expected a folder to write to
merl in                            | Missing option '--out'
nbrdf in --out out --samples 1     | --samples 1: expected 2
synth brdf --count 0               | '--count':
synth glass                        | 'glass' has no embedded data set, expected one of brdf
synth brdf --as exr                | 'exr': expected shards, merl for brdf
synth brdf --as merl               | expected a folder for the merl files
synth brdf --as merl --out merl    | merl/test: is there already
cornell --out out --count 0        | '--count':
images in --out out --size x        | valid integer
strips in --out out --gamma 0       | --gamma 0.0: expected 0.1 to 10
maps in --out out --normals left    | --normals 'left': expected one of opengl
"""


def test_bad_usage(metapp: Callable, network_at: Callable) -> None:
    network_at("in")
    Path("file").write_text("")
    Path("merl/test").mkdir(parents=True)
    for words, message in (line.split(" | ") for line in BAD_USAGE.strip().splitlines()):
        assert message.strip() in metapp("data", *words.split()).misuse, words
    assert not Path("out").exists()


@pytest.mark.usefixtures("small_spheres")
def test_join_keeps_each_task_in_its_split(metapp: Callable, network_at: Callable) -> None:
    for split, name in (("train", "tin"), ("test", "ink")):
        made = metapp("data", "nbrdf", network_at(name), "--out", split, "--split", split, *FEW)
        assert made.code == 0

    def join(*sets: str) -> Result:
        return metapp("data", "join", *sets, "--out", "joint", "--overwrite", "--json")

    document = join("train", "test").done
    assert (document["train"], document["test"]) == (["tin"], ["ink"])
    assert [task.name for task in read_shard(Path("joint"), "test", "brdf")] == ["ink"]
    assert check_shard(Path("joint")) == []
    assert join("train", "test", "--alike").done["train"] == ["tin"]
    assert {task.name: task.data["kind"].tolist() for task in read_shard(Path("joint"))} == {"tin": [0], "ink": [1]}
    assert check_shard(Path("joint")) == []
    assert "two tasks of this name" in join("train", "train").error
    assert join("joint", "test").error
    assert join("none").error
