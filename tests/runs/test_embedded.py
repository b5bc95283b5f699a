"""The embedded sets in the cache: test tasks alone, the whole set, their labels, and several programs at once."""

import functools
import time
from collections.abc import Callable, Iterator
from os import getpid
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import torch

from data_tools.synthetic import brdf, illumination, texture
from metapp.extensions.baselines import baselines_of
from metapp.extensions.baselines.baseline_fits import find_training_folder
from metapp.learning.task import Task
from metapp.runs.data_sets.embedded import (
    embedded_folders,
    has_embedded_tests,
    has_embedded_training,
    make_embedded_set,
    make_embedded_test_set,
)
from metapp.runs.fit import find_tasks, read_fit
from metapp.runs.inputs.finding import data_label, find_in_data_set
from metapp.runs.resolve import app_of, complete
from metapp.runs.spec import Spec
from metapp.storage.shards import list_data_set_problems, read_manifest
from tests import forks
from tests.recipe_apps import app_by_recipe, application

COUNTS = {"train": 3, "test": 2}
MODULES = {"brdf": brdf, "texture": texture, "illumination": illumination}


def count_draws(patch: pytest.MonkeyPatch, module: ModuleType) -> list[str]:
    """Shrink the set of a module, and return the list that the splits of its drawn tasks are appended to."""
    draw, splits = module.synthetic_tasks, list[str]()

    @functools.wraps(draw)
    def counted(split: Any, *arguments: Any, **options: Any) -> Iterator[Task]:
        for task in draw(split, *arguments, **options):
            splits.append(split)
            yield task

    patch.setattr(module, "COUNTS", COUNTS)
    patch.setattr(module, "synthetic_tasks", counted)
    return splits


@pytest.fixture
def splits(monkeypatch: pytest.MonkeyPatch, small_spheres: None) -> list[str]:
    """The splits of the tasks that have been drawn of a small set of BRDFs."""
    return count_draws(monkeypatch, brdf)


