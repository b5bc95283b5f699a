"""`metapp compare`: two runs side by side."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from metapp.storage.fits import read_fits, write_fit

pytestmark = pytest.mark.usefixtures("small_spheres")
NETWORKS = 3


def test_errors_ratio_and_colours_of_spheres_are_shown(metapp: Callable, fitted: Callable) -> None:
    """Colours in CIE 2000 units from the reference; the same run twice is as far off twice."""
    meta, quickft = fitted("meta"), fitted("quickft")
    told = metapp("compare", meta, quickft, "--json").done
    assert [run["label"] for run in told["runs"]] == ["meta", "quickft"]
    for side, run in enumerate((meta, quickft)):
        errors = [record["error"] for record in read_fits(run)]
        assert [task["error"][side] for task in told["tasks"]] == errors
        assert told["runs"][side]["error"] == pytest.approx(np.mean(errors))
    ratio = told["runs"][0]["error"] / told["runs"][1]["error"]
    assert told["compared"]["value"] == pytest.approx(ratio)
    assert told["compared"]["low"] <= ratio <= told["compared"]["high"]
    swapped = metapp("compare", quickft, meta, "--json").document["compared"]
    assert swapped["value"] == pytest.approx(1 / ratio)
    assert swapped["ahead"] + told["compared"]["ahead"] == 3
    (median, high) = (
        told["measures"][f"CIE 2000 colour difference of 3 spheres drawn, {s} of pixels"] for s in ("median", "95 %")
    )
    assert all(0 < low < top < 100 for low, top in zip(median["means"], high["means"], strict=True))
    itself = metapp("compare", meta, meta, "--json").document
    assert (itself["compared"]["value"], itself["compared"]["ahead"]) == (1.0, 0)
    assert [side["label"] for side in itself["runs"]] == ["A", "B"]
    assert {one == other for one, other in (each["means"] for each in itself["measures"].values())} == {True}


@pytest.mark.long
def test_the_picture_has_reference_and_both_fits(metapp: Callable, fitted: Callable) -> None:
    meta, pixels = fitted("meta"), []
    for other in ("general", "quickft"):
        result = metapp("compare", meta, fitted(other), "--out", f"{other}.png", "--task", "m1")
        assert result.code == 0
        assert f"meta over {other}'s" in result.out
        pixels.append(oiio.ImageBuf(f"{other}.png").get_pixels())
    assert pixels[0].shape[0] > 3 * 150
    assert not np.array_equal(*(each[-190:-50, :200] for each in pixels))  # the last row is the other paradigm's


def test_tasks_of_one_run_alone_are_left_out(metapp: Callable, fitted: Callable, networks: Path) -> None:
    result = metapp("compare", fitted("meta"), fitted("meta", "--seed", "3", inputs=networks / "m1"), "--json")
    assert [task["name"] for task in result.document["tasks"]] == ["m1"]
    assert [side["label"] for side in result.document["runs"]] == ["seed-0", "seed-3"]
    assert "2 tasks of one run alone are left out" in result.err
    assert "other content" not in result.err
    changed = Path(shutil.copytree(networks / "m0", "m1"))
    result = metapp("compare", fitted("meta"), fitted("meta", "--seed", "4", inputs=changed))
    assert "1 tasks in common have other content in the two runs, and the same name" in result.err


def test_without_what_was_fitted_there_is_a_table_and_no_picture(
    metapp: Callable, fitted: Callable, neural_fits: Callable[[int], Path]
) -> None:
    run = fitted("general", inputs=Path(shutil.copytree(neural_fits(2), "mine")))
    shutil.rmtree("mine")
    result = metapp("compare", run, run)
    assert result.code == 0
    assert "m1" in result.out
    assert "no picture: fits or what was fitted are not there" in result.err
    assert Path(metapp("compare", run, run, neural_fits(2), "--json").document["picture"]).is_file()


def test_what_cannot_be_compared_is_one_line(metapp: Callable, fitted: Callable, networks: Path) -> None:
    run = fitted("general")
    alone = run / "m0"
    record = read_fits(run)[0]
    record["settings"]["app"] = "texture"
    write_fit(Path("other"), record)
    for words, said in (
        ((run, "other"), "runs of brdf and texture, expected two of one application; take another run."),
        ((run, "nowhere"), "nowhere: no such folder, expected a run's folder"),
        ((run, alone, "--task", "m2"), "no record of task 'm2', expected one of m0."),
        ((run / "m1", alone), "1 and 1 tasks, none in common, expected some"),
    ):
        assert said in metapp("compare", *words).error
