"""`metapp view` and `metapp try`: which fits are on the page, and what is refused."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from metapp.apps.brdf.app import Brdf
from metapp.extensions.viewer.pages import brdf
from metapp.extensions.viewer.view import View
from metapp.extensions.viewer.viewing import PAGE, try_app
from metapp.learning.task import Params, Task
from metapp.runs.inputs.sources import Source

pytestmark = pytest.mark.usefixtures("small_spheres")
NETWORKS = 2


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Addresses that the browser would open."""
    addresses: list[str] = []
    monkeypatch.setattr("webbrowser.open", addresses.append)
    return addresses


def groups_of(page: Path) -> list[dict[str, Any]]:
    found = re.search(r'id="data">(.*?)</script>', page.read_text(encoding="utf-8"), re.DOTALL)
    assert found
    return json.loads(found[1])["groups"]


def test_runs_of_the_same_tasks_stand_side_by_side(metapp: Callable, fitted: Callable, opened: list[str]) -> None:
    meta, quickft = fitted("meta"), fitted("quickft")
    told = metapp("view", meta, quickft, "--json", "--out", "both.html").done
    page = Path(told["page"])
    assert (page, told["bytes"]) == (Path("both.html"), page.stat().st_size)
    assert opened == [page.resolve().as_uri()]
    groups = groups_of(page)
    assert [group["title"] for group in groups] == ["m0", "m1"]
    for group in groups:
        assert [fit["label"] for fit in group["fits"]] == ["meta", "quickft"]
        assert all("error x100" in fit["caption"] and "residual" in fit["arrays"] for fit in group["fits"])