@pytest.mark.usefixtures("small_spheres")
@pytest.mark.parametrize("app", MODULES)
def test_test_tasks_drawn_alone_equal_those_of_the_whole_set(
    app: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    splits = count_draws(monkeypatch, MODULES[app])
    alone = make_embedded_test_set(application(app), quiet=True)
    assert splits == ["test"] * COUNTS["test"]
    whole = make_embedded_set(application(app), out=tmp_path / "whole", quiet=True)
    tests = tuple(entry for entry in read_manifest(whole).tasks if entry.split == "test")
    assert read_manifest(alone).tasks == tests  # with the hashes of all bytes
    assert read_manifest(alone).units == read_manifest(whole).units
    assert list_data_set_problems(alone) == []


def test_a_fit_draws_no_training_tasks(metapp: Callable, splits: list[str], tmp_path: Path) -> None:
    assert metapp("general", "brdf", "--out", tmp_path / "runs", "-q").code == 0
    assert splits == ["test"] * COUNTS["test"]
    assert not has_embedded_training(application("brdf"))


def test_a_table_draws_no_training_tasks(metapp: Callable, splits: list[str], tmp_path: Path) -> None:
    assert not has_embedded_tests(application("brdf"))
    metapp("evaluate", "brdf", "--no-run", "--out", tmp_path / "runs", "-q")
    assert splits == []
    assert not has_embedded_tests(application("brdf"))
    make_embedded_test_set(application("brdf"), quiet=True)
    metapp("evaluate", "brdf", "--no-run", "--which", "baselines", "--out", tmp_path / "runs", "-q")
    assert splits == ["test"] * COUNTS["test"]


@pytest.mark.usefixtures("splits")
def test_the_whole_set_that_is_made_later_changes_no_label() -> None:
    tasks, label = read_tests()
    whole = make_embedded_set(application("brdf"), quiet=True)
    later, label_later = read_tests()
    assert label_later == label != data_label(whole)
    assert [task.name for task in later] == [task.name for task in tasks]
    assert embedded_folders(application("brdf")) == [make_embedded_test_set(application("brdf")), whole]


def read_tests() -> tuple[list[Task], str]:
    """The test tasks of the embedded set, and their label."""
    spec, folder = Spec(app="brdf"), make_embedded_test_set(application("brdf"), quiet=True)
    tasks = [one.read_task(spec, app_by_recipe("brdf")) for one in find_in_data_set(spec, folder)]
    return tasks, data_label(folder)


def test_a_whole_set_that_is_there_keeps_its_label(splits: list[str]) -> None:
    whole = make_embedded_set(application("brdf"), quiet=True)
    splits.clear()
    tasks, label = read_tests()
    assert (len(tasks), label) == (COUNTS["test"], data_label(whole))
    assert splits == []


@pytest.mark.usefixtures("splits")
def test_fits_of_either_folder_find_their_tasks(metapp: Callable, tmp_path: Path) -> None:
    def tasks_of_record(document: dict[str, Any]) -> dict[str, Task]:
        return find_tasks([read_fit(Path(task["folder"])) for task in document["tasks"]])

    words = ("general", "brdf", "-q", "--json", "--out")
    make_embedded_set(application("brdf"), quiet=True)
    of_whole = metapp(*words, tmp_path / "whole").json_result
    alone = embedded_folders(application("brdf"))[0].with_name(f"{embedded_folders(application('brdf'))[0].name}-test")
    embedded_folders(application("brdf"))[0].rename(tmp_path / "aside")
    of_tests = metapp(*words, tmp_path / "alone").json_result
    assert embedded_folders(application("brdf")) == [alone]
    assert tasks_of_record(of_whole) == {}  # its set is not there
    (tmp_path / "aside").rename(str(alone).removesuffix("-test"))
    assert list(tasks_of_record(of_whole)) == list(tasks_of_record(of_tests)) == [t["name"] for t in of_tests["tasks"]]


def test_a_damaged_folder_of_test_tasks_is_made_again(splits: list[str]) -> None:
    folder = make_embedded_test_set(application("brdf"), quiet=True)
    next(folder.glob("*.safetensors")).unlink()
    assert make_embedded_test_set(application("brdf"), quiet=True) == folder
    assert list_data_set_problems(folder) == []
    assert splits == ["test"] * 2 * COUNTS["test"]


def test_baselines_that_learn_have_training_tasks_drawn_where_they_are_measured(splits: list[str]) -> None:
    spec = complete(Spec(app="brdf", paradigm="general"), trained=False)
    learning, other = (
        next(one for one in baselines_of(spec.application, app_of(spec)) if bool(one.learns) is kind)
        for kind in (True, False)
    )
    assert find_training_folder(spec, learning, None) is None
    assert find_training_folder(spec, other, None, make=True) is None
    assert splits == []
    assert (
        find_training_folder(spec, learning, None, make=True)
        == find_training_folder(spec, learning, None)
        == make_embedded_set(application("brdf"))
    )
    assert splits == ["train"] * COUNTS["train"] + ["test"] * COUNTS["test"]


def make_tests(start: Path, others: int) -> None:
    """Make the test tasks of a small set once so many programs are ready, and draw no task before all of them draw."""
    from tests.small_spheres import shrink_spheres

    torch.set_num_threads(1)
    with pytest.MonkeyPatch.context() as patch:
        shrink_spheres(patch)
        patch.setattr(brdf, "COUNTS", COUNTS)
        draw = brdf.synthetic_tasks

        def together(*arguments: Any) -> Iterator[Task]:
            (start / str(getpid())).touch()
            while len(list(start.iterdir())) < others:
                time.sleep(0.01)
            yield from draw(*arguments)

        patch.setattr(brdf, "synthetic_tasks", together)
        folder = make_embedded_test_set(application("brdf"), quiet=True)
        assert list_data_set_problems(folder) == []
        print(data_label(folder))


def test_programs_that_make_the_same_test_tasks_at_once(cache: Path, tmp_path: Path) -> None:
    start = tmp_path / "start"
    start.mkdir()
    programs = [forks.start_in_fork(make_tests, start, 2, output_folder=tmp_path / str(i)) for i in range(2)]
    codes, labels, errors = zip(*[program.wait_for_output(60) for program in programs], strict=True)
    assert codes == (0, 0), errors
    assert labels[0] == labels[1]
    (folder,) = (cache / "data").iterdir()  # nothing is left over
    assert list_data_set_problems(folder) == []
