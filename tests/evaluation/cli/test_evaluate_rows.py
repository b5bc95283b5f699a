"""Rows of the tables beside the results: ablation, trace, storage, samples, pictures."""

import shutil
from collections.abc import Mapping
from pathlib import Path

import pytest
import torch
from torch import Generator

from metapp.appearance.pictures import TimedFit
from metapp.apps.brdf.presenter import BrdfPresenter
from metapp.evaluation.evaluation_run import EvaluationRun
from metapp.evaluation.rows import paper_figures
from metapp.evaluation.tables.ablation import (
    combine_halves,
    has_general_initialisation,
    learned_rule_rows,
    swap_initialisations,
)
from metapp.evaluation.tables.convergence import CURVE_PARADIGMS, STEP_SHARES, traced_fits
from metapp.evaluation.tables.image import image_notes
from metapp.evaluation.tables.storage import checkpoint_bytes, parameter_bytes, samples
from metapp.learned_rules import rule_of
from metapp.learning.app import stack_tasks
from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import Adam, Guard
from metapp.learning.task import Task
from metapp.runs.spec import parse_fit_options
from tests.evaluation.cli.evaluation_runs import evaluation_run_of, table_rows
from tests.evaluation.test_notes import row


def test_the_ablation_has_four_corners(evaluation_run: EvaluationRun) -> None:
    """Two of them are rows of the results; rules with a network of their own have none."""
    planned = EvaluationRun(*parse_fit_options("brdf", "general", recipe="quick", quiet=True), is_measuring=False)
    assert "meta:ridge" in planned.specs
    assert learned_rule_rows(planned) == [
        name for name in planned.specs if name.startswith("meta") and name != "meta:ridge"
    ]
    ablation = {(row["start"], row["rule"]): row["error"] for row in table_rows(evaluation_run, "ablation")}
    results = {row["paradigm"]: row["error"] for row in table_rows(evaluation_run, "results")}
    start = "meta (meta-curvature)"
    assert set(ablation) == {(a, b) for a in ("general", start) for b in ("adam", "meta-curvature")}
    assert ablation["general", "adam"] == results["quickft"]
    assert ablation[start, "meta-curvature"] == results["meta"]
    assert len(set(ablation.values())) == 4


def test_ablation_rows_combine_the_named_start_and_rule(evaluation_run: EvaluationRun) -> None:
    places = [fits[0].folder.parent.name for _, _, fits in combine_halves(evaluation_run, "meta")]
    assert [place.split("-")[:2] for place in places] == [["ablation", "rule"], ["ablation", "start"]]
    meta, general, quickft = (evaluation_run.fitters[name] for name in ("meta", "general", "quickft"))
    tasks, recipe = stack_tasks(evaluation_run.app, evaluation_run.tasks), meta.recipe
    rule, start = swap_initialisations(meta, quickft)
    rngs = [torch.Generator().manual_seed(seed) for seed in (0, 1, 1)]
    ours = start.start(tasks, rngs[0])
    assert all(torch.equal(value[1], meta.phi.theta[key]) for key, value in ours.items())
    theirs = rule.start(tasks, rngs[1])
    encoded = general.method.start(tasks, rngs[2])
    assert all(torch.equal(theirs[key], encoded[key]) for key in encoded)
    assert start.steps == rule.steps == 10
    assert (rule.rule, rule.loss) == (meta.method.rule, meta.method.loss)
    assert (rule.adam, rule.guard) == (None, Guard(recipe.quickft))
    assert (start.adam, start.guard) == (quickft.method.adam, None)


def test_an_initialisation_that_is_generals_is_not_fitted_twice(evaluation_run: EvaluationRun) -> None:
    meta, general = (evaluation_run.fitters[name] for name in ("meta", "general"))
    assert not has_general_initialisation(evaluation_run, "meta")
    evaluation_run.fitters["meta"] = meta._replace(phi=meta.phi._replace(theta={}, encoder=general.phi.encoder))
    assert has_general_initialisation(evaluation_run, "meta")
    fits = [evaluation_run.fits("meta"), evaluation_run.fits("quickft")]
    assert [found for _, _, found in combine_halves(evaluation_run, "meta")] == fits
    assert any("General's own" in note for note in evaluation_run.table("ablation").notes)


def test_a_trace_is_the_fit_itself(evaluation_run: EvaluationRun) -> None:
    traces = traced_fits(evaluation_run)
    for name in CURVE_PARADIGMS:
        last = {fit.name: fit.figures["curves"][name][-1] for fit in traces}
        errors = {fit.name: pytest.approx(fit.error, rel=1e-6) for fit in evaluation_run.fits(name)}
        assert {task: error for task, (_, error) in last.items()} == errors
        assert {step for step, _ in last.values()} == {evaluation_run.steps(name)}
    assert [row["step"] for row in table_rows(evaluation_run, "convergence")[: len(STEP_SHARES)]] == [0, 2, 5, 8, 10]


