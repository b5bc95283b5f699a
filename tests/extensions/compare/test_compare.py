"""`metapp compare`: runs side by side."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from metapp.runs.stored_fits import read_fits
from tests.kept_fits import fit_of, spec_with, write_fit

pytestmark = pytest.mark.usefixtures("small_spheres")
NETWORKS = 3


def test_runs_are_compared_with_the_first(metapp: Callable, fit_networks: Callable) -> None:
    """Colours in CIE 2000 units from the reference; the same run again is as far off again."""
    runs = fit_networks("meta"), fit_networks("quickft"), fit_networks("general")
    result = metapp("compare", *runs, "--json").json_result
    assert [run["label"] for run in result["runs"]] == ["meta", "quickft", "general"]
    base, *others = result["runs"]
    for side, run in enumerate(runs):
        errors = [fit.error for fit in read_fits(run)]
        assert [task["error"][side] for task in result["tasks"]] == errors
        assert result["runs"][side]["error"] == pytest.approx(np.mean(errors))
        assert [len(task["seconds"]) for task in result["tasks"]] == [3, 3, 3]
    assert base["compared"] is None
    for other in others:
        ratio = other["error"] / base["error"]
        assert other["compared"]["value"] == pytest.approx(ratio)
        assert other["compared"]["low"] <= ratio <= other["compared"]["high"]
    swapped = metapp("compare", *runs[1::-1], "--json").json_document["runs"][1]["compared"]
    assert swapped["value"] == pytest.approx(base["error"] / others[0]["error"])
    assert swapped["ahead"] + others[0]["compared"]["ahead"] == 3
    titles = [f"CIE 2000 colour difference of 3 spheres drawn, {share} of pixels" for share in ("median", "95 %")]
    for run in result["runs"]:
        median, high = (run["measures"][title]["mean"] for title in titles)
        assert 0 < median < high < 100
    again = metapp("compare", runs[0], runs[1], runs[0], "--json").json_document["runs"]
    assert [run["label"] for run in again] == ["A-meta", "B-quickft", "C-meta"]
    assert (again[2]["compared"]["value"], again[2]["compared"]["ahead"]) == (1.0, 0)
    assert again[0]["measures"][titles[0]]["mean"] == again[2]["measures"][titles[0]]["mean"]


@pytest.mark.long
def test_the_picture_has_reference_and_both_fits(metapp: Callable, fit_networks: Callable) -> None:
    meta, pixels = fit_networks("meta"), []
    for other in ("general", "quickft"):
        result = metapp("compare", meta, fit_networks(other), "--out", f"{other}.png", "--task", "m1")
        assert result.code == 0
        assert re.search(rf"task +┃ +meta ┃ +{other} ┃", result.out)
        for words in ("mean error", "ratio to meta's", "95 % interval", "lower than meta's on", "median seconds"):
            assert f"│ {words} " in result.out
        pixels.append(oiio.ImageBuf(f"{other}.png").get_pixels())
    assert pixels[0].shape[1] > 3 * 256
    assert not np.array_equal(*(picture[:, -256:] for picture in pixels))  # the last tile is the other paradigm's


def test_tasks_of_one_run_alone_are_left_out(metapp: Callable, fit_networks: Callable, networks: Path) -> None:
    result = metapp(
        "compare", fit_networks("meta"), fit_networks("meta", "--seed", "3", inputs=networks / "m1"), "--json"
    )
    assert [task["name"] for task in result.json_document["tasks"]] == ["m1"]
    assert [side["label"] for side in result.json_document["runs"]] == ["seed-0", "seed-3"]
    assert "2 tasks that not all runs have are left out" in result.err
    assert "other content" not in result.err
    changed = Path(shutil.copytree(networks / "m0", "m1"))
    result = metapp("compare", fit_networks("meta"), fit_networks("meta", "--seed", "4", inputs=changed))
    assert "1 tasks in common have other content in other runs, and the same name" in result.err


def test_missing_inputs_leave_a_table_without_a_picture(
    metapp: Callable, fit_networks: Callable, write_nbrdf_networks: Callable[[int], Path]
) -> None:
    run = fit_networks("general", inputs=Path(shutil.copytree(write_nbrdf_networks(2), "mine")))
    shutil.rmtree("mine")
    result = metapp("compare", run, run)
    assert result.code == 0
    assert "m1" in result.out
    assert "no picture: fits or the fitted files are missing" in result.err
    assert Path(metapp("compare", run, run, write_nbrdf_networks(2), "--json").json_document["picture"]).is_file()


def test_runs_that_cannot_be_compared_are_refused_in_one_line(
    metapp: Callable, fit_networks: Callable, networks: Path
) -> None:
    run = fit_networks("general")
    alone = run / "m0"
    write_fit(Path("other"), fit_of("m0", spec=spec_with(app="texture")))
    for words, message in (
        ((run, "other"), "runs of brdf and texture, expected runs of one application; take another run."),
        ((run, "nowhere"), "nowhere: no such folder, expected a run's folder"),
        ((run, alone, "--task", "m2"), "no record of task 'm2', expected one of m0."),
        ((run / "m1", alone), "1 and 1 tasks, none in common, expected some"),
    ):
        assert message in metapp("compare", *words).error
