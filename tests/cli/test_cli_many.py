"""`--batch` and `--resume`: many inputs, side by side, whatever is broken among them."""

import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from torch import Tensor

from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.recipes import RECIPES
from metapp.learning.task import Params, Task, Tasks
from metapp.runs import fitting
from metapp.runs.fit import Fit
from metapp.runs.fitting import Fitter
from metapp.runs.inputs.finding import Input
from metapp.runs.outputs.fit_files import write_pictures
from metapp.runs.stored_fits import read_fits
from metapp.storage.fit_folders import name_with_digest
from tests.cli.messages import says
from tests.conftest import CommandResult

pytestmark = pytest.mark.usefixtures("small_spheres")
NAMES = [f"m{i}" for i in range(5)]
NETWORKS = len(NAMES)


@pytest.fixture
def materials(networks: Path) -> Path:
    """Five networks, for a test to write to."""
    return shutil.copytree(networks, Path("materials"))


@pytest.fixture
def fit(metapp: Callable, materials: Path) -> Callable:
    """`metapp quickft brdf materials`, which draws samples for its start and for each step."""
    options = ("--recipe", "quick", "--steps", "3", "--json")
    return lambda *more: metapp("quickft", "brdf", materials, *options, *more)


@pytest.fixture
def fitted_batches(monkeypatch: pytest.MonkeyPatch) -> list[list[str]]:
    """The names of the tasks in each batch."""
    batches, original = list[list[str]](), fitting.fit_tasks_of

    def fit(fitter: Fitter, tasks: Sequence[Task]) -> list[Fit]:
        batches.append([task.name for task in tasks])
        return original(fitter, tasks)

    monkeypatch.setattr(fitting, "fit_tasks_of", fit)
    return batches


def errors(document: dict) -> dict[str, float]:
    return {task["name"]: task["error"] for task in document["tasks"]}


@pytest.mark.long
def test_fits_side_by_side_are_those_of_one_by_one(fit: Callable, fitted_batches: list[list[str]]) -> None:
    alone, together = fit().json_document, fit("--batch", "2").json_document
    assert errors(together) == pytest.approx(errors(alone), rel=1e-3)
    assert fitted_batches[-3:] == [["m0", "m1"], ["m2", "m3"], ["m4"]]
    assert together["tasks_per_second"] > 0
    assert together["failures"] == []
    folder = Path(together["out"])
    assert [fit.batch for fit in read_fits(folder)] == [2, 2, 2, 2, 1]  # seconds are shares
    assert folder == Path(alone["out"])
    assert (folder / "pictures.png").is_file()
    assert (folder / "m3" / "params.safetensors").is_file()


def test_each_input_is_a_line_where_there_is_no_terminal(fit: Callable, materials: Path) -> None:
    (materials / "m1" / "fc1.npy").write_bytes(b"broken")
    lines = [line for line in fit().err.splitlines() if line.startswith("quickft: ")]
    assert lines[0].startswith("quickft: 1 of 5, m0, error ")
    assert all(
        re.fullmatch(r"quickft: [1-5] of 5, (m\d, error \d\.\d{3}, \d\.\d{4} s|failed: m1)", line) for line in lines
    )
    assert len(lines) == 5
    assert not any(line.startswith("quickft: ") for line in fit("--quiet").err.splitlines())


def test_fitted_inputs_are_not_fitted_again(fit: Callable, fitted_batches: list[list[str]], materials: Path) -> None:
    first = fit("--batch", "2").json_document
    del fitted_batches[:]
    again = fit("--batch", "4", "--resume")  # another number is the same run
    assert fitted_batches == []
    assert (again.json_document["tasks_per_second"], again.json_document["tasks"]) == (None, first["tasks"])
    assert says(again.err, "5 of 5 inputs", "skipped")
    for file in (materials / "m3").iterdir():
        file.touch()  # which does not change its content
    shutil.rmtree(materials / "m1")
    shutil.copytree(materials / "m0", materials / "m1")
    shutil.copytree(materials / "m2", materials / "new")
    assert sorted(errors(fit("--batch", "4", "--resume").json_document)) == sorted([*NAMES, "new"])
    assert fitted_batches == [["m1", "new"]]
    fit("--resume", "--seed", "3")
    assert fitted_batches[1:] == [[name] for name in [*NAMES, "new"]]  # of other settings


