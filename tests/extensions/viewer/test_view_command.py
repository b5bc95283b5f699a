"""`metapp view` and `metapp try`: which fits are on the page, and what is refused."""

import json
import os
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from metapp.extensions.viewer.pages import brdf
from metapp.extensions.viewer.runs_page import fit_synthetic_input
from metapp.extensions.viewer.view import View, make_view
from metapp.registry import WITHOUT_VARIABLE, registry
from metapp.runs import api
from metapp.runs.fit import Fit
from metapp.runs.inputs.finding import Input
from metapp.storage.files import file_name

pytestmark = pytest.mark.usefixtures("small_spheres")
NETWORKS = 2


@pytest.fixture
def opened_addresses(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Addresses that the browser would open."""
    addresses: list[str] = []
    monkeypatch.setattr("webbrowser.open", addresses.append)
    return addresses


def groups_of(page: Path) -> list[dict[str, Any]]:
    found = re.search(r'id="data">(.*?)</script>', page.read_text(encoding="utf-8"), re.DOTALL)
    assert found
    return json.loads(found[1])["groups"]


def test_runs_of_the_same_tasks_stand_side_by_side(
    metapp: Callable, fit_networks: Callable, opened_addresses: list[str]
) -> None:
    meta, quickft = fit_networks("meta"), fit_networks("quickft")
    result = metapp("view", meta, quickft, "--json", "--out", "both.html").json_result
    page = Path(result["page"])
    assert (page, result["bytes"]) == (Path("both.html"), page.stat().st_size)
    assert opened_addresses == [page.resolve().as_uri()]
    groups = groups_of(page)
    assert [group["title"] for group in groups] == ["m0", "m1"]
    for group in groups:
        assert [fit["label"] for fit in group["fits"]] == ["meta", "quickft"]
        assert all("error x100" in fit["caption"] and "residual" in fit["arrays"] for fit in group["fits"])


def test_without_a_name_the_newest_run_is_shown(
    metapp: Callable, fit_networks: Callable, opened_addresses: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    run = fit_networks("meta")
    top = next(folder for folder in run.resolve().parents if folder.name == "runs")
    monkeypatch.chdir(top.parent)
    result = metapp("view", "--json").json_result
    assert (top.parent / result["page"]).parent == run.resolve()
    assert len(opened_addresses) == 1
    monkeypatch.chdir(run)
    assert metapp("view").error.startswith("error: runs: no such folder, expected a run's folder")


def test_a_page_of_one_task_is_small(metapp: Callable, fit_networks: Callable, opened_addresses: list[str]) -> None:
    run = fit_networks("meta")
    file = run / "m0"
    result = metapp("view", file, "--no-open", "--json", "--out", "one.html").json_result
    assert not opened_addresses
    assert [group["title"] for group in groups_of(Path(result["page"]))] == ["m0"]
    assert result["bytes"] < 3_000_000
    named = metapp("view", run, "--task", "m0", "--no-open", "--json", "--out", "task.html").json_result
    assert named["bytes"] == result["bytes"]
    fewer = metapp("view", run, "--most", "1", "--no-open", "--out", "fewer.html")
    assert "view: 1 of 2 tasks; --most 2 shows all." in fewer.err
    assert len(groups_of(Path("fewer.html"))) == 1


def test_each_input_that_has_not_changed_is_found(metapp: Callable, fit_networks: Callable, networks: Path) -> None:
    """Inputs are found by their content, wherever they are."""

    def referenced(*more: str) -> list[str]:
        """Titles of the groups whose fits have a reference."""
        result = metapp("view", run, "--no-open", "--overwrite", "--out", "p.html", *more)
        groups = groups_of(Path("p.html"))
        found = [group["title"] for group in groups if all("residual" in fit["arrays"] for fit in group["fits"])]
        line = f"view: the inputs of {2 - len(found)} of 2 fits are not at hand; give them by --input or --data"
        assert (line in result.err) == (len(found) < 2)
        return found

    shutil.copytree(networks, "mine", copy_function=shutil.copyfile)
    run = fit_networks("meta", inputs=Path("mine"))
    Path("mine/m0").rename("m0")
    assert referenced() == ["m1"]
    assert referenced("--input", "m0") == ["m0"]
    Path("m0").rename("mine/m0")
    for file in Path("mine/m1").iterdir():
        file.touch()
    assert referenced() == ["m0", "m1"]
    shutil.copytree("mine", "copies", copy_function=shutil.copyfile)
    shutil.rmtree("mine/m1")
    shutil.copytree("mine/m0", "mine/m1", copy_function=shutil.copyfile)
    assert referenced() == ["m0"]
    shutil.rmtree("mine")
    assert referenced() == []
    assert referenced("--input", "copies") == ["m0", "m1"]


def test_one_task_reads_its_own_input_alone(
    metapp: Callable, fit_networks: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, read = fit_networks("meta"), list[str]()
    task = Input.read_task
    monkeypatch.setattr(Input, "read_task", lambda self, *by: read.append(Path(self.place).name) or task(self, *by))
    metapp("view", run, "--no-open", "--out", "p.html", "--task", "m1")
    metapp("view", run, "--no-open", "--out", "q.html", "--most", "1")
    assert read == ["m1", "m0"]


def test_runs_that_differ_in_steps_alone_have_different_labels(metapp: Callable, fit_networks: Callable) -> None:
    runs = [fit_networks("overfit", "--steps", steps, "--out", steps) for steps in ("2", "3")]
    assert metapp("view", *runs, "--no-open", "--most", "1", "--out", "p.html").code == 0
    assert [fit["label"] for fit in groups_of(Path("p.html"))[0]["fits"]] == ["overfit steps 2", "overfit steps 3"]


def test_arguments_that_name_no_fit_are_refused_in_one_line(metapp: Callable, fit_networks: Callable) -> None:
    run = fit_networks("meta")
    Path("notes.txt").write_text("gold")
    Path("empty").mkdir()
    for words, line in (
        (["notes.txt"], "notes.txt: a file, expected a run's folder"),
        (["empty"], "empty: no folders of fits, expected a run's folder"),
        ([run, "--task", "m9"], "no record of task 'm9', expected one of"),
        ([run, "--out", "/proc/pages/p.html"], "--out /proc/pages: cannot be written to"),
    ):
        assert line in metapp("view", *words).error


@pytest.mark.long
def test_one_input_of_an_application_is_made_fitted_and_shown(metapp: Callable, opened_addresses: list[str]) -> None:
    result = metapp("try", "brdf", "--json").json_result
    assert opened_addresses == [Path("try/try.html").resolve().as_uri()]
    (fit,) = result["fits"]
    assert (fit["app"], fit["name"]) == ("brdf", "paint")
    assert 0 < fit["seconds"] < fit["whole_seconds"] < result["seconds"]
    assert [group["title"] for group in groups_of(Path(result["page"]))] == ["paint"]
    assert "'brfd' is not an application" in metapp("try", "brfd").misuse


@pytest.mark.long
def test_applications_that_cannot_be_fitted_are_left_out_of_all(
    metapp: Callable, opened_addresses: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def without(app: str, out: Path, recipe: str = "") -> tuple[Path, dict[str, Any]]:
        if app != "brdf":
            raise ValueError(f"{app} needs weights")
        return fit_synthetic_input(app, out, recipe)

    monkeypatch.setattr("metapp.extensions.viewer.runs_page.fit_synthetic_input", without)
    result = metapp("try")
    assert result.code == 0
    assert "warning: texture is left out: texture needs weights" in result.err
    assert [group["title"] for group in groups_of(Path("try/try.html"))] == ["paint"]
    assert metapp("try", "texture").refusal == "error: texture needs weights"


# pages, as entries of the registry name them


def view_of_none(fit: Fit) -> View:
    raise ValueError(f"{fit.name}: no photo, expected one; give it by --input.")


def view_of_some(fit: Fit) -> View:
    return (view_of_none if fit.name == "m0" else brdf.make_reflectance_page)(fit)


def test_fits_that_cannot_be_shown_are_left_out(
    metapp: Callable, fit_networks: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = fit_networks("meta")
    page = replace(registry().pages["reflectance"], reference=f"{__name__}:view_of_some")
    monkeypatch.setitem(registry().pages, "reflectance", page)
    result = metapp("view", run, "--no-open", "--out", "some.html")
    assert (result.code, [group["title"] for group in groups_of(Path("some.html"))]) == (0, ["m1"])
    assert "warning: left out: meta of m0: no photo, expected one; give it by --input." in result.err
    page = replace(page, reference=f"{__name__}:view_of_none")
    monkeypatch.setitem(registry().pages, "reflectance", page)
    assert "m0: no photo, expected one" in metapp("view", run, "--no-open", "--out", "none.html").error
    assert not Path("none.html").exists()


# Offers


def test_without_the_extension_fits_work_and_view_is_refused(
    fit_networks: Callable, networks: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = fit_networks("meta")
    monkeypatch.setenv(WITHOUT_VARIABLE, "viewer")
    assert fit_networks("meta") == run
    fit = api.fit("brdf", networks / "m0", recipe="quick")
    with pytest.raises(AttributeError, match="no attribute 'view'"):
        fit.view()
    assert "view" not in dir(fit)
    assert fit._repr_html_()


def test_an_application_without_a_page_shows_its_pictures(networks: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fit = api.fit("brdf", networks / "m0", recipe="quick")
    assert make_view(fit).kind == "brdf"
    monkeypatch.delitem(registry().pages, "reflectance")
    view = make_view(fit)
    assert (view.kind, set(view.pictures)) == ("pictures", {"reference", "fit"})


def test_a_fit_writes_its_page(networks: Path, tmp_path: Path) -> None:
    fit = api.fit("brdf", networks / "m0")
    assert "view" in dir(fit)
    page = fit.view()
    assert page == Path(f"{file_name(fit.name)}.html")
    assert "VIEWERS.brdf" in page.read_text(encoding="utf-8")
    assert fit.view(tmp_path / "a b.html").is_file()
    assert fit.view(os.fsencode(tmp_path) + b"/\xff.html").is_file()
