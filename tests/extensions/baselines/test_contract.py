"""Every application has baselines under each of its protocols, and its table prints them."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from msgspec import structs
from rich.console import Console
from torch import Generator, Tensor

from metapp.cli.evaluation_output import make_rich_table
from metapp.evaluation.evaluation_run import EvaluationRun
from metapp.evaluation.figures import draw_figure as draw_figure
from metapp.extensions.baselines import baselines_of
from metapp.extensions.baselines.baseline import CostLimits, TrainingTasks
from metapp.extensions.baselines.baselines_table import baseline_fits, baselines_table
from metapp.extensions.examples.examples_command import example_lines
from metapp.learning.app import stack_tasks
from metapp.learning.task import Task
from metapp.registry import WITHOUT_VARIABLE as LEAVING_OUT
from metapp.registry import registry
from metapp.runs.reporter import Reporter, use_reporter
from metapp.runs.spec import parse_fit_options
from metapp.storage.fit_folders import read_params
from metapp.storage.shards import write_data_set
from tests.kept_fits import fit_of, write_fit
from tests.marked import long
from tests.recipe_apps import app_by_recipe, app_names, application, observations_of

PLACED = [(name, protocol) for name in app_names() for protocol in observations_of(name)]
WITHOUT_VARIABLE = (("svbrdf_nonstationary", "reference"), ("transport", ""))  # any
TRAIN, TEST = 6, 2


def random_task(app: str, name: str, rng: Generator, angles: Tensor) -> Task:
    """A task of little but noise, as small as the application takes it."""

    def uniform(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=rng)

    def picture(*shape: int) -> Tensor:
        return (255 * uniform(*shape)).to(torch.uint8)

    if app == "brdf":
        lobe = torch.exp(-10 * angles[:, :1] ** 2)
        reflectance = uniform(3) + 2 * uniform(3) * lobe
        return Task(name, {"angles": angles, "reflectance": reflectance, "render": uniform(8, 8, 4)})
    if app == "illumination":
        mirror = {"seen": uniform(3, 32, 64), "certain": uniform(2, 32, 64) / 2}
        return Task(name, {"map": uniform(3, 32, 64) + 0.1, "photos": picture(1, 3, 64, 64)} | mirror)
    if app == "svbrdf_nonstationary":
        normal = torch.tensor([0.0, 0.0, 1.0])[:, None, None].expand(3, 64, 64)
        maps = torch.cat([normal, 0.1 + 0.8 * uniform(7, 64, 64)])
        return Task(name, {"maps": maps, "predicted": maps.flip(-1), "photo": picture(3, 64, 64)})
    if app == "transport":
        return Task(name, {"samples": uniform(512, 4), "held_out": uniform(64, 4), "image": uniform(3, 32, 32)})
    return Task(name, {"image": picture(3, 64, 64)})


@pytest.fixture
def data(tmp_path: Path, rng: Generator) -> Callable[[str], Path]:
    """Writes a data set of noise."""

    def write(name: str) -> Path:
        angles, app = 0.6 * torch.rand(256, 3, generator=rng), registry().applications[name].app.load()
        units = dict.fromkeys((*app.tensors, "render"), "any")
        tasks = [random_task(name, f"t{i}", rng, angles) for i in range(TRAIN + TEST)]
        splits = ["train"] * TRAIN + ["test"] * TEST
        write_data_set(tmp_path / "data", name, units, [(*pair, "") for pair in zip(tasks, splits, strict=True)])
        return tmp_path / "data"

    return write


@pytest.fixture
def subject_of(data: Callable[[str], Path], tmp_path: Path, second_scene: Path) -> Callable[[str, str], EvaluationRun]:
    def make(name: str, protocol: str) -> EvaluationRun:
        of_app: dict[str, Any] = {"observe": protocol, "recipe": "quick", "data": data(name), "out": tmp_path / "runs"}
        planned = parse_fit_options(name, "general", **of_app, device="cpu", quiet=True)
        subject = EvaluationRun(*planned, is_measuring=False)  # paradigms may lack what their checkpoints need
        subject.is_measuring = True
        return subject

    return make


@pytest.mark.usefixtures("second_scene")
@pytest.mark.parametrize(("name", "protocol"), PLACED)
def test_predictions_of_baselines_are_drawn_where_applications_have_pictures(
    name: str, protocol: str, rng: Generator
) -> None:
    app = app_by_recipe(name, observes=protocol)
    if name not in ("brdf", "transport") and (name, protocol) not in WITHOUT_VARIABLE:
        tasks = [random_task(name, f"t{i}", rng, torch.zeros(0)) for i in range(3)]
        first, allowed = baselines_of(application(app.name), app)[0], CostLimits(64, 20_000)
        first.prepare(TrainingTasks(app, tasks), allowed)
        answer = first.fit(stack_tasks(app, tasks[:1]), rng, allowed)
        assert answer.asset
        asset = answer.asset(tasks[0], None)
        assert asset.preview().shape[2] == 3
        pictures = asset.pictures()
        assert pictures
        for pixels, kind in pictures.values():
            assert pixels.shape[2] in (1, 3)
            assert pixels.isfinite().all()
            assert kind in ("height", "radiance") or 0 <= float(pixels.min()) <= float(pixels.max()) <= 1


def pretend_paradigms(subject: EvaluationRun, error: float = 1.0) -> None:
    """Fits by Meta that cost nothing, and none of other paradigms."""
    fits = [fit_of(task.name, task.name, error, seconds=1.0, threads=1) for task in subject.tasks]
    for name in subject.specs:
        subject.requested[name] = subject.tasks, fits if name == "meta" else []


def rows_of(subject: EvaluationRun) -> dict[str, dict[str, Any]]:
    """The rows of the baselines in their table, by name."""
    return {row["paradigm"]: row for row in subject.table("baselines").rows if row["baseline"]}


@pytest.mark.parametrize(("name", "protocol"), [long(*place) if place[0] == "brdf" else place for place in PLACED])
def test_every_application_has_baselines_and_its_table_prints_them(
    name: str, protocol: str, subject_of: Callable[[str, str], EvaluationRun], monkeypatch: pytest.MonkeyPatch
) -> None:
    subject = subject_of(name, protocol)
    offered = baselines_of(application(subject.app.name), subject.app)
    assert bool(offered) == ((name, protocol) not in WITHOUT_VARIABLE)
    assert len({baseline.name for baseline in offered}) == len(offered)
    pretend_paradigms(subject, 0.2 * subject.app.error_measure.scale)
    table, rows = subject.table("baselines"), rows_of(subject)
    for baseline in offered:
        assert re.fullmatch(r"[a-z0-9_@]+", baseline.name)
        assert min(len(baseline.title), len(baseline.cannot)) > 10
        row = rows[baseline.name]
        assert row["tasks"] == TEST, baseline.name
        assert row["error"] is not None
        assert row["kept_bytes"] > 0
        assert (row["seconds"] is None) == bool(baseline.stored_tensor)
        assert not baseline.learns or row["shared"] > 0
    with (console := Console(width=200, force_terminal=False)).capture() as shown:
        console.print(make_rich_table(table))
    text = " ".join(shown.get().split())
    assert not any("no training tasks" in note for note in table.notes)
    drawn = {"svbrdf_stationary": ["nearest", "quilting"], "texture": ["nearest", "quilting", "blending"]}
    assert list(table.fits)[1:] == drawn.get(name, []) or not table.fits
    for baseline in offered:
        assert baseline.name in text
        assert any(baseline.cannot in note for note in table.notes)


def test_baselines_that_are_pictures_are_drawn_beside_metas_fits(
    subject_of: Callable[[str, str], EvaluationRun],
) -> None:
    subject = subject_of("texture", "")
    theta = {key: value[0] for key, value in subject.app.init(Generator().manual_seed(0), 1).items()}
    spec, run = subject.specs["meta"], subject.options.out / "meta"
    pretend_paradigms(subject)
    fits = [write_fit(run, fit_of(task.name, task.name, 1.0, spec), theta) for task in subject.tasks]
    subject.requested["meta"] = subject.tasks, fits
    assert subject.draw_fits("baselines", {}) is None
    table = subject.table("baselines")
    assert list(table.fits) == ["meta", "nearest", "quilting", "blending"]
    drawn = subject.draw_fits("baselines", table.fits)
    assert drawn == subject.options.out / "texture" / f"baselines-{subject.label}-quick.png"
    assert drawn.read_bytes().startswith(b"\x89PNG")
    kept = subject.options.out / "texture" / f"baseline-quilting-{subject.label}-quick" / "t6"
    assert read_params(kept)["picture"].shape == (64, 64, 3)


@pytest.mark.parametrize(
    ("ours", "said"), [(0.9, "lower on 8 of 8"), (1.1, "a higher error than meta's: unwrap"), (1.0, "no win")]
)
def test_notes_name_the_method_with_the_lower_error(
    ours: float, said: str, subject_of: Callable[[str, str], EvaluationRun], tmp_path: Path, rng: Generator
) -> None:
    subject = subject_of("illumination", "photo")
    subject.tasks.extend(task._replace(name=f"more{i}") for i, task in enumerate(subject.tasks * 3))
    pretend_paradigms(subject)
    meta, other = [], []
    for i, task in enumerate(subject.tasks):
        meta.append(fit_of(task.name, task.name, 1.0 + i, seconds=1.0))
        meta[-1].place = tmp_path
        error = (1 + i) * (ours if ours != 1 else 0.9 + 0.2 * (i % 2))
        figures = {"numbers": 1, "kept_bytes": 4, "shared": 8}
        other.append(structs.replace(meta[-1], error=error, seconds=0.5, figures=figures))
        other[-1].place = tmp_path
    subject.requested |= {
        "meta": (subject.tasks, meta),
        baselines_of(application(subject.app.name), subject.app)[0].name: (subject.tasks, other),
    }
    subject.is_measuring = False
    assert any(said in note for note in subject.table("baselines").findings)


def test_measures_that_are_not_finite_have_no_figure(
    subject_of: Callable[[str, str], EvaluationRun], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Such as differences of logs of a map that rings below 0."""
    subject = subject_of("illumination", "reference")
    measures = {"error": torch.tensor([2.0]), "map": torch.tensor([torch.inf])}
    monkeypatch.setattr(type(subject.app), "errors_of", lambda *_: measures)
    fits = baseline_fits(subject, baselines_of(application(subject.app.name), subject.app)[0])
    assert {fit.error for fit in fits} == {2.0 * subject.app.error_measure.scale}
    assert not any("map" in fit.further_errors for fit in fits)