def test_resuming_reads_no_input_whose_files_have_not_changed(
    fit: Callable, materials: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sizes and times of change are looked at first; the values only of inputs for which these differ."""
    read, original = list[str](), Input.read_task

    def read_task(one: Input, *arguments: Any) -> Task:
        read.append(one.name)
        return original(one, *arguments)

    monkeypatch.setattr(Input, "read_task", read_task)
    fit()
    del read[:]
    assert says(fit("--resume").err, "5 of 5 inputs", "skipped")
    assert not read
    (materials / "m3" / "b1.npy").touch()
    assert says(fit("--resume").err, "5 of 5 inputs", "skipped")
    assert read == ["m3"]


def test_a_broken_file_stops_no_other(fit: Callable, fitted_batches: list[list[str]], materials: Path) -> None:
    broken = materials / "m2" / "b1.npy"
    whole = broken.read_bytes()
    broken.write_bytes(b"broken")
    result = fit("--batch", "3")
    assert "warning: skipped: " in result.err  # it was found in a folder, not named
    (failure,) = result.json_document["failures"]
    assert failure["source"].endswith("m2")
    assert sorted(errors(result.json_document)) == ["m0", "m1", "m3", "m4"]
    broken.write_bytes(whole)
    del fitted_batches[:]
    assert sorted(errors(fit("--batch", "3", "--resume").json_result)) == NAMES
    assert fitted_batches == [["m2"]]


def test_failed_fits_are_separated_from_their_batch(
    fit: Callable, fitted_batches: list[list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Broken(Brdf):
        def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
            found = super().errors(theta, tasks)
            bad = [i for i, name in enumerate(tasks.selected_names) if name == "m1"]
            found["error"][bad] = float("nan")
            return found

    quick = RECIPES["quick"]
    monkeypatch.setitem(RECIPES, "quick", replace(quick, app=Broken(quick.app.network)))
    result = fit("--batch", "4")
    assert "1 of 5 inputs" in result.error
    assert sorted(errors(result.json_document)) == ["m0", "m2", "m3", "m4"]
    assert "not finite" in result.json_document["failures"][0]["reason"]
    assert fitted_batches == [["m0", "m1", "m2", "m3"], ["m0"], ["m1"], ["m2"], ["m3"], ["m4"]]
    fits = read_fits(Path(result.json_document["out"]))
    assert [fit.name for fit in fits] == ["m0", "m2", "m3", "m4"]
    assert all(fit.batch == 1 and "batch" not in fit.document() for fit in fits)


def test_batches_beyond_the_memory_are_fitted_one_by_one(
    fit: Callable, fitted_batches: list[list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    class Large(Brdf):
        def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
            if len(tasks) > 2:
                raise MemoryError
            return super().errors(theta, tasks)

    quick = RECIPES["quick"]
    monkeypatch.setitem(RECIPES, "quick", replace(quick, app=Large(quick.app.network)))
    assert fit("--batch", "4").code == 0
    assert fitted_batches == [NAMES[:4], *([name] for name in NAMES)]


def test_inputs_of_one_name_are_kept_apart(metapp: Callable, materials: Path) -> None:
    """Each has its folder again when it is fitted again."""
    for name in NAMES:
        Path(name).mkdir()
        (materials / name).rename(Path(name) / "one")

    def fit(*more: str) -> CommandResult:
        return metapp("general", "brdf", *NAMES, "--recipe", "quick", "--json", *more)

    names = ["one", *(name_with_digest("one", str((Path(name) / "one").resolve())) for name in NAMES[1:])]
    first = errors(fit("--batch", "8").json_document)
    assert list(first) == names
    assert says((again := fit()).err, "5 of 5 fits", "replace")
    assert list(errors(again.json_document)) == names


def test_faults_of_doubts_and_pictures_end_no_other_fit(fit: Callable, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("max(): no elements\nsecond line")

    drawn, draw = [], write_pictures

    def draw_but_one(pictures: object, folder: Path) -> None:
        drawn.append(folder)
        if len(drawn) == 2:
            fail()
        draw(pictures, folder)

    monkeypatch.setattr(fitting, "warnings_of", fail)
    monkeypatch.setattr("metapp.runs.fit.write_pictures", draw_but_one)
    run = fit()
    assert run.code == 1
    assert len(run.json_document["tasks"]) == NETWORKS - 1
    assert len(run.json_document["failures"]) == 1
    doubts = [line for line in run.err.splitlines() if re.match(r"warning: m\d: ", line)]
    assert len(doubts) == NETWORKS
    assert all("(max(): no elements)" in line and "second line" not in line for line in doubts)
