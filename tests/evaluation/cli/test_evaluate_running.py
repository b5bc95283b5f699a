"""Records that are measured where missing: their order, progress, threads, and what is left out."""

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from metapp.apps.brdf.app import Brdf
from metapp.cli.evaluation_options import EvaluateOptions
from metapp.cli.evaluation_output import evaluation_runs_of
from metapp.evaluation.evaluation_run import EvaluationRun
from metapp.evaluation.tables.results import result_rows
from metapp.learning.task import Task
from metapp.runs.environment import find_device
from metapp.runs.fit import Fit
from metapp.runs.reporter import Bar, Reporter, use_reporter
from metapp.runs.spec import Spec
from tests.evaluation.cli.evaluation_runs import evaluation_run_of
from tests.kept_fits import fit_of, spec_with, write_fit
from tests.recipe_apps import app_by_recipe, application


@pytest.fixture
def empty(data: Path, tmp_path: Path) -> EvaluationRun:
    """Three materials of which nothing was measured yet."""
    return evaluation_run_of(data, tmp_path / "runs")


def spec_of(title: str) -> Spec:
    return spec_with(conditions={"title": title})


@pytest.fixture
def measure(empty: EvaluationRun, tmp_path: Path) -> Callable:
    """Records of the materials under a title; `during` is called for each."""

    def measured(title: str, during: Callable[[str], object] = len, steps: int = 0) -> list[Fit]:
        def of_tasks(tasks: list[Task]) -> Iterator[Fit]:
            for task in tasks:
                during(task.name)
                yield fit_of(task.name, task.name, 1.0, seconds=None)

        return empty.measure(title, tmp_path / title, spec_of(title), of_tasks, empty.tasks, steps)

    return measured


def test_missing_records_are_measured_once(measure: Callable, empty: EvaluationRun, tmp_path: Path) -> None:
    log: list[str] = []
    write_fit(tmp_path / "some", fit_of("m1", "m1", 0.5, spec_of("some")))
    for _ in range(2):
        fits = measure("some", log.append)
        assert [(fit.name, fit.error) for fit in fits] == [("m0", 1.0), ("m1", 0.5), ("m2", 1.0)]
        assert log == ["m0", "m2"]
    assert all(fits[i].content for i in (0, 2))
    empty.is_measuring = False
    assert measure("others", log.append) == []
    assert {title: len(fits) for title, (_, fits) in empty.requested.items()} == {"some": 3, "others": 0}
    assert len(log) == 2


def test_an_interrupted_measurement_goes_on_at_the_first_missing_task(measure: Callable, empty: EvaluationRun) -> None:
    def stop(name: str) -> None:
        if name == "m1":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        measure("some", stop)
    log: list[str] = []
    empty.requested.clear()  # as of another process
    assert len(measure("some", log.append)) == 3
    assert log == ["m1", "m2"]


def test_fits_of_few_steps_come_first(empty: EvaluationRun) -> None:
    assert empty.existing_fits("general") == []
    rows = result_rows(empty, ("overfit", "finetune", "general", "quickft"))
    assert [row["paradigm"] for row in rows] == ["overfit", "finetune", "general", "quickft"]
    assert list(empty.requested) == ["general", "finetune", "quickft", "overfit"]
    assert [fit.name for fit in empty.existing_fits("general")] == ["m0", "m1", "m2"]


class Heard(Reporter, Bar):
    """Keeps the lines that are said, and what its one bar shows."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.shown: list[tuple[int, int | None, str]] = []

    def say(self, message: str) -> None:
        self.lines.append(message)

    def bar(self, *_: object) -> contextlib.AbstractContextManager[Bar]:
        return contextlib.nullcontext(self)

    def set_done(self, done: int, total: int | None, note: str = "") -> None:
        self.shown.append((done, total, note))


def test_the_progress_counts_gradient_steps(measure: Callable, empty: EvaluationRun) -> None:
    empty.options = replace(empty.options, quiet=False)
    with use_reporter(heard := Heard()):
        measure("long", steps=99)
    assert heard.shown == [
        (0, 300, "brdf long"),
        (100, 300, "brdf long m0"),
        (200, 300, "brdf long m1"),
        (300, 300, "brdf long m2"),
    ]


def test_rows_are_printed_as_soon_as_they_are_measured(measure: Callable, empty: EvaluationRun) -> None:
    with use_reporter(heard := Heard()):
        measure("quiet")
        assert heard.lines == []
        empty.options = replace(empty.options, quiet=False)
        for _ in range(2):  # the second time it is there
            measure("some")
    assert heard.lines == ["brdf some: mean error 1.000, 3 tasks"]


def test_fits_have_the_threads_of_their_application(measure: Callable, empty: EvaluationRun) -> None:
    class Threaded(Brdf):
        small_tensors = False

    counts: list[int] = []
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        for single, kind in ((True, Brdf), (False, Threaded)):
            empty.app = kind(**vars(empty.app))
            measure(f"{single}", lambda _: counts.append(torch.get_num_threads()))
        find_device("cpu", app_by_recipe("illumination"))  # looking for a device changes nothing
        assert [*counts[::3], torch.get_num_threads()] == [1, 2, 2]
    finally:
        torch.set_num_threads(before)
    assert (app_by_recipe("illumination").small_tensors, app_by_recipe("texture").small_tensors) == (True, False)


def test_an_application_without_its_weights_is_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("METAPP_CACHE", str(tmp_path))
    two = {name: application(name) for name in ("texture", "transport")}
    monkeypatch.setattr("metapp.cli.evaluation_output.registry", lambda: SimpleNamespace(applications=two))
    monkeypatch.setattr("metapp.evaluation.evaluation_run.make_embedded_test_set", lambda *_: tmp_path)
    monkeypatch.setattr("metapp.evaluation.evaluation_run.find_in_data_set", lambda *_: [])  # drawn in minutes
    monkeypatch.setattr("metapp.evaluation.evaluation_run.data_label", lambda *_: "none")
    with use_reporter(heard := Heard()):
        assert [one.app.name for one in evaluation_runs_of(EvaluateOptions(out=tmp_path), [])] == ["transport"]
    (line,) = heard.lines
    assert line.startswith("Texture is left out: ")
    assert "metapp data vgg" in line
    with pytest.raises(ValueError, match="metapp data vgg"):
        evaluation_runs_of(EvaluateOptions(out=tmp_path), ["texture"])
