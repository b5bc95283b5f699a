"""`metapp data synth` and `metapp data cornell`: sets that are drawn, made once, the same on every machine."""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from data_tools.readers.merl import read_merl
from data_tools.synthetic import transport as synthetic_transport
from data_tools.synthetic.transport import cornell_tasks, synthetic_tasks
from metapp.rendering.scenes.rules import scene_of
from metapp.runs.inputs.embedded import embedded_data, split_counts
from metapp.storage.shards import check_shard, read_manifest, read_shard
from tests.needs_mitsuba import needs_mitsuba

FEW = ("--samples", "200", "--held", "50")


@pytest.mark.usefixtures("small_spheres")
def test_synth_makes_a_set_once(metapp: Callable, cache: Path) -> None:
    result = metapp("data", "synth", "brdf", "--count", "5", "--json")
    folder = Path(result.document["out"])
    assert folder.is_relative_to(cache)
    assert len(result.document["train"]) == 4
    assert len(result.document["test"]) == 1
    assert check_shard(folder) == []
    before = (folder / "manifest.json").stat().st_mtime_ns
    assert embedded_data("brdf", count=5, quiet=True) == folder
    assert (folder / "manifest.json").stat().st_mtime_ns == before
    next(folder.glob("*.safetensors")).unlink()  # damaged: made again
    assert embedded_data("brdf", count=5, quiet=True) == folder
    assert check_shard(folder) == []
    assert [path.name for path in folder.parent.iterdir()] == [folder.name]


@pytest.mark.usefixtures("small_spheres")
def test_synth_writes_merl_files_that_convert_back(metapp: Callable) -> None:
    document = metapp("data", "synth", "brdf", "--count", "2", "--as", "merl", "--out", "merl", "--json").document
    (train,), (test,) = document["train"], document["test"]
    assert read_merl(Path(f"merl/train/{train}.binary")).max() > 0
    assert metapp("data", "merl", "merl/test", "--out", "shards", "--samples", "64").code == 0
    assert [task.name for task in read_manifest(Path("shards")).tasks] == [test]


def test_an_interrupted_synth_leaves_nothing(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from data_tools.synthetic import brdf as synthetic_brdf

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(synthetic_brdf, "synthetic_tasks", interrupt)
    stale = cache / "data" / ".partial-1-brdf"
    stale.mkdir(parents=True)
    os.utime(stale, (time.time() - 7200,) * 2)
    with pytest.raises(KeyboardInterrupt):
        embedded_data("brdf", quiet=True)
    assert list((cache / "data").iterdir()) == []


def test_counts_keep_the_proportion() -> None:
    for count, train, test in ((None, 80, 20), (1, 1, 0), (2, 1, 1), (10, 8, 2), (13, 10, 3)):
        assert split_counts("brdf", count) == {"train": train, "test": test}, count


def test_a_full_disk_is_foreseen(metapp: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = shutil.disk_usage(tmp_path)._replace(free=10**8)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    result = metapp("data", "synth", "brdf", "--as", "merl", "--out", "out")
    assert "0.1 GB free, expected 3.5 GB for 100 merl files" in result.refusal


@pytest.fixture(autouse=True)
def _few_paths(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("metapp.rendering.paths.path_space.BATCH_PATHS", 2**16)


@pytest.mark.long
@needs_mitsuba
def test_boxes_are_written_with_their_scenes_beside(metapp: Callable) -> None:
    document = metapp("data", "cornell", "--count", "5", "--seed", "7", *FEW, "--out", "a", "--json").done
    assert document["train"] == [f"cornell-7-00{index}" for index in range(4)]
    assert document["test"] == ["cornell-7-004"]
    assert check_shard(Path("a")) == []
    tasks = read_shard(Path("a"), app="transport")
    for task in tasks:
        assert task.data["samples"].shape == (200, 4)
        assert task.data["held"].shape == (50, 4)
        scene = json.loads(Path(f"a/{task.name}.json").read_text())
        assert scene == scene_of(task.data["scene"])
    # fewer take the place of all, scenes included
    for count in ("2", "1"):
        again = ("--count", count, "--seed", "7", *FEW, "-o", "b", "-q", "--overwrite")
        assert metapp("data", "cornell", *again).code == 0
    files = {"manifest.json", "cornell-7-000.json", "cornell-7-000.safetensors"}
    assert {path.name for path in Path("b").iterdir()} == files
    (box,) = read_shard(Path("b"))
    assert all(torch.equal(box.data[key], tasks[0].data[key]) for key in box.data)


@needs_mitsuba
def test_the_embedded_set_is_made_of_boxes(monkeypatch: pytest.MonkeyPatch) -> None:
    def few(split: str, count: int, seed: int) -> object:
        return synthetic_tasks(split, count, seed, samples=100, held=20)  # type: ignore[arg-type]

    monkeypatch.setattr(synthetic_transport, "synthetic_tasks", few)
    folder = embedded_data("transport", count=3, quiet=True)
    assert [task.name for task in read_manifest(folder).tasks] == ["box-000", "box-001", "box-t000"]
    assert check_shard(folder) == []
    assert (folder / "box-t000.json").is_file()
    first, _, test = read_shard(folder)
    others = [scene_of(task.data["scene"]) for task in (first, test, next(cornell_tasks(1, samples=10, held=10)))]
    assert all(others[i] != others[j] for i, j in ((0, 1), (0, 2), (1, 2)))
