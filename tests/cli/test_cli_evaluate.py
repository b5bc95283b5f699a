"""Tables, figures and the report: what they say of records, what they do not claim, and runs that were killed."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Generator

from metapp.appearance.presentation import Fitted
from metapp.appearance.sphere import environment_scene, shade_sphere
from metapp.apps import load_app
from metapp.apps.brdf import APP
from metapp.apps.brdf.presentation import BrdfPresentation
from metapp.cli.evaluate import find_subjects
from metapp.cli.show import rich_table
from metapp.experiments import session
from metapp.experiments.figures import FIGURES
from metapp.experiments.figures.rates import step_sizes
from metapp.experiments.report.html import EMBEDDED, Pictures, identifier
from metapp.experiments.reporter import Reporter, duration, reporting
from metapp.experiments.session import Checkpoint, Options, find_device, threads_of
from metapp.experiments.tables import NAMES, load_table
from metapp.experiments.tables.ablation import RULE_ALONE, START_ALONE, combined, learned, same_start
from metapp.experiments.tables.convergence import steps_needed
from metapp.experiments.tables.image import image_cell
from metapp.experiments.tables.rows import blank, paper
from metapp.experiments.tables.running import Clock, run_cells
from metapp.experiments.tables.statistics import carried
from metapp.experiments.tables.storage import kept, size
from metapp.experiments.tables.subject import Cell, Subject
from metapp.experiments.tables.trace import FURTHER, PARTS, looks, near, places, project, states_of, trace_cell
from metapp.learning.app import stack
from metapp.learning.learn import MetaParameters
from metapp.learning.recipe import Adam
from metapp.learning.rules import rule_of
from metapp.learning.task import Task
from metapp.storage.records import RunFolder, read_records
from tests.small_spheres import shrink_spheres

KEYS = {"app", "paradigm", "error", "seconds", "tasks", "low", "high", "paper_error", "paper_seconds"}


def row(paradigm: str, error: float | None, seconds: float = 1.0) -> dict[str, Any]:
    return blank("brdf", paradigm) | {"error": error, "seconds": seconds, "tasks": 8}


# The paper's figures


def test_the_papers_figures_have_sources_and_agree_with_each_other() -> None:
    known = paper()
    assert set(known["sources"]) == set(known) - {"source", "sources", "titles"}
    for kind in ("error", "seconds"):
        assert set(known[kind]) == set(known["titles"])
    gaps = {}
    for app in known["titles"]:
        rows = [blank(app, name) for name in ("general", "overfit", "meta")]
        gaps[app], _ = carried(rows, "paper_error", "paper_seconds")
    # as the design brief prints them
    expected = (0.80, 0.93, 0.60, 0.78, 0.97, 0.77)
    assert [round(gap, 2) for gap in gaps.values()] == list(expected)
    assert known["storage"]["factor"] == known["storage"]["meta_networks"] / known["storage"]["exemplars"]
    for each in known["samples"].values():
        assert 1 - each["seen"] / each["all"] == pytest.approx(each["saved"], abs=1e-3)


# Tables of small data


@pytest.fixture(scope="module")
def networks(neural_fits: Callable[[int], Path]) -> Path:
    return neural_fits(3)


@pytest.fixture(scope="module", autouse=True)
def few() -> Iterator[None]:
    """Few steps of Overfit and Finetune, and of what comes after Meta."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(APP.recipes, "quick", replace(APP.recipes["quick"], overfit_steps=40, finetune_steps=5))
        patch.setattr("metapp.experiments.tables.trace.FURTHER", (2, 4))
        shrink_spheres(patch)
        yield