def test_the_plane_shows_baselines(subject_of: Callable[[str, str], EvaluationRun]) -> None:
    subject = subject_of("svbrdf_nonstationary", "photo")
    pretend_paradigms(subject, 5.0)
    baseline_fits(subject, baselines_of(application(subject.app.name), subject.app)[0])
    subject.is_measuring = False
    drawn = draw_figure("plane", subject)
    assert drawn
    assert "Meta 5.000 in 1 s" in drawn[1]
    assert ", flat " in drawn[1]


def test_a_baseline_that_cannot_be_fitted_says_so_and_has_no_row_of_figures(
    subject_of: Callable[[str, str], EvaluationRun],
) -> None:
    subject, messages = subject_of("brdf", ""), list[str]()

    class Heard(Reporter):
        def say(self, message: str) -> None:
            messages.append(message)

    for task in subject.tasks:
        task.data["angles"] = task.data["angles"] + 0.01
    with use_reporter(Heard()):
        assert baseline_fits(subject, baselines_of(application(subject.app.name), subject.app)[0]) == []
    assert any("pca_20" in line and "other angles" in line for line in messages)
    subject.is_measuring = False
    assert rows_of(subject)["pca_20"]["tasks"] == 0


def test_without_training_tasks_baselines_that_need_them_have_no_cell(
    subject_of: Callable[[str, str], EvaluationRun], data: Callable[[str], Path]
) -> None:
    subject = subject_of("brdf", "")
    manifest = subject.options.data / "manifest.json"  # type: ignore[operator]
    manifest.write_text(manifest.read_text().replace('"train"', '"test"'))
    pretend_paradigms(subject)
    notes = subject.table("baselines").notes
    assert subject.requested.keys() - subject.specs.keys() == {"ggx_2"}  # nothing is missing
    assert any("no training tasks; metapp data synth brdf" in note for note in notes)


