"""`metapp data cornell` and `metapp data synth transport`: sets of Cornell boxes, the same for a seed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from data_tools.synthetic import transport as synthetic_transport
from data_tools.synthetic.transport import COUNTS, cornell_tasks, synthetic_tasks
from metapp.rendering.scene_rules import scene_of
from metapp.runs.embedded import embedded_data, split_counts
from metapp.storage.manifest import read_manifest
from metapp.storage.shards import check_shard, read_shard
from tests.needs_mitsuba import needs_mitsuba

FEW = ("--samples", "200", "--held", "50")


@pytest.fixture(autouse=True)
def _few_paths(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("metapp.rendering.path_space._BATCH", 2**16)


@needs_mitsuba
def test_boxes_are_written_with_their_scenes_beside(metapp: Callable, tmp_path: Path) -> None:
    result = metapp("data", "cornell", "--count", "5", "--seed", "7", *FEW, "--out", tmp_path / "a", "--json")
    assert result.code == 0
    assert result.document["train"] == [f"cornell-7-00{index}" for index in range(4)]
    assert result.document["test"] == ["cornell-7-004"]
    assert check_shard(tmp_path / "a") == []
    tasks = read_shard(tmp_path / "a", app="transport")
    for task in tasks:
        assert task.data["samples"].shape == (200, 4)
        assert task.data["held"].shape == (50, 4)
        scene = json.loads((tmp_path / "a" / f"{task.name}.json").read_text())
        assert scene == scene_of(task.data["scene"])
    # fewer take the place of all, scenes included
    for count in ("2", "1"):
        assert metapp("data", "cornell", "--count", count, "--seed", "7", *FEW, "-o", tmp_path / "b", "-q").code == 0
    files = {"manifest.json", "cornell-7-000.json", "cornell-7-000.safetensors"}
    assert {path.name for path in (tmp_path / "b").iterdir()} == files
    (again,) = read_shard(tmp_path / "b")
    assert all(torch.equal(again.data[key], tasks[0].data[key]) for key in again.data)


@needs_mitsuba
def test_a_box_that_was_written_can_be_read(metapp: Callable, tmp_path: Path) -> None:
    from data_tools.readers.mitsuba_scenes import find, read_task

    more = ("--dimensions", "6", "--split", "test")
    assert metapp("data", "cornell", "--count", "1", *FEW, *more, "--out", tmp_path, "-q").code == 0
    (entry,) = read_manifest(tmp_path).tasks
    assert (entry.split, entry.beside) == ("test", "cornell-0-000.json")
    (path,) = find([tmp_path])[0]
    (task,) = read_shard(tmp_path)
    read = read_task(path, 200, 50, 6)
    assert torch.equal(read.data["scene"], task.data["scene"])
    assert read.data["samples"].shape == task.data["samples"].shape == (200, 6)


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


def test_the_default_set() -> None:
    assert COUNTS == {"train": 40, "test": 8}
    assert split_counts("transport") == {"train": 40, "test": 8}
    with pytest.raises(ValueError, match="'other', expected 'train' or 'test'"):
        next(synthetic_tasks("other", 1))  # type: ignore[arg-type]


def test_an_interruption_leaves_nothing(metapp: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(synthetic_transport, "transport_task", interrupt)
    assert metapp("data", "cornell", "--out", tmp_path / "boxes").code == 130
    assert not (tmp_path / "boxes").exists()


def test_without_a_fit_libllvm_nothing_is_written(
    metapp: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def none() -> Path:
        raise ValueError("libLLVM: found none, expected 19 or newer for Mitsuba; apt-get install libllvm19 libatomic1.")

    monkeypatch.setattr("metapp.rendering.variant.find_llvm", none)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    refusal = metapp("data", "cornell", "--out", tmp_path / "boxes").refusal
    assert refusal.startswith("error: libLLVM: found none")
    assert not (tmp_path / "boxes").exists()


@pytest.mark.parametrize(("option", "value"), [("--dimensions", "5"), ("--count", "0"), ("--samples", "0")])
def test_options_out_of_range(metapp: Callable, tmp_path: Path, option: str, value: str) -> None:
    result = metapp("data", "cornell", "--out", tmp_path / "boxes", option, value)
    assert result.code == 2
    assert option in result.err