def test_without_a_name_the_newest_run_is_shown(
    metapp: Callable, fitted: Callable, opened: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = fitted("meta")
    top = next(folder for folder in run.resolve().parents if folder.name == "runs")
    monkeypatch.chdir(top.parent)
    told = metapp("view", "--json").done
    assert (top.parent / told["page"]).parent == run.resolve()
    assert len(opened) == 1
    monkeypatch.chdir(run)
    assert metapp("view").error.startswith("error: runs: no such folder, expected a run's folder")


def test_a_page_of_one_task_is_small(metapp: Callable, fitted: Callable, opened: list[str]) -> None:
    run = fitted("meta")
    file = next((run / "params").glob("*.safetensors"))
    told = metapp("view", file, "--no-open", "--json", "--out", "one.html").done
    assert not opened
    (group,) = groups_of(Path(told["page"]))
    assert group["title"] == file.stem
    assert told["bytes"] < 3_000_000
    assert (
        metapp("view", run, "--task", file.stem, "--no-open", "--json", "--out", "task.html").done["bytes"]
        == told["bytes"]
    )
    fewer = metapp("view", run, "--most", "1", "--no-open", "--out", "fewer.html")
    assert "view: 1 of 2 tasks; --most 2 shows all." in fewer.err
    assert len(groups_of(Path("fewer.html"))) == 1


def test_without_what_was_fitted_there_are_no_references(
    metapp: Callable, fitted: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = Path("copy")
    shutil.copytree(fitted("meta"), run)
    record = run / "record.jsonl"
    text = re.sub(r'"origin": {[^}]*}', '"origin": {}', record.read_text())
    record.write_text(re.sub(r'"source": "[^"]*"', '"source": "/gone"', text))
    result = metapp("view", run, "--no-open")
    assert "view: the inputs of 2 of 2 fits are not at hand; give them by --input or --data" in result.err
    assert not any("residual" in fit["arrays"] for group in groups_of(run / PAGE) for fit in group["fits"])


def referenced(page: Path) -> list[str]:
    """Titles of the groups whose fits have a reference."""
    return [group["title"] for group in groups_of(page) if all("residual" in fit["arrays"] for fit in group["fits"])]


def test_each_input_that_has_not_changed_is_found(metapp: Callable, fitted: Callable, networks: Path) -> None:
    shutil.copytree(networks, "mine")
    run = fitted("meta", inputs=Path("mine"))
    Path("mine/m0").rename("elsewhere")
    result = metapp("view", run, "--no-open", "--out", "p.html")
    assert "view: the inputs of 1 of 2 fits are not at hand" in result.err
    assert referenced(Path("p.html")) == ["m1"]
    # as it was moved, its files have the names and times that they had
    Path("elsewhere").rename("m0")
    metapp("view", run, "--no-open", "--overwrite", "--out", "p.html", "--input", "m0")
    assert referenced(Path("p.html")) == ["m0"]
    Path("m0").rename("mine/m0")
    for file in Path("mine/m1").iterdir():
        file.touch()
    metapp("view", run, "--no-open", "--overwrite", "--out", "p.html")
    assert referenced(Path("p.html")) == ["m0"]


def test_a_run_that_was_cut_off_keeps_fits_of_inputs_of_the_same_content(
    metapp: Callable, fitted: Callable, networks: Path
) -> None:
    shutil.copytree(networks, "mine")
    record = fitted("meta", inputs=Path("mine")) / "record.jsonl"
    first = record.read_text().splitlines()[0]
    record.write_text(first + "\n")
    for file in Path("mine").rglob("*.npy"):
        file.touch()
    assert fitted("meta", inputs=Path("mine")) == record.parent
    lines = record.read_text().splitlines()
    assert (len(lines), lines[0]) == (2, first)


def test_copies_of_all_inputs_are_found_by_their_content(metapp: Callable, fitted: Callable, networks: Path) -> None:
    shutil.copytree(networks, "mine", copy_function=shutil.copyfile)
    run = fitted("meta", inputs=Path("mine"))
    shutil.copytree("mine", "copies", copy_function=shutil.copyfile)
    shutil.rmtree("mine")
    metapp("view", run, "--no-open", "--out", "p.html", "--input", "copies")
    assert referenced(Path("p.html")) == ["m0", "m1"]


def test_one_task_reads_its_own_input_alone(
    metapp: Callable, fitted: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, read = fitted("meta"), list[str]()
    task = Source.task
    monkeypatch.setattr(Source, "task", lambda self: read.append(Path(self.place).name) or task(self))
    metapp("view", run, "--no-open", "--out", "p.html", "--task", "m1")
    assert read == ["m1"]
    assert referenced(Path("p.html")) == ["m1"]


def test_the_page_is_refused_before_it_is_made(metapp: Callable, fitted: Callable) -> None:
    assert (
        "--out /proc/pages: cannot be written to" in metapp("view", fitted("meta"), "--out", "/proc/pages/p.html").error
    )


def test_runs_that_differ_in_steps_alone_are_told_apart(metapp: Callable, fitted: Callable) -> None:
    runs = [fitted("overfit", "--steps", steps, "--out", steps) for steps in ("2", "3")]
    assert metapp("view", *runs, "--no-open", "--most", "1", "--out", "p.html").code == 0
    assert [fit["label"] for fit in groups_of(Path("p.html"))[0]["fits"]] == ["overfit steps 2", "overfit steps 3"]


def test_what_is_no_run_is_refused_in_a_line(metapp: Callable, fitted: Callable) -> None:
    Path("empty").mkdir()
    assert "empty: no record.jsonl with fits, expected a run's folder" in metapp("view", "empty").refusal
    assert "nowhere: no such folder, expected" in metapp("view", "nowhere").refusal
    Path("notes.txt").write_text("gold")
    assert "notes.txt: a file, expected a run's folder" in metapp("view", "notes.txt").refusal
    Path("fit.safetensors").write_bytes(b"x")
    assert "fit.safetensors: parameters without their run" in metapp("view", "fit.safetensors").refusal
    assert "no record of task 'm9', expected one of" in metapp("view", fitted("meta"), "--task", "m9").refusal


@pytest.mark.long
def test_one_input_of_an_application_is_made_fitted_and_shown(metapp: Callable, opened: list[str]) -> None:
    told = metapp("try", "brdf", "--json").done
    assert opened == [Path("try/try.html").resolve().as_uri()]
    (fit,) = told["fits"]
    assert (fit["app"], fit["name"]) == ("brdf", "paint")
    assert 0 < fit["seconds"] < fit["whole_seconds"] < told["seconds"]
    assert [group["title"] for group in groups_of(Path(told["page"]))] == ["paint"]
    assert "'brfd' is not an application" in metapp("try", "brfd").misuse


@pytest.mark.long
def test_what_cannot_be_fitted_is_left_out_of_all(
    metapp: Callable, opened: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def without(app: str, out: Path, recipe: str = "") -> tuple[Path, dict[str, Any]]:
        if app != "brdf":
            raise ValueError(f"{app} needs weights")
        return try_app(app, out, recipe)

    monkeypatch.setattr("metapp.extensions.viewer.viewing.try_app", without)
    told = metapp("try")
    assert told.code == 0
    assert "warning: texture is left out: texture needs weights" in told.err
    assert [group["title"] for group in groups_of(Path("try/try.html"))] == ["paint"]
    assert metapp("try", "texture").refusal == "error: texture needs weights"


def test_fits_that_cannot_be_shown_are_left_out(
    metapp: Callable, fitted: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, lacking = fitted("meta"), {"m0"}
    view = brdf.view

    def some(app: Brdf, theta: Params, task: Task) -> View:
        if task.name in lacking:
            raise ValueError(f"{task.name}: no photo, expected one; give it by --input.")
        return view(app, theta, task)

    monkeypatch.setattr(brdf, "view", some)
    result = metapp("view", run, "--no-open", "--out", "some.html")
    assert (result.code, [group["title"] for group in groups_of(Path("some.html"))]) == (0, ["m1"])
    assert "warning: left out: meta of m0: no photo, expected one; give it by --input." in result.err
    lacking.add("m1")
    assert "m0: no photo, expected one" in metapp("view", run, "--no-open", "--out", "none.html").error
    assert not Path("none.html").exists()