def test_stored_predictions_are_judged_where_all_tasks_hold_them(
    subject_of: Callable[[str, str], EvaluationRun], rng: Generator
) -> None:
    subject = subject_of("svbrdf_nonstationary", "photo")
    pretend_paradigms(subject)
    for task in subject.tasks:  # what is right has no error
        task.data["predicted"] = task.data["maps"].clone()
    row = rows_of(subject)["predicted"]
    assert (row["error"], row["mean_diffuse"], row["shared"]) == (0, 0, None)
    assert any(re.match(r"roughness: .*\bpredicted 0\.000", note) for note in subject.table("baselines").notes)
    del subject.tasks[-1].data["predicted"]
    table = baselines_table(subject)
    assert {row["paradigm"] for row in table.rows}.isdisjoint({"predicted"})
    assert any(note.startswith("predicted: left out, as not all tasks hold") for note in table.notes)


def test_no_fit_sees_what_another_method_predicts(rng: Generator) -> None:
    app = app_by_recipe("svbrdf_nonstationary", observes="photo")
    tasks = stack_tasks(app, [random_task(app.name, "t", rng, torch.zeros(0))])
    assert "predicted" in tasks.data
    assert "predicted" not in app.sample(tasks, rng, 1) | app.encoder_input(tasks, rng)


