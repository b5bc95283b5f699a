"""One method of the baselines table on a user's own files."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from metapp.apps import presentation_of
from metapp.extensions.baselines import baselines_of
from metapp.extensions.baselines.baseline import DrawsAnswers
from metapp.extensions.baselines.fits import ENTRIES, fit_baselines, settings_of, training_folder, training_of
from metapp.runs import BadOption
from metapp.runs.inputs.sources import tasks_to_fit
from metapp.runs.outputs.files import OUTPUTS, write_pictures
from metapp.runs.reporter import progress
from metapp.runs.requests.options import name_parts
from metapp.runs.requests.plan import Plan
from metapp.storage import Document
from metapp.storage.records import Record, RunFolder, file_name
from metapp.storage.text import meant


class BaselineRun(NamedTuple):
    """The results of a method on files.

    Attributes:
        method: its name.
        cannot: what it cannot do that a network can.
        folder: of the records.
        records: one a task.
        made: the folder of pictures and maps; None where the application has none.
    """

    method: str
    cannot: str
    folder: Path
    records: list[Record]
    made: Path | None

    def document(self) -> Document:
        """As one JSON object."""
        return {"method": self.method, "out": str(self.folder), "cannot": self.cannot, "tasks": self.records}


def run_baseline(plan: Plan, method: str) -> BaselineRun:
    """Fit what a plan's request names, or its data set's test tasks, by one of the application's baselines.

    Raises:
        BadOption: the application has no such baseline.
        ValueError: an input cannot be read or fitted, or there are no training tasks for a method that learns.
    """
    app, request = plan.app, plan.request
    methods = {baseline.name: baseline for baseline in baselines_of(app)}
    if method not in methods:
        names = ", ".join(methods)
        raise BadOption(f"--method {method}: not one of {app.name}, expected {names}.{meant(method, methods)}")
    baseline, (tasks, label) = methods[method], tasks_to_fit(plan)
    source = training_folder(plan) if baseline.learns else None
    if baseline.learns and source is None:
        raise ValueError(f"{app.name} {method}: no training tasks to learn from; give a data set with --data.")
    ways = name_parts(app.name, plan.options)
    words = [label, request.recipe, f"seed{request.seed}", *ways, method, app.protocol]
    path = request.out / app.name / "baseline" / "-".join(filter(None, words))
    folder = RunFolder(path, settings_of(plan, baseline, source, label), ENTRIES, plan.origin())
    records, presentation = [], presentation_of(app)
    with progress(method, len(tasks), quiet=request.quiet) as bar:
        fits = fit_baselines(plan, baseline, training_of(app, source), tasks, warm=False)
        for task, fitted in zip(tasks, fits, strict=True):
            folder.add(fitted.record, fitted.kept)
            if isinstance(presentation, DrawsAnswers):
                files = presentation.files_of(fitted.answer, task)
                write_pictures(files, folder.path / OUTPUTS / file_name(task.name))
            records.append(fitted.record)
            bar.advance(task.name)
    made = folder.path / OUTPUTS if isinstance(presentation, DrawsAnswers) else None
    return BaselineRun(method, baseline.cannot, folder.path, records, made)
