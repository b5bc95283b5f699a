"""`metapp compare`: two runs side by side."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import OpenImageIO as oiio
import pytest

from metapp.storage.records import read_records

pytestmark = pytest.mark.usefixtures("small_spheres")


@pytest.fixture(scope="module")
def networks(neural_fits: Callable[[int], Path]) -> Path:
    return neural_fits(3)


@pytest.fixture
def fitted(metapp: Callable, tmp_path: Path) -> Callable[..., Path]:
    """Fits inputs and returns the run's folder."""

    def fit(paradigm: str, inputs: Path, *more: str) -> Path:
        words = (paradigm, "brdf", inputs, "--recipe", "quick", "--out", tmp_path / "runs", "--json", "--quiet", *more)
        return Path(metapp(*words).document["out"])

    return fit


def test_errors_seconds_ratio_and_a_picture_are_shown(metapp: Callable, fitted: Callable, networks: Path) -> None:
    meta, quickft = fitted("meta", networks), fitted("quickft", networks)
    result = metapp("compare", meta, quickft, "--json")
    assert result.code == 0
    told = result.document
    assert [run["label"] for run in told["runs"]] == ["meta", "quickft"]
    records = [read_records(run / "record.jsonl") for run in (meta, quickft)]
    for side, of in enumerate(records):
        assert [task["error"][side] for task in told["tasks"]] == [record["error"] for record in of]
        assert told["runs"][side]["error"] == pytest.approx(np.mean([record["error"] for record in of]))
    ratio = told["runs"][0]["error"] / told["runs"][1]["error"]
    assert told["compared"]["value"] == pytest.approx(ratio)
    assert told["compared"]["low"] <= ratio <= told["compared"]["high"]
    swapped = metapp("compare", quickft, meta, "--json").document["compared"]
    assert swapped["value"] == pytest.approx(1 / ratio)
    assert swapped["ahead"] + told["compared"]["ahead"] == 3


def test_the_picture_has_reference_and_both_fits(
    metapp: Callable, fitted: Callable, networks: Path, tmp_path: Path
) -> None:
    meta = fitted("meta", networks)
    one, two = (
        metapp("compare", meta, fitted(other, networks), "--out", tmp_path / f"{other}.png", "--task", "m1")
        for other in ("general", "quickft")
    )
    assert (one.code, two.code) == (0, 0)
    assert "meta over general's" in one.out
    pixels = [oiio.ImageBuf(str(tmp_path / f"{other}.png")).get_pixels() for other in ("general", "quickft")]
    assert pixels[0].shape[0] > 3 * 150
    assert not np.array_equal(*(each[-190:-50, :200] for each in pixels))  # the last row is the other paradigm's


def test_a_run_compared_with_itself_is_level(metapp: Callable, fitted: Callable, networks: Path) -> None:
    run = fitted("general", networks)
    told = metapp("compare", run, run, "--json").document
    assert (told["compared"]["value"], told["compared"]["ahead"]) == (1.0, 0)
    assert [side["label"] for side in told["runs"]] == ["A", "B"]


def test_tasks_of_one_run_alone_are_left_out(metapp: Callable, fitted: Callable, networks: Path) -> None:
    result = metapp("compare", fitted("meta", networks), fitted("meta", networks / "m1", "--seed", "3"), "--json")
    assert [task["name"] for task in result.document["tasks"]] == ["m1"]
    assert [side["label"] for side in result.document["runs"]] == ["seed-0", "seed-3"]
    assert "2 tasks of one run alone are left out" in result.err
    assert "tasks are the same by name" in result.err


def test_without_what_was_fitted_there_is_a_table_and_no_picture(
    metapp: Callable, fitted: Callable, neural_fits: Callable[[int], Path], tmp_path: Path
) -> None:
    shutil.copytree(neural_fits(2), tmp_path / "mine")
    run = fitted("general", tmp_path / "mine")
    shutil.rmtree(tmp_path / "mine")
    result = metapp("compare", run, run)
    assert result.code == 0
    assert "m1" in result.out
    assert "no picture: what was fitted is not there" in result.err
    again = metapp("compare", run, run, neural_fits(2), "--json")
    assert Path(again.document["picture"]).is_file()


def test_what_cannot_be_compared_is_one_line(
    metapp: Callable, fitted: Callable, networks: Path, tmp_path: Path
) -> None:
    run, alone = fitted("general", networks), fitted("general", networks / "m0")
    other = tmp_path / "other"
    other.mkdir()
    record = read_records(run / "record.jsonl")[0]
    record["settings"]["app"] = "texture"
    (other / "record.jsonl").write_text(json.dumps(record))
    for words, said in (
        ((run, other), "runs of brdf and texture, expected two of one application; take another run."),
        ((run, tmp_path / "nowhere"), "nowhere: no such folder with fits, expected a run's folder"),
        ((run, alone, "--task", "m2"), "no record of task 'm2', expected one of m0."),
        ((fitted("general", networks / "m1"), alone), "1 and 1 tasks, none in common, expected some"),
    ):
        result = metapp("compare", *words)
        assert result.code == 1
        errors = [line for line in result.err.splitlines() if line.startswith("error: ")]
        assert len(errors) == 1
        assert said in errors[0]
