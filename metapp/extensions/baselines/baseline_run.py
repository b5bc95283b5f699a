"""The run of a method without a network on inputs of a command; predictions are kept in a run's folder, as fits are.

What a method computes is not known here; :mod:`metapp.extensions.baselines.baseline_fits` fits and judges it.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rich.table import Table

from metapp.appearance.presenter import Presenter
from metapp.cli.fit_output import fit_line, fits_table
from metapp.entries import did_you_mean
from metapp.extensions.baselines import baselines_of
from metapp.extensions.baselines.baseline import Baseline
from metapp.extensions.baselines.baseline_fits import (
    BASELINE_FIGURES,
    baseline_settings,
    find_training_folder,
    fit_baselines,
)
from metapp.options import BadOption
from metapp.runs.choice import Choice, find_and_choose
from metapp.runs.fit_options import FitOptions
from metapp.runs.inputs.run_inputs import find_inputs, read_tasks, task_digest
from metapp.runs.outputs.fit_files import write_pictures
from metapp.runs.reporter import progress
from metapp.storage.fit_records import FitRecord
from metapp.storage.fit_store import FitStore


class BaselineRun(NamedTuple):
    """The predictions of a method to the inputs of a command.

    Attributes:
        method: the name of the method.
        cannot: what the method cannot do, as words that follow "cannot".
        presenter: the presenter of the application.
        path: the folder of the predictions.
        records: the records of all tasks, in their order.
    """

    method: str
    cannot: str
    presenter: Presenter[Any]
    path: Path
    records: Sequence[FitRecord]

    def describe(self) -> Table | str:
        """Return a table of the fits, or one line if there is a single task."""
        if len(self.records) > 1:
            return fits_table(self.presenter, self.method, self.records)
        return fit_line(self.presenter, self.records[0])


def run_baseline(options: FitOptions, method: str) -> BaselineRun:
    """Run a method on the inputs of options, and keep its predictions, with their records, in a run's folder.

    Args:
        options: the options of a fit; those that no method reads have no effect.
        method: the name of the method.

    Raises:
        BadOption: the application has no such method, or the method writes files of one size alone.
        ValueError: inputs are bad, or a method that learns from training tasks has none.
    """
    choice = find_and_choose(options)
    baseline, (inputs, label) = _find_baseline(choice, method), find_inputs(choice)
    tasks = read_tasks(inputs)
    if baseline.learns and find_training_folder(choice, baseline, make=True) is None:
        raise ValueError(f"{choice.app.name} {method}: no training tasks to learn from; give a data set with --data.")
    path = choice.folder(label, f"baseline-{method}")
    store = FitStore(path, baseline_settings(choice, baseline, label), BASELINE_FIGURES)
    records = []
    with progress(method, len(tasks), quiet=options.quiet) as bar:
        fits = fit_baselines(choice, baseline, tasks, warm=False)
        for task, (record, picture, prediction_at_size) in zip(tasks, fits, strict=True):
            record.content, record.origin = task_digest(task), choice.origin(choice.options.paths)
            files = choice.presenter.prediction_pictures(prediction_at_size(choice.presenter.size), task)
            records.append(store.write(record, picture, functools.partial(write_pictures, files)))
            bar.advance(task.name)
    return BaselineRun(method, baseline.cannot, choice.presenter, path, records)


def _find_baseline(choice: Choice, method: str) -> Baseline:
    """Return the baseline of an application by its name.

    Raises:
        BadOption: the application has no such method, or the method writes files of one size alone.
    """
    methods = {baseline.name: baseline for baseline in baselines_of(choice.application, choice.app)}
    if method not in methods:
        names = ", ".join(methods) or f"another application: {choice.app.name} has no method"
        hint = did_you_mean(method, methods)
        raise BadOption(f"--method {method}: not one of {choice.app.name}, expected {names}.{hint}")
    if choice.presenter.size and not methods[method].is_resizable:
        resizable_names = ", ".join(name for name, candidate in methods.items() if candidate.is_resizable) or "none"
        raise BadOption(
            f"--size: {method} writes files of one size, expected a method that makes others: {resizable_names}."
        )
    return methods[method]
