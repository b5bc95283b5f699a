"""The run of a method without a network on inputs of a command; predictions are kept in a run's folder, as fits are.

What a method computes is not known here; :mod:`metapp.extensions.baselines.baseline_fits` fits and judges it.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from rich.table import Table

from metapp.appearance.assets import Asset
from metapp.cli.fit_output import describe_exports, fit_line, fits_table
from metapp.entries import did_you_mean
from metapp.extensions.baselines import baselines_of
from metapp.extensions.baselines.baseline import Baseline
from metapp.extensions.baselines.baseline_fits import find_training_folder, fit_baselines
from metapp.learning.task import Task
from metapp.options import BadOption
from metapp.runs.data_sets.embedded import embedded_folders
from metapp.runs.fit import Fit
from metapp.runs.inputs.finding import DATA_SET_FORMAT, Input, content_of, data_label, find
from metapp.runs.outputs.fit_files import export_path, write_pictures
from metapp.runs.reporter import progress, say
from metapp.runs.resolve import app_of, presenter_of, resolve
from metapp.runs.spec import RunOptions, Spec, given_words


class BaselineRun(NamedTuple):
    """The predictions of a method to the inputs of a command.

    Attributes:
        method: the name of the method.
        cannot: what the method cannot do, as words that follow "cannot".
        path: the folder of the predictions.
        fits: the predictions of all inputs, in their order.
        export_lines: a line for each exported file.
    """

    method: str
    cannot: str
    path: Path
    fits: Sequence[Fit]
    export_lines: Sequence[str]

    def describe(self) -> Table | str:
        """Return a table of the fits, or one line if there is a single task."""
        return fits_table(self.fits) if len(self.fits) > 1 else fit_line(self.fits[0])


def run_baseline(spec: Spec, options: RunOptions, paths: Sequence[Path], method: str) -> BaselineRun:
    """Run a method on the inputs of a command, and keep its predictions in a run's folder.

    Args:
        spec: the specification of a fit; what no method reads has no effect.
        options: the options of the command.
        paths: the inputs; none for the test tasks of a data set.
        method: the name of the method.

    Raises:
        BadOption: the application has no such method, or the method writes files of one size alone.
        ValueError: inputs are bad, or a method that learns from training tasks has none.
    """
    inputs = find(spec, paths, options.data, quiet=options.quiet)
    specs, reasons = resolve(spec, inputs, trained=False)
    for line in () if options.quiet else reasons:
        say(line)
    folders = [Path(one.path) for one in inputs if one.format == DATA_SET_FORMAT]
    is_embedded_set = bool(folders) and inputs[0].data in map(data_label, embedded_folders(spec.application))
    data = options.data or (folders[0] if folders and not is_embedded_set else None)
    label = inputs[0].data if data and folders else ""
    path = options.out / spec.app / given_words(replace(spec, paradigm=f"baseline-{method}"), label)
    tasks = _read_tasks(inputs, specs)
    fits: dict[int, Fit] = {}
    with progress(method, len(tasks), quiet=options.quiet) as bar:
        for group_spec in {id(specs[number]): specs[number] for number in tasks}.values():
            baseline = _find_baseline(group_spec, method)
            training_folder = find_training_folder(group_spec, baseline, data, make=is_embedded_set)
            if baseline.learns and training_folder is None:
                raise ValueError(f"{spec.app} {method}: no training tasks to learn from; give a data set with --data.")
            group = [number for number in tasks if specs[number] is group_spec]
            answers = fit_baselines(group_spec, baseline, [tasks[number] for number in group], training_folder)
            size = presenter_of(group_spec, app_of(group_spec)).size
            for number, (fit, answer) in zip(group, answers, strict=True):
                one, task = inputs[number], tasks[number]
                fit.name, fit.source, fit.format, fit.inputs = one.name, one.place, one.format, list(one.given)
                fit.content, fit.task = content_of(task), task
                _keep(fit, answer.asset(task, size) if answer.asset else None, path, options.exports)
                fits[number] = fit
                bar.advance(one.name)
    ordered = [fits[number] for number in sorted(fits)]
    return BaselineRun(method, baseline.cannot, path, ordered, [*describe_exports(ordered, options.exports)])


def _keep(fit: Fit, asset: Asset | None, run_folder: Path, exports: Sequence[str]) -> None:
    """Write the answer of a method into the folder of a run: its pictures and its exports.

    Raises:
        ValueError: the answer cannot be written in one of the formats.
    """
    if asset is not None:
        fit.asset = asset
    fit.keep(run_folder, draw=functools.partial(write_pictures, {} if asset is None else asset.pictures()))
    for form in exports:
        fit.write_export(form, export_path(fit.folder, form))
    fit.forget()


def _read_tasks(inputs: Sequence[Input], specs: Sequence[Spec]) -> dict[int, Task]:
    """Read the tasks of inputs, by the number of the input; a damaged file that was found in a folder is left out.

    Raises:
        ValueError: a named input is damaged, or no input can be read.
    """
    tasks = {}
    for number, (one, spec) in enumerate(zip(inputs, specs, strict=True)):
        try:
            tasks[number] = one.read_task(spec, app_of(spec))
        except ValueError as error:
            if one.is_named:
                raise
            say(f"warning: skipped {error}")
    if not tasks:
        raise ValueError(
            f"{len(inputs)} inputs were found, none can be read, expected one or more; see the warnings above."
        )
    return tasks


def _find_baseline(spec: Spec, method: str) -> Baseline:
    """Return the baseline of an application by its name.

    Raises:
        BadOption: the application has no such method, or the method writes files of one size alone.
    """
    app = app_of(spec)
    methods = {baseline.name: baseline for baseline in baselines_of(spec.application, app)}
    if method not in methods:
        names = ", ".join(methods) or f"another application: {spec.app} has no method"
        raise BadOption(f"--method {method}: not one of {spec.app}, expected {names}.{did_you_mean(method, methods)}")
    if presenter_of(spec, app).size and not methods[method].is_resizable:
        resizable_names = ", ".join(name for name, candidate in methods.items() if candidate.is_resizable) or "none"
        raise BadOption(
            f"--size: {method} writes files of one size, expected a method that makes others: {resizable_names}."
        )
    return methods[method]
