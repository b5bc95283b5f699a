"""Folders of fits that the version before specifications wrote are read, shown, exported and compared as they were."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import metapp as api
from data_tools.synthetic.examples import write_example
from metapp.learning.app import stack_tasks
from metapp.learning.task import add_task_axis
from metapp.runs.data_sets.embedded import make_embedded_test_set
from metapp.runs.stored_fits import read_fits
from metapp.storage.fit_folders import RECORD
from tests.recipe_apps import application

STORED = Path(__file__).parent / "earlier_runs"  # a run of one file, and one of a task of the embedded data set


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """Both runs, as if their files were here: of paint.csv of `metapp examples brdf`, and of the embedded data set."""
    (paint,) = write_example("brdf", tmp_path / "inputs")
    folder = shutil.copytree(STORED, tmp_path / "runs")
    record = folder / "meta" / "paint" / RECORD
    record.write_text(record.read_text().replace("/materials/paint.csv", str(paint)))
    return folder


def test_specifications_of_earlier_records_say_what_was_fitted(runs: Path) -> None:
    of_file, of_data_set = (api.load(place) for place in (runs / "meta", runs / "quickft"))
    assert (of_file.error, of_data_set.spec.data) == (pytest.approx(0.988, abs=5e-4), "brdf-100-seed0-v3-test-cda549")
    spec = of_file.spec
    assert (spec.app, spec.paradigm, spec.recipe, spec.rule) == ("brdf", "meta", "quick", "meta-curvature")
    assert (spec.steps, of_data_set.spec.steps) == (5, 10)
    assert (spec.options, spec.digest, spec.checkpoint, spec.seed) == ({"conserve": True}, "7948d6c0a379", None, 0)
    assert of_data_set.rule == "adam"  # no learned rule
    assert of_file.app.conserve


def test_parameters_of_earlier_fits_give_their_error(runs: Path) -> None:
    """The task is found again by the path in the record, or in the embedded data set, and with it the stored error."""
    make_embedded_test_set(application("brdf"), quiet=True)
    for name in ("meta", "quickft"):
        fit = api.load(runs / name)
        assert fit.task.data, name
        errors = fit.app.errors(add_task_axis(fit.parameters), stack_tasks(fit.app, [fit.task]))
        assert fit.app.error_measure.scale * float(errors["error"][0]) == pytest.approx(fit.error, rel=1e-4)
    up = np.array([[0.0, 0.0, 1.0]])
    assert np.isfinite(api.load(runs / "meta")(up, up)).all()


def test_commands_read_earlier_runs(runs: Path, metapp: Callable, tmp_path: Path) -> None:
    exported = metapp("export", runs / "meta", "merl", "--out", tmp_path / "exported")
    assert exported.code == 0, exported.err
    assert (tmp_path / "exported" / "paint.binary").stat().st_size > 1e6
    compared = metapp("compare", runs / "meta", runs / "meta", "--out", tmp_path / "compared.png")
    assert compared.code == 0, compared.err
    page = metapp("view", runs / "meta", "--out", tmp_path / "page.html", "--no-open")
    assert page.code == 0, page.err


def test_written_again_an_earlier_record_is_one_of_today(runs: Path, tmp_path: Path) -> None:
    fit = api.load(runs / "meta")
    saved = api.load(fit.save(tmp_path / "paint.safetensors"))
    assert saved.spec == fit.spec
    fit.keep(tmp_path / "again")
    (kept,) = read_fits(tmp_path / "again")
    assert kept.spec == fit.spec
    assert "origin" not in json.loads((kept.folder / RECORD).read_text())