@pytest.fixture(scope="module")
def data(networks: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three small materials, all of them test tasks."""
    folder = tmp_path_factory.mktemp("data") / "materials"
    assert call("data", "nbrdf", networks, "--split", "test", "--out", folder, "--samples", "256") == 0
    return folder


@pytest.fixture(scope="module")
def done(few: None, data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the runs of all tables, the figures and the report, by the checkpoints that ship."""
    folder = tmp_path_factory.mktemp("done")
    drawn = ("--report", folder / "report", "--figures", folder / "figures")
    assert call("evaluate", "brdf", "--data", data, "--out", folder / "runs", "--quiet", "--json", *drawn) == 0
    return folder


def call(*arguments: str | Path) -> int:
    """`metapp <arguments>`, where no test is to see what it prints."""
    from metapp.cli import console
    from metapp.cli.commands import app

    return int(console.run(lambda: app([str(each) for each in arguments], standalone_mode=False)))


@pytest.fixture
def evaluate(metapp: Callable, data: Path, tmp_path: Path) -> Callable:
    """`metapp evaluate brdf` on the three materials, into a folder of this test."""
    return lambda *arguments: metapp("evaluate", "brdf", "--data", data, "--out", tmp_path / "runs", *arguments)


def errors(document: dict[str, Any]) -> list[Any]:
    """What must not depend on how often a run was killed: all but seconds."""
    return [{key: value for key, value in row.items() if "seconds" not in key} for row in document["rows"]]


def test_all_tables_have_all_rows_in_every_format(evaluate: Callable, done: Path) -> None:
    empty = evaluate("--which", "all", "--no-run", "--json")
    assert empty.code == 0, empty.err
    assert all(row["error"] is None for row in empty.document["rows"])
    assert "brdf trace: 3 of 3 tasks missing: metapp evaluate brdf --which convergence" in empty.err
    common = ("--out", done / "runs", "--no-run")
    full = evaluate(*common, "--which", "all", "--json")
    assert full.code == 0, full.err
    assert "missing" not in full.err
    assert full.document["which"] == "all"
    rows = full.document["rows"]
    assert {row["table"] for row in rows} == set(NAMES)
    assert all(set(row) >= KEYS for row in rows)
    for row in (row for row in rows if row["table"] not in ("storage", "samples")):
        assert row["low"] <= row["error"] <= row["high"], row
        assert row["tasks"] == 3
    for name in NAMES:
        one = evaluate(*common, "--which", name, "--json").document
        assert one["which"] == name
        assert [row | {"table": name} for row in one["rows"]] == [row for row in rows if row["table"] == name]
    for form, mark in (("rich", "BRDF"), ("markdown", "| --- |"), ("latex", r"\bottomrule"), ("csv", "app,")):
        shown = evaluate(*common, "--which", "all", "--format", form)
        assert shown.code == 0, shown.err
        assert shown.out.count(mark) >= (1 if form == "csv" else len(NAMES))


def test_rows_are_compared_with_quickft_and_general_on_the_same_tasks(subject: Subject) -> None:
    found = {row["paradigm"]: row for row in rows(subject, "results")}
    ours, theirs = ([record["error"] for record in subject.cell(name).records()] for name in ("meta", "quickft"))
    meta = found["meta"]
    assert meta["vs_quickft"] == pytest.approx(sum(ours) / sum(theirs))
    assert meta["vs_quickft_low"] <= meta["vs_quickft"] <= meta["vs_quickft_high"]
    assert meta["vs_quickft_ahead"] == sum(a < b for a, b in zip(ours, theirs, strict=True))
    assert (meta["vs_quickft_tasks"], meta["vs_quickft_groups"], meta["vs_quickft_kind"]) == (3, 3, "ratio")
    assert found["quickft"]["vs_quickft"] is None
    assert found["quickft"]["vs_general"] < 1
    quickft = rows(subject, "quickft")[2]
    assert quickft["ahead"] == meta["vs_quickft_ahead"]
    assert quickft["apart"] is None  # too few tasks
    assert "too few to call a win" in " ".join(load_table("quickft").notes(subject, rows(subject, "quickft")))


def test_fits_that_carry_a_warning_are_counted(subject: Subject, evaluate: Callable, tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "warned", {})
    for i, record in enumerate(subject.cell("meta").records()):
        more = {"threads": 1, **({"warning": "the loss rose"} if i == 1 else {})}
        folder.add({key: value for key, value in record.items() if key not in ("key", "settings")} | more)
    subject._cells["meta"] = subject.cell("meta")._replace(folder=folder)
    for name in ("results", "quickft", "ablation"):
        found = rows(subject, name)
        assert [row["warnings"] for row in found] == [int("meta" in (row["paradigm"],)) for row in found]
        notes = load_table(name).notes(subject, found)
        assert "meta: 1 of 3 fits ended above their initialisation's loss" in notes
        assert not any("quickft: " in note and "fits ended" in note for note in notes)
    assert "threads: 1" in load_table("quickft").notes(subject, rows(subject, "quickft"))


@pytest.mark.parametrize("width", [60, 80, 120, 200])
def test_a_terminal_shows_as_many_columns_as_it_has_room_for(
    width: int, subject: Subject, monkeypatch: pytest.MonkeyPatch
) -> None:
    from rich.console import Console

    monkeypatch.setattr("metapp.cli.show.out", Console(width=width))
    for name in NAMES:
        table, found = load_table(name), rows(subject, name)
        if not found:
            continue
        console = Console(width=width)
        with console.capture() as shown:
            console.print(rich_table(table, subject, found))
        text = shown.get()
        assert max(map(len, text.splitlines())) <= width
        assert "…" not in text
        if width == 200:
            assert len(rich_table(table, subject, found).columns) == len(table.columns)
        for row in found:
            assert table.columns[0].text(row) in text, name


def test_an_overfit_of_fewer_steps_is_said_and_is_another_run(evaluate: Callable, done: Path) -> None:
    common = ("--out", done / "runs", "--no-run")
    short = evaluate(*common, "--overfit-share", "0.5")
    assert "20 of the recipe's 40 steps" in " ".join(short.out.split())
    assert "--steps 20" in short.err
    tasks = {row["paradigm"]: row["tasks"] for row in rows_of(evaluate(*common, "--overfit-share", "0.5", "--json"))}
    assert tasks == {"general": 3, "overfit": 0, "finetune": 3, "quickft": 3, "meta": 3}
    assert "of the recipe's" not in evaluate(*common).out


def rows_of(result: Any) -> list[dict[str, Any]]:
    return result.document["rows"]


KILLED = """
import os, signal, sys
from dataclasses import replace
from metapp.apps.brdf import APP, Brdf
APP.recipes["quick"] = replace(APP.recipes["quick"], overfit_steps=40, finetune_steps=5)
errors, calls = Brdf.errors, []
def dying(self, theta, tasks):
    calls.append(1)
    if len(calls) == int(sys.argv[1]):
        os.kill(os.getpid(), signal.SIGKILL)
    return errors(self, theta, tasks)
Brdf.errors = dying
from metapp.cli.commands import app
app(sys.argv[2:], standalone_mode=False)
"""


def test_a_run_that_is_killed_twice_gives_the_table_of_an_unbroken_one(
    evaluate: Callable, done: Path, data: Path, tmp_path: Path
) -> None:
    unbroken = evaluate("--json", "--out", done / "runs", "--no-run").document
    common = ["evaluate", "brdf", "--data", str(data), "--out", str(tmp_path / "broken"), "--quiet"]
    kept = []
    for calls in ("5", "7"):
        done = subprocess.run([sys.executable, "-c", KILLED, calls, *common], capture_output=True, check=False)
        assert done.returncode == -signal.SIGKILL, done.stderr
        kept.append(sum(len(read_records(file)) for file in (tmp_path / "broken").rglob("record.jsonl")))
    assert kept == [4, 10]
    resumed = evaluate("--json", "--out", tmp_path / "broken", "--quiet").document
    assert errors(resumed) == errors(unbroken)


@pytest.fixture
def subject(data: Path, done: Path) -> Subject:
    """The same materials, with all that has been run of them."""
    of, device = APP.at(APP.recipes["quick"]), torch.device("cpu")
    options = Options(of, "quick", "meta-curvature", None, data, done / "runs", None, 0, device, True)
    (found,) = find_subjects([options], run=True, strict=True, share=1.0)
    return found


def rows(subject: Subject, name: str) -> list[dict[str, Any]]:
    return load_table(name).rows(subject)


def test_the_ablation_leaves_out_rules_with_a_network_of_their_own() -> None:
    subject = Subject(session.options_of("brdf", quiet=True), run=False, strict=False)
    assert "meta:ridge" in subject.fits
    assert learned(subject) == [name for name in subject.fits if name.startswith("meta") and name != "meta:ridge"]


def test_the_ablation_has_four_corners_and_those_of_the_results_among_them(subject: Subject) -> None:
    ablation = {(row["start"], row["rule"]): row["error"] for row in rows(subject, "ablation")}
    results = {row["paradigm"]: row["error"] for row in rows(subject, "results")}
    start = "meta (meta-curvature)"
    assert set(ablation) == {(a, b) for a in ("general", start) for b in ("adam", "meta-curvature")}
    assert ablation["general", "adam"] == results["quickft"]
    assert ablation[start, "meta-curvature"] == results["meta"]
    assert len(set(ablation.values())) == 4


def test_what_is_combined_is_what_it_says(subject: Subject) -> None:
    cells = {rule: cell for _, rule, cell in combined(subject, "meta")}
    assert {cell.folder.path.parent.name for cell in cells.values() if cell.folder} == {
        "ablation-rule",
        "ablation-start",
    }
    meta, general, quickft = (subject.fits[name].checkpoint for name in ("meta", "general", "quickft"))
    assert meta
    assert general
    assert quickft
    tasks, rng = stack(subject.app, subject.tasks), torch.Generator().manual_seed(0)
    job = subject.options.job
    ours = START_ALONE.start(job, meta.prepared, tasks, rng)
    assert all(torch.equal(value[1], meta.prepared.theta[key]) for key, value in ours.items())
    mixed = general.prepared._replace(alpha=meta.prepared.alpha)
    theirs = RULE_ALONE.start(job, mixed, tasks, torch.Generator().manual_seed(1))
    encoded = subject.fits["general"].paradigm.start(job, general.prepared, tasks, torch.Generator().manual_seed(1))
    assert all(torch.equal(theirs[key], encoded[key]) for key in encoded)
    assert START_ALONE.count(job) == RULE_ALONE.count(job) == 10


def test_a_start_that_is_generals_is_not_fitted_twice(subject: Subject) -> None:
    meta, general = subject.fits["meta"], subject.fits["general"]
    assert meta.checkpoint
    assert general.checkpoint
    prepared = meta.checkpoint.prepared._replace(theta={}, encoder=general.checkpoint.prepared.encoder)
    own = meta.checkpoint._replace(prepared=prepared)
    assert not same_start(subject, "meta")
    subject.fits["meta"] = meta._replace(checkpoint=own)
    assert same_start(subject, "meta")
    assert [cell for _, _, cell in combined(subject, "meta")] == [subject.cell("meta"), subject.cell("quickft")]
    assert any("General's own" in note for note in load_table("ablation").notes(subject, []))


def test_a_trace_is_the_fit_itself(subject: Subject) -> None:
    cell = trace_cell(subject)
    for name in ("overfit", "finetune", "quickft", "meta"):
        last = {record["name"]: record["curves"][name][-1] for record in cell.records()}
        assert {task: error for task, (_, error) in last.items()} == {
            record["name"]: pytest.approx(record["error"], rel=1e-6) for record in subject.cell(name).records()
        }
        assert {step for step, _ in last.values()} == {
            subject.fits[name].paradigm.count(subject.fits[name].options.job)
        }
    assert [row["step"] for row in rows(subject, "convergence")[: len(PARTS)]] == [0, 2, 5, 8, 10]
    start = subject.fits["meta"].checkpoint
    assert start
    states = states_of(cell, subject.tasks[0])
    assert list(states) == list(PARTS)
    assert all(torch.equal(states[0.0][key], value) for key, value in start.prepared.theta.items())
    record = cell.records()[0]
    assert len(record["paths"]["overfit"]) == len(places(40))
    assert 0 < record["explained"] <= 1 + 1e-9


def test_storage_is_that_of_the_parameters(subject: Subject) -> None:
    found = {row["paradigm"]: row for row in rows(subject, "storage")}
    network = size(subject.app.init(torch.Generator(), 1))
    assert network == 4 * 675
    assert found["overfit"]["bytes_100"] == found["finetune"]["bytes_100"] == 100 * network
    assert found["overfit"]["factor"] == 1
    for name in ("general", "quickft", "meta"):
        assert found[name]["bytes_1"] == found[name]["bytes_1000"]
    meta = found["meta"]
    assert meta["bytes_1"] <= meta["pays_from"] * network < meta["bytes_1"] + network


def test_the_papers_rule_stores_two_networks(subject: Subject) -> None:
    """An initialisation and a rate a weight: its compression factor is 2 / m, as the paper has it."""
    app = subject.options.app
    theta = {key: value[0] for key, value in app.init(Generator().manual_seed(0), 1).items()}
    alpha = rule_of("meta-sgd").alpha(app, theta, 10, Adam(0.1))
    found = kept(Checkpoint(MetaParameters(theta, alpha), "", ""))
    assert found == paper()["storage"]["meta_networks"] * size(theta)


def test_samples_are_those_that_steps_draw(subject: Subject) -> None:
    found = {row["paradigm"]: row for row in rows(subject, "samples")}
    assert {row["all"] for row in found.values()} == {128}  # half of 256; the rest is held out
    assert found["overfit"]["saved"] == 0
    assert found["overfit"]["all_bytes"] == 128 * 6 * 4
    (task,) = [task for task in subject.tasks if task.name == "m0"]
    many = {key: value.repeat(128, 1) if value.ndim == 2 else value for key, value in task.data.items()}
    subject.__dict__["_data"] = ([Task("m0", many)], "many")
    found = {row["paradigm"]: row for row in rows(subject, "samples")}
    assert found["meta"]["seen"] == paper()["samples"]["brdf"]["seen"] == 10 * 512
    assert found["meta"]["saved"] == 1 - 5120 / 16384
    assert found["quickft"]["seen"] == 10 * 512 + 1024
    assert found["general"]["seen"] == 1024


def test_measures_of_pictures(subject: Subject, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def measured(self: Any, fits: Any, task: Task) -> dict[str, dict[str, float]]:
        assert all(fit.seconds > 0 and fit.theta["w2"].shape == (21, 21) for fit in fits.values())
        value = 0.94 + 0.01 * int(task.name[1:])  # m0 is below the bound
        return {"regular": {"MAPE": 0.5}, **{name: {"SSIM": value, "MAPE": 0.25} for name in fits}}

    monkeypatch.setattr(BrdfPresentation, "image_errors", measured)
    shutil.rmtree(image_cell(subject).folder.path)
    run_cells(load_table("image").cells(subject), quiet=True)
    by = {(row["paradigm"], row["measure"]): row for row in rows(subject, "image")}
    shutil.rmtree(image_cell(subject).folder.path)
    assert by["regular", "MAPE"]["error"] == 0.5
    assert by["regular", "SSIM"]["error"] is None
    meta = by["meta", "SSIM"]
    assert (meta["error"], meta["worst"], meta["share"]) == (pytest.approx(0.95), 0.94, pytest.approx(2 / 3))
    assert meta["paper_share"] == 0.99
    assert by["meta", "MAPE"]["share"] is None
    assert (by["regular", "MAPE"]["measured"], by["regular", "SSIM"]["measured"]) == (3, 0)


def test_means_of_some_tasks_alone_say_so(subject: Subject) -> None:
    found = [
        row(name, 0.3) | {"measure": "MAPE, equal time", "measured": count, "paper_share": None}
        for name, count in (("reference", 1), ("general", 8), ("overfit", 0), ("meta", 3))
    ]
    notes = [note for note in load_table("image").notes(subject, found) if "others have none" in note]
    assert notes == ["meta, MAPE, equal time: mean of 3 of 8 tasks, the others have none"]


def test_the_same_picture_has_an_ssim_of_one(subject: Subject) -> None:
    task = subject.tasks[0]
    theta = {key: value[0] for key, value in APP.init(torch.Generator().manual_seed(0), 1).items()}
    picture = shade_sphere(environment_scene(), lambda angles: APP.reflectance(theta, angles))
    same = Task("same", task.data | {"environment": picture})
    image_errors = BrdfPresentation(APP).image_errors
    measured = image_errors({"meta": Fitted(theta, 1.0)}, same)
    assert measured["meta"]["SSIM"] == pytest.approx(1, abs=1e-5)
    assert image_errors({"meta": Fitted(theta, 1.0)}, task)["meta"]["SSIM"] < 0.999
    older = Task("older", {key: value for key, value in task.data.items() if key != "environment"})
    assert image_errors({"meta": Fitted(theta, 1.0)}, older) == {}


# Convergence


def record(overfit: float, further: list[tuple[int, float]]) -> dict[str, Any]:
    return {"curves": {"overfit": [[0, 9.0], [40, overfit]]}, "further": further}


def test_further_steps_are_counted_until_one_is_near() -> None:
    assert steps_needed(record(1.0, [(0, 1.005)])) == 0
    assert steps_needed(record(1.0, [(0, 2.0), (8, 1.2), (16, 1.009)])) == 16
    assert steps_needed(record(1.0, [(0, 2.0), (FURTHER[-1], 1.02)])) is None
    assert near(-3.97, -4.0)  # lower is better, also below 0
    assert not near(-3.95, -4.0)
    assert near(-4.5, -4.0)


def test_looks_and_places_hold_the_start_and_the_end() -> None:
    for steps in (1, 8, 10, 15, 1000, 20_000):
        assert {0, steps} <= looks(steps)
        assert {0, steps} <= places(steps)
        assert {round(part * steps) for part in PARTS} <= looks(steps)
        assert max(looks(steps) | places(steps)) == steps


def test_the_plane_of_most_variance_keeps_distances_within_it(rng: torch.Generator) -> None:
    basis = torch.linalg.qr(torch.randn(50, 2, generator=rng, dtype=torch.float64))[0]
    flat = torch.randn(9, 2, generator=rng, dtype=torch.float64)
    states = flat @ basis.T + 3
    found, explained = project(states)
    torch.testing.assert_close(torch.cdist(found, found), torch.cdist(flat, flat))
    assert explained == pytest.approx(1)
    noisy = states + 0.5 * torch.randn(9, 50, generator=rng, dtype=torch.float64)
    assert project(noisy)[1] < 0.99


def test_step_sizes_of_rules() -> None:
    alpha = {"rate.w": torch.tensor([[[-0.5, 2.0]]]), "rate.b": torch.zeros(1, 1), "beta1": torch.zeros(3)}
    assert step_sizes("meta-sgd", alpha)["w"].tolist() == [-0.5, 2.0]
    assert set(step_sizes("meta-sgd", alpha)) == {"w"}  # one number is no histogram
    paced = step_sizes("meta-adam-tied", alpha | {"pace.w": torch.tensor([0.0, 1.0])})["w"]
    np.testing.assert_allclose(paced, np.exp([-0.5, 2.0, 0.5, 3.0]), rtol=1e-6)


# Running


def cell(title: str, path: Path, names: list[str], log: list[str], *, steps: int, stage: int = 0) -> Cell:
    folder = RunFolder(path / title.replace(" ", "-"), {"title": title})

    def measure(missing: list[Task]) -> Iterator[dict[str, Any]]:
        for task in missing:
            log.append(f"{title} {task.name}")
            folder.add({"name": task.name, "error": 1.0})
            yield {"name": task.name}

    return Cell(title, [Task(name, {}) for name in names], folder, measure, steps, f"run {title}", stage)


def test_cells_run_once_by_stage_and_steps(tmp_path: Path) -> None:
    log: list[str] = []
    late = cell("brdf late", tmp_path, ["a"], log, steps=0, stage=1)
    long = cell("brdf long", tmp_path, ["a", "b"], log, steps=100)
    short = cell("brdf short", tmp_path, ["a"], log, steps=1)
    assert long.folder
    long.folder.add({"name": "a", "error": 1.0})
    run_cells([late, long, short, long, short], quiet=True)
    assert log == ["brdf short a", "brdf long b", "brdf late a"]
    run_cells([late, long, short], quiet=True)
    assert len(log) == 3


def test_the_time_left_is_by_gradient_steps(tmp_path: Path) -> None:
    long = cell("brdf long", tmp_path, ["a", "b"], [], steps=99)
    other = cell("texture long", tmp_path, ["a"], [], steps=49)
    clock = Clock([(long, list(long.tasks)), (other, list(other.tasks))])
    assert clock.left() == 0
    clock.add(long, 10.0)
    assert clock.left() == pytest.approx(10.0 + 5.0)  # the other takes the mean rate as long as it has none
    clock.add(other, 1.0)
    assert clock.left() == pytest.approx(10.0)
    assert [duration(seconds) for seconds in (5, 300, 7200)] == ["5 s", "5 min", "2.0 h"]


def test_the_time_left_counts_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By a clock that stands still but for what a task takes: steps 0.1 s each, pictures 30 s where 20 were guessed."""
    now, told = [0.0], []
    monkeypatch.setattr("metapp.experiments.tables.running.time.perf_counter", lambda: now[0])

    class Hears(Reporter):
        def clock(self) -> Any:
            return contextlib.nullcontext(lambda note, spent, left: told.append((note.partition(",")[0], spent, left)))

    def taking(made: Cell, seconds: float) -> Cell:
        def measure(missing: list[Task]) -> Iterator[dict[str, Any]]:
            for each in made.measure(missing):
                now[0] += seconds
                yield each

        return made._replace(measure=measure)

    fits = taking(cell("transport fit", tmp_path, ["a", "b"], [], steps=9), 1.0)
    pictures = cell("transport pictures", tmp_path, ["a", "b"], [], steps=0, stage=1)
    with reporting(Hears()):
        run_cells([fits, taking(pictures._replace(guess=20.0), 30.0)], quiet=False)
    assert told == [
        ("transport fit", 0.0, 0.0),
        ("transport fit a", 1.0, pytest.approx(1.0 + 40.0)),
        ("transport fit b", 2.0, pytest.approx(40.0)),
        ("transport pictures", 2.0, pytest.approx(40.0)),
        ("transport pictures a", 32.0, pytest.approx(30.0)),  # as measured
        ("transport pictures b", 62.0, 0.0),
    ]


def test_fits_have_the_threads_of_their_application_whatever_ran_before(tmp_path: Path) -> None:
    found: list[tuple[str, int]] = []
    before = torch.get_num_threads()

    def with_threads(name: str, threads: int | None) -> Cell:
        made = cell(name, tmp_path, ["a"], [], steps=1)

        def measure(missing: list[Task]) -> Iterator[dict[str, Any]]:
            for each in made.measure(missing):
                found.append((name, torch.get_num_threads()))
                yield each

        return made._replace(measure=measure, threads=threads)

    try:
        torch.set_num_threads(2)
        run_cells([with_threads("one", 1), with_threads("three", 3), with_threads("as it is", None)], quiet=True)
        assert found == [("one", 1), ("three", 3), ("as it is", 2)]
        assert torch.get_num_threads() == 2
        for name, expected in (("illumination", 1), ("texture", session.THREADS)):
            app = load_app(name)
            find_device("cpu", app)
            assert torch.get_num_threads() == 2  # looking for a device changes nothing
            assert threads_of(app) == expected
    finally:
        torch.set_num_threads(before)


# Figures and the report


class Page(HTMLParser):
    """What a page holds, as far as it must be right."""

    VOID = frozenset({"meta", "link", "img", "br", "input"})

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, tag

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


def test_the_report_is_one_whole_page_that_needs_no_network(done: Path) -> None:
    page = done / "report" / "index.html"
    text = page.read_text()
    parsed = Page()
    parsed.feed(text)
    parsed.close()
    assert parsed.open == []
    assert [file.name for file in page.parent.iterdir()] == ["index.html"]
    assert len(text) < 15_000_000
    addresses = [value for _, attributes in parsed.tags for key, value in attributes.items() if key in ("src", "href")]
    assert all(address and address.startswith(("data:", "#")) for address in addresses)
    assert "http://" not in text
    assert "https://" not in text
    assert "@import" not in text
    images = parsed.all("img")
    assert len(images) == 6 + 3 * 6  # the figures, and six pictures a task
    assert all(image["alt"] for image in images)
    ids = [attributes["id"] for _, attributes in parsed.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert {address[1:] for address in addresses if address.startswith("#")} <= set(ids)
    assert "{{" not in text
    found = json.loads(text.partition('id="records">')[2].partition("</script>")[0])
    assert set(found) == {"brdf"}
    for button in (each for each in parsed.all("button") if each.get("class") == "record"):
        shown = found["brdf"]["records"][button["data-row"]][button["data-task"]]
        assert found["brdf"]["settings"][shown["key"]]["paradigm"] == button["data-row"]
    for expected in ("metapp evaluate brdf --which all", str(torch.__version__), "4555", "95 % interval"):
        assert expected in text or expected.replace("4555", "4,555") in text
    figures = {file.name for file in (done / "figures").iterdir()}
    assert figures == {f"brdf-{name}.{form}" for name in FIGURES for form in ("png", "pdf")}
    assert (done / "figures" / "brdf-plane.pdf").read_bytes().startswith(b"%PDF")


def test_a_report_of_nothing_is_a_page_as_well(evaluate: Callable, tmp_path: Path) -> None:
    assert evaluate("--no-run", "--report", tmp_path / "report", "--quiet").code == 0
    parsed = Page()
    parsed.feed((tmp_path / "report" / "index.html").read_text())
    assert parsed.open == []
    assert "not measured yet" in (tmp_path / "report" / "index.html").read_text()


def test_pictures_that_are_too_many_lie_beside_the_page(tmp_path: Path) -> None:
    pictures = Pictures()
    address = pictures.add("brdf-a", b"\x89PNG" * (EMBEDDED // 4))
    small = Pictures()
    assert small.place(small.add("b", b"\x89PNG"), tmp_path).startswith("data:image/png;base64,")
    assert pictures.place(f'<img src="{address}">', tmp_path) == '<img src="pictures/brdf-a.png">'
    assert (tmp_path / "pictures" / "brdf-a.png").read_bytes().startswith(b"\x89PNG")
    assert identifier("svbrdf", "", "a b/ü<>") == "svbrdf-a-b"


BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)


@pytest.mark.slow
@pytest.mark.skipif(BROWSER is None, reason="no Chromium here")
def test_a_browser_shows_the_report_without_an_error(done: Path, tmp_path: Path) -> None:
    page = tmp_path / "index.html"
    shot = tmp_path / "shot.png"
    # sort a table and open a record, as a reader does; what goes wrong is said on standard error
    acts = "document.querySelector('.sortable th button').click();document.querySelector('.record').click();"
    acts += "console.log('rows ' + document.querySelector('.sortable tbody').rows.length + ' ' + dialog.open);"
    page.write_text((done / "report" / "index.html").read_text().replace("</body>", f"<script>{acts}</script></body>"))
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--enable-logging=stderr", "--window-size=1280,3000"]
    done = subprocess.run(
        [str(BROWSER), *options, f"--user-data-dir={tmp_path / 'profile'}", f"--screenshot={shot}", page.as_uri()],
        capture_output=True, text=True, timeout=240, check=True, env=os.environ | {"HOME": str(tmp_path)},
    )  # fmt: skip
    said = [line for line in done.stderr.splitlines() if "CONSOLE" in line]
    assert len(said) == 1, said
    assert "rows 5 true" in said[0]
    assert shot.stat().st_size > 20_000
