"""`metapp data` end to end: what is written where, exit codes, and one line for every kind of bad input."""

import functools
import json
import os
import shutil
import struct
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from data_tools.readers.merl import read_merl
from data_tools.synthetic import brdf as synthetic_brdf
from data_tools.synthetic import transport as synthetic_transport
from data_tools.synthetic.random_values import Split
from data_tools.synthetic.transport import cornell_tasks, synthetic_tasks
from metapp.learning.task import Task
from metapp.rendering.scenes.stored_text import decode_scene
from metapp.runs.data_sets.embedded import make_embedded_set, split_counts
from metapp.storage.shards import list_data_set_problems, read_data_set, read_manifest
from tests.cli.messages import says
from tests.conftest import CommandResult
from tests.needs_mitsuba import needs_mitsuba
from tests.recipe_apps import application
from tests.small_spheres import run_with_small_spheres

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
    (task,) = read_data_set(Path("out"), "train", "brdf")
    assert task.name == "gold"
    assert task.data["angles"].shape == (64, 3)
    assert task.data["reflectance"][0].tolist() == pytest.approx([0.2, 0.23, 0.332])
    assert list_data_set_problems(Path("out")) == []
    assert read_manifest(Path("out")).notes == {"made_by": "metapp data merl", "samples": 64, "split": "auto"}


@pytest.mark.usefixtures("small_spheres")
def test_networks_become_a_data_set_split_by_the_rule(metapp: Callable, network_at: Callable) -> None:
    for name in ("tin", "brass", "sub/gold", "felt", "sub/wood", "ink"):
        network_at("in", name)
    result = metapp("data", "nbrdf", "in", "in/tin", "--out", "new/out", *FEW, "--json")
    train = result.json_result.pop("train")
    assert sorted(train) == ["brass", "felt", "gold", "ink", "wood"]
    assert list(result.json_document) == ["app", "out", "train", "test", "skipped"]
    assert result.json_document == {"app": "brdf", "out": "new/out", "train": train, "test": ["tin"], "skipped": []}
    assert "5 train + 1 test tasks" in result.err
    again = ("--split", "test", "--overwrite", "--quiet", *FEW)
    assert metapp("data", "nbrdf", "in", "--out", "new/out", *again) == (0, "", "")
    assert {task.split for task in read_manifest(Path("new/out")).tasks} == {"test"}


def test_check_reports_contents_and_faults_of_a_set(metapp: Callable, gold: Path) -> None:
    metapp("data", "merl", gold, "--out", "out", *FEW)
    code, out, err = metapp("data", "check", "out")
    assert (code, err) == (0, "")
    assert says(out, "brdf", "1 train", "0 test", "0.2 MB")
    assert says(out, "reflectance", "1/sr", "linear RGB")
    shard = Path("out/gold.safetensors")
    payload = bytearray(shard.read_bytes())
    payload[-1] ^= 1
    shard.write_bytes(payload)
    Path("out/extra").write_bytes(b"")
    code, _, err = metapp("data", "check", "out")
    assert code == 1
    assert [line.split(":")[0] for line in err.splitlines()] == ["problem", "problem"]
    result = metapp("data", "check", "out", "--json")
    assert (result.code, result.json_document["app"], result.json_document["train"]) == (1, "brdf", 1)
    assert len(result.json_document["problems"]) == 2


# What does not: data is exit code 1 with one line, usage is 2


def test_bad_inputs_are_one_line_and_write_nothing(metapp: Callable, gold: Path, network_at: Callable) -> None:
    """What is wrong with a file, tests/readers hold; here, what a command makes of it."""
    for name in ("bad", "worse"):
        np.save(network_at("in", name) / "b3.npy", np.full(3, np.nan, np.float32))
    same = network_at("gold")
    for words, subject in ((("merl", gold, "none.binary"), "none.binary"), (("nbrdf", "in/bad", same), "b3.npy")):
        assert subject in metapp("data", *words, "--out", "out", *FEW).refusal
    Path("merl/test").mkdir(parents=True)
    misuse = metapp("data", "synth", "brdf", "--as", "merl", "--out", "merl").misuse
    assert says(misuse, "merl/test", "--overwrite")
    Path("file").write_text("")
    assert says(metapp("data", "nbrdf", same, "--out", "file/below").misuse, "file", "folder")
    result = metapp("data", "nbrdf", "in", "--out", "out", *FEW)
    assert result.code == 1
    assert [line.split(":")[0] for line in result.err.splitlines()] == ["warning", "warning", "error"]
    assert says(result.err, "error: in", "2 sources")
    assert not Path("out").exists()


