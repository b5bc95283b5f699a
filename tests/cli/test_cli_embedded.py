"""`metapp data synth`: the embedded sets, made once, the same on every machine."""

from __future__ import annotations

import os
import re
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from typer.testing import CliRunner

from data_tools.readers.merl import read_merl
from metapp.cli.commands import app as cli
from metapp.runs.embedded import cache_folder, embedded_apps, embedded_data, embedded_module, split_counts
from metapp.storage.manifest import read_manifest
from metapp.storage.shards import check_shard, fingerprint

pytestmark = pytest.mark.usefixtures("small_spheres")


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


def test_synth_depends_on_the_seed_alone(metapp: Callable, tmp_path: Path) -> None:
    for name, seed in (("a", "0"), ("b", "0"), ("c", "1")):
        assert metapp("data", "synth", "brdf", "--count", "2", "--seed", seed, "--out", tmp_path / name, "-q").code == 0
    assert fingerprint(tmp_path / "a") == fingerprint(tmp_path / "b") != fingerprint(tmp_path / "c")


def test_synth_writes_merl_files_that_convert_back(metapp: Callable, tmp_path: Path) -> None:
    result = metapp("data", "synth", "brdf", "--count", "2", "--as", "merl", "--out", tmp_path, "--json")
    (train,), (test,) = result.document["train"], result.document["test"]
    assert read_merl(tmp_path / "train" / f"{train}.binary").max() > 0
    assert metapp("data", "merl", tmp_path / "test", "--out", tmp_path / "shards", "--samples", "64").code == 0
    assert [task.name for task in read_manifest(tmp_path / "shards").tasks] == [test]


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


@pytest.mark.parametrize(("count", "train", "test"), [(None, 80, 20), (1, 1, 0), (2, 1, 1), (10, 8, 2), (13, 10, 3)])
def test_counts_keep_the_proportion(count: int | None, train: int, test: int) -> None:
    assert split_counts("brdf", count) == {"train": train, "test": test}


def test_the_cache_is_the_users_unless_moved(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert cache_folder() == cache
    monkeypatch.delenv("METAPP_CACHE")
    assert cache_folder().name == "metapp"


def test_a_full_disk_is_foreseen(metapp: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = shutil.disk_usage(tmp_path)._replace(free=10**8)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    result = metapp("data", "synth", "brdf", "--as", "merl", "--out", tmp_path / "out")
    assert "0.1 GB free, expected 3.5 GB for 100 MERL files" in result.refusal


def test_a_cache_that_cannot_be_written(metapp: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("METAPP_CACHE", str(tmp_path / "file"))
    expected = "Not a directory, expected a folder that can be written; set METAPP_CACHE"
    assert expected in metapp("data", "synth", "brdf", "--count", "2").refusal


def test_an_unknown_application_is_an_error() -> None:
    with pytest.raises(ValueError, match="glass: no embedded data set, expected one of brdf"):
        embedded_data("glass")
    with pytest.raises(ValueError, match="brdf: 0 tasks, expected 1 or more"):
        embedded_data("brdf", count=0)


def test_help_tells_how_many_tasks_a_set_has() -> None:
    shown = " ".join(CliRunner().invoke(cli, ["data", "synth", "--help"], env={"COLUMNS": "200"}).stdout.split())
    for app in embedded_apps():
        counts = embedded_module(app).COUNTS
        told = shown.partition(f" {app}: ")[2]
        assert re.match(rf"[^:]*?; {counts['train']:,} \+ {counts['test']}\.", told), app