def test_storage_counts_the_parameters_of_a_fit(evaluation_run: EvaluationRun) -> None:
    found = {row["paradigm"]: row for row in table_rows(evaluation_run, "storage")}
    network = parameter_bytes(evaluation_run.app.init(torch.Generator(), 1))
    assert network == 4 * 675
    assert found["overfit"]["bytes_100"] == found["finetune"]["bytes_100"] == 100 * network
    assert found["overfit"]["factor"] == 1
    for name in ("general", "quickft", "meta"):
        assert found[name]["bytes_1"] == found[name]["bytes_1000"]
    meta = found["meta"]
    assert meta["bytes_1"] <= meta["pays_from"] * network < meta["bytes_1"] + network


def test_the_papers_rule_stores_two_networks(evaluation_run: EvaluationRun) -> None:
    """An initialisation and a rate a weight: its compression factor is 2 / m, as the paper has it."""
    app = evaluation_run.app
    theta = {key: value[0] for key, value in app.init(Generator().manual_seed(0), 1).items()}
    alpha = rule_of("meta-sgd").initial_alpha(app, theta, 10, Adam(0.1))
    found = checkpoint_bytes(evaluation_run.fitters["meta"]._replace(phi=MetaParameters(theta, alpha)))
    assert found == paper_figures()["storage"]["meta_networks"] * parameter_bytes(theta)


def test_sample_counts_are_those_that_steps_draw(evaluation_run: EvaluationRun) -> None:
    found = {row["paradigm"]: row for row in table_rows(evaluation_run, "samples")}
    assert {row["all"] for row in found.values()} == {128}  # half of 256; the rest is held out
    assert found["overfit"]["saved"] == 0
    assert found["overfit"]["all_bytes"] == 128 * 6 * 4
    (task,) = [task for task in evaluation_run.tasks if task.name == "m0"]
    many = {key: value.repeat(128, 1) if value.ndim == 2 else value for key, value in task.data.items()}
    evaluation_run.tasks = [Task("m0", many)]
    found = {row["paradigm"]: row for row in samples(evaluation_run).rows}
    assert found["meta"]["seen"] == paper_figures()["samples"]["brdf"]["seen"] == 10 * 512
    assert found["meta"]["saved"] == 1 - 5120 / 16384
    assert found["quickft"]["seen"] == 10 * 512 + 1024
    assert found["general"]["seen"] == 1024


def test_picture_table_has_the_registered_measures(data: Path, evaluated_folder: Path, tmp_path: Path) -> None:
    runs = shutil.copytree(evaluated_folder / "runs", tmp_path / "runs")

    class Measured(BrdfPresenter):
        def picture_errors(self, fits: Mapping[str, TimedFit], task: Task) -> dict[str, dict[str, float]]:
            assert all(fit.seconds > 0 and fit.theta["w2"].shape == (21, 21) for fit in fits.values())
            value = 0.94 + 0.01 * int(task.name[1:])  # m0 is below the bound
            return {"regular": {"MAPE": 0.5}, **{name: {"SSIM": value, "MAPE": 0.25} for name in fits}}

        def comparison(self, *_: object) -> None:
            return None

    (kept,) = (runs / "brdf").glob("image-*")
    shutil.rmtree(kept)
    subject = evaluation_run_of(data, runs)
    subject.presenter = Measured(subject.app, subject.given.application)
    subject.has_paper_figures = True  # as of embedded tasks
    by = {(row["paradigm"], row["measure"]): row for row in table_rows(subject, "image")}
    assert by["regular", "MAPE"]["error"] == 0.5
    assert by["regular", "SSIM"]["error"] is None
    meta = by["meta", "SSIM"]
    assert (meta["error"], meta["worst"], meta["share"]) == (pytest.approx(0.95), 0.94, pytest.approx(2 / 3))
    assert meta["paper_share"] == 0.99
    assert by["meta", "MAPE"]["share"] is None
    assert (by["regular", "MAPE"]["measured"], by["regular", "SSIM"]["measured"]) == (3, 0)


def test_means_over_some_tasks_are_marked(evaluation_run: EvaluationRun) -> None:
    found = [
        row(name, 0.3) | {"measure": "MAPE, equal time", "measured": count, "paper_share": None}
        for name, count in (("reference", 1), ("general", 8), ("overfit", 0), ("meta", 3))
    ]
    notes = [note for note in image_notes(evaluation_run, found) if "others have none" in note]
    assert notes == ["meta, MAPE, equal time: mean of 3 of 8 tasks, the others have none"]