@pytest.mark.usefixtures("small_spheres")
def test_join_keeps_each_task_in_its_split(metapp: Callable, network_at: Callable) -> None:
    for split, name in (("train", "tin"), ("test", "ink")):
        result = metapp("data", "nbrdf", network_at(name), "--out", split, "--split", split, *FEW)
        assert result.code == 0

    def join(*sets: str) -> CommandResult:
        return metapp("data", "join", *sets, "--out", "joint", "--overwrite", "--json")

    document = join("train", "test").json_result
    assert (document["train"], document["test"]) == (["tin"], ["ink"])
    assert [task.name for task in read_data_set(Path("joint"), "test", "brdf")] == ["ink"]
    assert list_data_set_problems(Path("joint")) == []
    assert join("train", "test", "--alike").json_result["train"] == ["tin"]
    assert {task.name: task.data["kind"].tolist() for task in read_data_set(Path("joint"))} == {"tin": [0], "ink": [1]}
    assert list_data_set_problems(Path("joint")) == []
    assert says(join("train", "train").error, "tin", "train")
    assert join("joint", "test").error
    assert join("none").error


def test_sets_drawn_with_two_seeds_are_joined(metapp: Callable) -> None:
    """Tasks of one name get the names of their sets in front, which a line says."""
    for folder in ("a", "b", "other/a"):
        seed = 1 if folder == "a" else 2
        assert metapp("data", "synth", "texture", "--count", 3, "--seed", seed, "--out", folder).code == 0
    names_a, names_b = ({task.name for task in read_data_set(Path(folder))} for folder in ("a", "b"))
    shared, expected = names_a & names_b, names_a ^ names_b
    assert shared
    for folders, prefixes in ((("a", "b"), ("a", "b")), (("a", "other/a"), ("a1", "a2"))):
        joined = metapp("data", "join", *folders, "--out", f"joint-{prefixes[0]}", "--json")
        found = joined.json_result["train"] + joined.json_result["test"]
        assert {*found} == expected | {f"{prefix}-{name}" for prefix in prefixes for name in shared}
        assert says(joined.err, "data sets", "names")
        assert list_data_set_problems(Path(f"joint-{prefixes[0]}")) == []


# What is there stays, unless --overwrite is given