def test_nearest_training_task_of_a_training_task_is_itself(data: Callable[[str], Path], rng: Generator) -> None:
    """Its error is then 0, for every statistic that baselines compare."""
    angles = 0.6 * torch.rand(256, 3, generator=rng)
    for name, protocol in (("brdf", ""), ("texture", ""), ("svbrdf_stationary", "")):
        app = app_by_recipe(name, observes=protocol)
        tasks = [random_task(name, f"t{i}", rng, angles) for i in range(5)]
        (baseline,) = [baseline for baseline in baselines_of(application(app.name), app) if baseline.name == "nearest"]
        baseline.prepare(TrainingTasks(app, tasks), CostLimits(64, 1))
        fitted = baseline.fit(stack_tasks(app, tasks[3:4]), rng, CostLimits(64, 1))
        with torch.no_grad():
            assert app.errors_of(fitted.prediction(), stack_tasks(app, tasks[3:4]))["error"].item() < 1e-5
        assert (fitted.kept_numbers, fitted.kept_bytes) == (1, 4)


@pytest.mark.parametrize("name", app_names())
def test_the_methods_offered_are_those_of_all_protocols(name: str) -> None:
    apps = [app_by_recipe(name, observes=observed) for observed in observations_of(name)]
    methods = {baseline.name: None for app in apps for baseline in baselines_of(application(app.name), app)}
    assert list(registry().applications[name].baselines) == list(methods)


def test_without_the_extension_its_command_and_table_are_refused(
    metapp: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(LEAVING_OUT, "baselines")
    assert "--which 'baselines': expected one of results" in metapp("evaluate", "--which", "baselines").misuse
    assert "baselines" not in registry().tables
    assert not any(line.startswith("metapp baseline") for app in app_names() for line, _ in example_lines(app, Path()))