@pytest.fixture(scope="module")
def runs(write_nbrdf_networks: Callable[[int], Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run, and the network that it is a fit of."""
    folder = tmp_path_factory.mktemp("overwrite")
    network = shutil.copytree(write_nbrdf_networks(1) / "m0", folder / "m0")
    run_with_small_spheres(
        "meta", "brdf", network, "--rule", "meta-curvature", "--steps", "1", "--out", folder / "runs", "--quiet"
    )
    (run,) = (folder / "runs" / "brdf").iterdir()
    run.rename(folder / "run")
    return folder


FILES = {
    "view": "view {run} --no-open --quiet --out",
    "compare": "compare {run} {run} --quiet --out",
    "plan": "plan brdf --samples 2 --quiet --out",
    "markers": "data markers",
    "report": "evaluate brdf --no-run --quiet --report",
}


@pytest.mark.usefixtures("small_spheres")
@pytest.mark.parametrize("command", FILES.values(), ids=FILES)
def test_a_file_is_replaced_by_overwrite_alone(metapp: Callable[..., CommandResult], runs: Path, command: str) -> None:
    if "markers" in command:
        pytest.importorskip("cv2")
    file = out = Path("out.csv" if "plan" in command else "out.pdf")
    if "report" in command:
        out, file = Path("."), Path("index.md")
    file.write_text("mine")
    words = command.format(run=runs / "run").split()
    refused = metapp(*words, out)
    assert says(refused.misuse, str(file), "--overwrite")
    assert file.read_text() == "mine"
    assert metapp(*words, out, "--overwrite").code == 0
    assert file.read_bytes() != b"mine"


SETS = {
    "nbrdf": "data nbrdf {network} --samples 512 --split test",
    "synth": "data synth texture --count 2 --size 64",
    "join": "data join {set}",
}


@pytest.mark.usefixtures("small_spheres")
@pytest.mark.parametrize("command", SETS.values(), ids=SETS)
def test_a_data_set_is_replaced_by_overwrite_alone(
    metapp: Callable[..., CommandResult], runs: Path, command: str
) -> None:
    if "{set}" in command:
        run_with_small_spheres("data", "nbrdf", runs / "m0", "--out", "other", "--samples", "512", "--split", "test")
    words = [*command.format(network=runs / "m0", set="other").split(), "--quiet", "--out", "set"]
    assert metapp(*words).code == 0
    Path("set/manifest.json").write_text(Path("set/manifest.json").read_text() + " ")
    before = {path.name: path.read_bytes() for path in Path("set").iterdir()}
    refused = metapp(*words)
    assert says(refused.error, "set: ", "a data set", "--overwrite")
    assert {path.name: path.read_bytes() for path in Path("set").iterdir()} == before
    assert metapp(*words, "--overwrite").code == 0
    assert not Path("set/manifest.json").read_text().endswith(" ")


@pytest.mark.usefixtures("small_spheres")
@pytest.mark.parametrize(
    ("paths", "split", "expected"),
    [
        ("sets", "auto", ("one", "two")),
        ("sets", "test", ("", "one two")),
        ("sets/train sets/test", "auto", ("one", "two")),
        ("sets/train/../test/two sets/train/one", "auto", ("one", "two")),
        ("sets/test", "auto", ("", "two")),
        ("sets/train/one", "auto", ("one", "")),
    ],
)
def test_folders_train_and_test_stay_apart(
    metapp: Callable[..., CommandResult], runs: Path, paths: str, split: str, expected: tuple[str, str]
) -> None:
    """Held-out materials must not be trained on, whatever `auto` would make of their names."""
    for folder, name in (("train", "one"), ("test", "two")):
        shutil.copytree(runs / "m0", Path("sets") / folder / name)
    result = metapp("data", "nbrdf", *paths.split(), "--samples", 512, "--split", split, "--out", "set", "--json")
    assert tuple(" ".join(sorted(result.json_document[part])) for part in ("train", "test")) == expected
    assert says(result.err, "train/", "test/") == (split == "auto")


@pytest.mark.usefixtures("small_spheres")
def test_small_tensors_are_converted_by_one_thread(
    metapp: Callable, network: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from data_tools.readers import nbrdf_files

    counts: list[int] = []
    read = nbrdf_files.read_task

    def counted(*arguments: Any, **options: Any) -> Task:
        counts.append(torch.get_num_threads())
        return read(*arguments, **options)

    monkeypatch.setattr(nbrdf_files, "read_task", functools.wraps(read)(counted))
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        assert metapp("data", "nbrdf", network, *FEW, "--out", "set").code == 0
        assert (counts, torch.get_num_threads()) == ([1], 2)
    finally:
        torch.set_num_threads(before)


# `metapp data synth` and `metapp data cornell`


FEW_PATHS = ("--samples", "200", "--held-out", "50")


@pytest.mark.usefixtures("small_spheres")
def test_synth_makes_a_set_once(metapp: Callable, cache: Path) -> None:
    result = metapp("data", "synth", "brdf", "--count", "5", "--json")
    folder = Path(result.json_document["out"])
    assert folder.is_relative_to(cache)
    assert len(result.json_document["train"]) == 4
    assert len(result.json_document["test"]) == 1
    assert list_data_set_problems(folder) == []
    before = (folder / "manifest.json").stat().st_mtime_ns
    assert make_embedded_set(application("brdf"), count=5, quiet=True) == folder
    assert (folder / "manifest.json").stat().st_mtime_ns == before
    next(folder.glob("*.safetensors")).unlink()  # damaged: made again
    assert make_embedded_set(application("brdf"), count=5, quiet=True) == folder
    assert list_data_set_problems(folder) == []
    assert [path.name for path in folder.parent.iterdir()] == [folder.name]


@pytest.mark.usefixtures("small_spheres")
def test_synth_writes_merl_files_that_convert_back(metapp: Callable) -> None:
    document = metapp("data", "synth", "brdf", "--count", "2", "--as", "merl", "--out", "merl", "--json").json_document
    (train,), (test,) = document["train"], document["test"]
    assert read_merl(Path(f"merl/train/{train}.binary")).max() > 0
    assert metapp("data", "merl", "merl/test", "--out", "shards", "--samples", "64").code == 0
    assert [task.name for task in read_manifest(Path("shards")).tasks] == [test]


def interrupt(*_: object) -> None:
    raise KeyboardInterrupt


def few(split: Split, count: int, seed: int) -> Iterator[Task]:
    """The boxes of the embedded set, of few samples each."""
    return synthetic_tasks(split, count, seed, samples=100, held_out=20)


# embedded sets, as entries of the registry name them: modules
INTERRUPTED = SimpleNamespace(**vars(synthetic_brdf) | {"synthetic_tasks": interrupt})
OF_FEW_SAMPLES = SimpleNamespace(**vars(synthetic_transport) | {"synthetic_tasks": few})


def embed(monkeypatch: pytest.MonkeyPatch, app: str, name: str) -> None:
    """Have the registry name an object of this module as the embedded set of an application."""
    synthetic = application(app).synthetic
    assert synthetic is not None
    entry = replace(synthetic, reference=f"{__name__}:{name}")
    monkeypatch.setitem(vars(application(app)), "synthetic", entry)


def test_an_interrupted_synth_leaves_nothing(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    embed(monkeypatch, "brdf", "INTERRUPTED")
    stale = cache / "data" / ".partial-1a2b3c4d-brdf"
    stale.mkdir(parents=True)
    os.utime(stale, (time.time() - 2 * 86400,) * 2)
    with pytest.raises(KeyboardInterrupt):
        make_embedded_set(application("brdf"), quiet=True)
    assert list((cache / "data").iterdir()) == []


def test_counts_keep_the_proportion() -> None:
    for count, train, test in ((None, 80, 20), (1, 1, 0), (2, 1, 1), (10, 8, 2), (13, 10, 3)):
        assert split_counts(application("brdf"), count) == {"train": train, "test": test}, count


def test_a_full_disk_is_foreseen(metapp: Callable, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = shutil.disk_usage(tmp_path)._replace(free=10**8)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    result = metapp("data", "synth", "brdf", "--as", "merl", "--out", "out")
    assert says(result.refusal, "0.1 GB", "3.5 GB", "100 merl files")


@pytest.mark.long
@pytest.mark.usefixtures("few_paths")
@needs_mitsuba
def test_boxes_are_written_with_their_scenes_beside(metapp: Callable) -> None:
    document = metapp("data", "cornell", "--count", "5", "--seed", "7", *FEW_PATHS, "--out", "a", "--json").json_result
    assert document["train"] == [f"cornell-7-00{index}" for index in range(4)]
    assert document["test"] == ["cornell-7-004"]
    assert list_data_set_problems(Path("a")) == []
    tasks = read_data_set(Path("a"), app="transport")
    for task in tasks:
        assert task.data["samples"].shape == (200, 4)
        assert task.data["held_out"].shape == (50, 4)
        scene = json.loads(Path(f"a/{task.name}.json").read_text())
        assert scene == decode_scene(task.data["scene"])
    # fewer take the place of all, scenes included
    for count in ("2", "1"):
        again = ("--count", count, "--seed", "7", *FEW_PATHS, "-o", "b", "-q", "--overwrite")
        assert metapp("data", "cornell", *again).code == 0
    files = {"manifest.json", "cornell-7-000.json", "cornell-7-000.safetensors"}
    assert {path.name for path in Path("b").iterdir()} == files
    (box,) = read_data_set(Path("b"))
    assert all(torch.equal(box.data[key], tasks[0].data[key]) for key in box.data)


@pytest.mark.usefixtures("few_paths")
@needs_mitsuba
def test_the_embedded_set_is_made_of_boxes(monkeypatch: pytest.MonkeyPatch) -> None:
    embed(monkeypatch, "transport", "OF_FEW_SAMPLES")
    folder = make_embedded_set(application("transport"), count=3, quiet=True)
    assert [task.name for task in read_manifest(folder).tasks] == ["box-000", "box-001", "box-t000"]
    assert list_data_set_problems(folder) == []
    assert (folder / "box-t000.json").is_file()
    first, _, test = read_data_set(folder)
    others = [
        decode_scene(task.data["scene"]) for task in (first, test, next(cornell_tasks(1, samples=10, held_out=10)))
    ]
    assert all(others[i] != others[j] for i, j in ((0, 1), (0, 2), (1, 2)))
