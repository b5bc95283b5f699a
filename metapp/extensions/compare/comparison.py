"""Runs of an application side by side: errors and seconds task by task, compared with the first run, and a picture.

Records and fits of runs are read; nothing is fitted here, and nothing printed.
"""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from metapp.appearance.colorimetry import colour_difference
from metapp.appearance.presenter import Presenter
from metapp.evaluation.error_statistics import PairedComparison, compare_errors
from metapp.learning.task import Task
from metapp.runs.environment import torch_defaults
from metapp.runs.fit import Fit, find_tasks
from metapp.runs.fit_pictures import tiles_of_methods, write_comparison_sheet
from metapp.runs.fit_tables import summarise
from metapp.runs.outputs.contact_sheet import Tiles
from metapp.runs.reporter import progress
from metapp.runs.spec import Spec
from metapp.runs.stored_fits import read_run
from metapp.storage import Document
from metapp.storage.fit_folders import PARAMS

MAX_COMPARED_PICTURES = 20  # tasks that the picture shows
SPHERE_PICTURE_APPS = ("brdf",)  # applications whose pictures are spheres, which show all fits at equal places
# settings that notes name where runs differ in them
NOTED_SETTINGS = ("device", "versions", "features", "precision", "observe")
# settings that tell runs apart, the clearest first
LABEL_KEYS = ("paradigm", "rule", "recipe", "steps", "observe", "seed", "checkpoint")


class ComparedRun(NamedTuple):
    """A run that is compared.

    Attributes:
        label: a word that tells the run from the others.
        folder: the folder of the run.
        fits: the fits of the tasks in common, in one order for all runs.
    """

    label: str
    folder: Path
    fits: list[Fit]

    @property
    def presenter(self) -> Presenter[Any]:
        """The presenter of the application."""
        return self.fits[-1].presenter

    def errors_by_task(self, measure: str = "error") -> dict[str, float]:
        """Return an error, or a further measure, by the names of the tasks that have it."""
        values = {fit.name: fit.error if measure == "error" else fit.further_errors.get(measure) for fit in self.fits}
        return {name: value for name, value in values.items() if value is not None}

    def median_seconds(self) -> float | None:
        """Return the median time of a fit, in seconds; None for predictions that were made elsewhere."""
        return summarise(self.fits)["seconds"]


class MeanComparison(NamedTuple):
    """The mean error of a run, and how its errors compare with the errors of the first run.

    Attributes:
        mean: the mean over tasks; None if no task has the error.
        comparison: the comparison with the first run; None for the first run itself, or if nothing can be compared.
    """

    mean: float | None
    comparison: PairedComparison | None

    def document(self) -> Document:
        """Return the mean and its comparison as --json prints them."""
        return {"mean": self.mean, "compared": self.comparison and self.comparison._asdict()}


class Comparison(NamedTuple):
    """Runs on the tasks that they have in common.

    Attributes:
        runs: two or more runs, of which the others are compared with the first.
        tasks: the tasks of the fits, in the order of the fits; none if they cannot be read.
        errors: the error of each run, compared with the first by ratio or by difference.
        measures: by title, each further error of all runs that all of them have.
        notes: important differences between the runs' settings.
    """

    runs: list[ComparedRun]
    tasks: list[Task]
    errors: list[MeanComparison]
    measures: dict[str, list[MeanComparison]]
    notes: list[str]

    def document(self, picture: Path | None) -> Document:
        """Return the document that --json prints."""
        return {
            "app": self.runs[0].presenter.app.name,
            "runs": [
                {
                    **{
                        "label": run.label,
                        "out": str(run.folder),
                        "error": error.mean,
                        "seconds": run.median_seconds(),
                    },
                    "compared": error.document()["compared"],
                    "measures": {title: run_means[i].document() for title, run_means in self.measures.items()},
                }
                for i, (run, error) in enumerate(zip(self.runs, self.errors, strict=True))
            ],
            "tasks": [
                {
                    "name": task_fits[0].name,
                    "error": [fit.error for fit in task_fits],
                    "seconds": [fit.seconds for fit in task_fits],
                }
                for task_fits in zip(*(run.fits for run in self.runs), strict=True)
            ],
            "notes": self.notes,
            "picture": picture and str(picture),
        }


def read_comparison(paths: Sequence[Path], task: str, inputs: list[Path], data: Path | None) -> Comparison:
    """Read runs and compare them with the first.

    Args:
        paths: the folders of two or more runs, or of one of their tasks; the first run is the base of comparisons.
        task: the name of the task to compare; "" for all tasks in common.
        inputs: the fitted files, if they are no longer where records say.
        data: the data set that was fitted, if it is no longer where records say.

    Raises:
        ValueError: there are no runs, they are of different applications, or have no task in common.
    """
    stored_runs = [read_run(path, task, by_paradigm=False) for path in paths]
    specs = [run.fits[-1].spec for run in stored_runs]
    by_name = [{fit.name: fit for fit in run.fits} for run in stored_runs]
    names = list(by_name[0])
    for path, spec, fits_by_name in zip(paths[1:], specs[1:], by_name[1:], strict=True):
        if spec.app != specs[0].app:
            raise ValueError(
                f"{path}: runs of {specs[0].app} and {spec.app}, expected runs of one application; take another run."
            )
        previous_count, names = len(names), [name for name in names if name in fits_by_name]
        if not names:
            counts = f"{previous_count} and {len(fits_by_name)} tasks, none in common"
            raise ValueError(f"{path}: {counts}, expected some; compare runs of the same data.")
    entries = [_entries_of(spec) for spec in specs]
    runs = [
        ComparedRun(label, run.folder, [fits_by_name[name] for name in names])
        for label, run, fits_by_name in zip(_make_labels(entries), stored_runs, by_name, strict=True)
    ]
    app = runs[0].presenter.app
    tasks_by_name = find_tasks(stored_runs[0].fits, inputs, data)
    tasks = [tasks_by_name[name] for name in names if name in tasks_by_name]
    groups = {name: (tasks_by_name[name].group if name in tasks_by_name else "") or name for name in names}
    errors = _compare_means([run.errors_by_task() for run in runs], groups, logarithmic=app.error_measure.logarithmic)
    measure_errors = {
        title: [run.errors_by_task(key) for run in runs] for key, title in app.error_measure.further.items()
    }
    measures = {
        title: _compare_means(run_errors, groups) for title, run_errors in measure_errors.items() if all(run_errors)
    }
    return Comparison(runs, tasks, errors, measures, _describe_differences(entries, by_name, names))


def _compare_means(
    errors: Sequence[Mapping[str, float]], groups: Mapping[str, str], *, logarithmic: bool = False
) -> list[MeanComparison]:
    """Return the mean error of each run, compared with the first run's errors task by task.

    Args:
        errors: for each run its errors, by the names of tasks.
        groups: for the name of each task its group, since tasks of one group are not independent.
        logarithmic: whether errors are logarithms, which are compared by their difference instead of their ratio.
    """
    return [
        MeanComparison(
            statistics.fmean(run_errors.values()) if run_errors else None,
            compare_errors(run_errors, errors[0], groups, logarithmic=logarithmic) if i else None,
        )
        for i, run_errors in enumerate(errors)
    ]


def draw_comparison(comparison: Comparison, file: Path, *, quiet: bool) -> tuple[Path | None, Comparison]:
    """Draw tasks, the reference beside the fits of all runs, and compare the colours of spheres that were drawn.

    Returns:
        The file; None if tasks cannot be read, or a run is of a method that keeps no picture. And the comparison, for
        spheres with the colour differences of the pictures.
    """
    fit_files = (fit.folder / PARAMS for run in comparison.runs for fit in run.fits)
    if not comparison.tasks or not all(path.is_file() for path in fit_files):
        return None, comparison
    fits = [{fit.name: fit for fit in run.fits} for run in comparison.runs]
    tasks, presenter = comparison.tasks[:MAX_COMPARED_PICTURES], comparison.runs[0].presenter
    columns = []
    with progress("picture", len(tasks), quiet=quiet) as bar, torch_defaults(single=presenter.app.small_tensors):
        for task in tasks:
            pairs = zip(comparison.runs, fits, strict=True)
            labelled = [(run.label, fits_by_name[task.name]) for run, fits_by_name in pairs]
            columns.append(tiles_of_methods(task, labelled))
            bar.advance(task.name)
    columns_with_reference = [column for column in columns if "reference" in column.pictures]
    if presenter.app.name in SPHERE_PICTURE_APPS and columns_with_reference:
        comparison = comparison._replace(
            measures=comparison.measures | _compare_colours(columns_with_reference, comparison)
        )
    return write_comparison_sheet(presenter, columns, file), comparison


def _compare_colours(columns: list[Tiles], comparison: Comparison) -> dict[str, list[MeanComparison]]:
    """Compare the colours of the fits' spheres with the reference's: median and 95th percentile over a sphere's pixels.

    Args:
        columns: the pictures of each task, the reference first.
        comparison: the comparison of the runs.

    Returns:
        For a title of each of the two measures, the comparison of its means.
    """
    statistic_names = ("median", "95 %")
    differences: list[list[dict[str, float]]] = [[{} for _ in comparison.runs] for _ in statistic_names]
    for column in columns:
        reference, *fits = column.pictures.values()
        is_sphere = np.min([reference, *fits], 0).min(-1) < 1  # the background is white
        for run_index, fit in enumerate(fits):
            values = np.quantile(colour_difference(fit[is_sphere], reference[is_sphere]), (0.5, 0.95))
            for measure, value in zip(differences, values.tolist(), strict=True):
                measure[run_index][column.name] = value
    groups = {task.name: task.group or task.name for task in comparison.tasks}
    return {
        f"CIE 2000 colour difference of {len(columns)} spheres drawn, {share} of pixels": _compare_means(
            measure, groups
        )
        for share, measure in zip(statistic_names, differences, strict=True)
    }


def _entries_of(spec: Spec) -> Document:
    """Return the entries of a specification by which runs can differ, conditions beside the others."""
    document = spec.document()
    entries: Document = document | document.get("conditions", {})
    return entries | {"checkpoint": entries.get("digest"), "paradigm": spec.paradigm or entries.get("method")}


def _make_labels(entries: Sequence[Document]) -> list[str]:
    """Return labels that tell runs apart, made of few entries, after A, B, ... where entries do not suffice."""
    words: list[tuple[str, ...]] = [() for _ in entries]
    for key in LABEL_KEYS:
        prefix = "" if key in ("paradigm", "rule", "recipe") else f"{key}-"
        values = [f"{prefix}{run_entries.get(key)}" for run_entries in entries]
        longer_words = [(*run_words, value) for run_words, value in zip(words, values, strict=True)]
        words = longer_words if len({*longer_words}) > len({*words}) else words
    if len({*words}) < len(words):
        words = [(chr(ord("A") + i), *run_words) for i, run_words in enumerate(words)]
    return ["-".join(run_words) for run_words in words]


def _describe_differences(
    entries: Sequence[Document], by_name: Sequence[Mapping[str, Fit]], names: list[str]
) -> list[str]:
    """Return notes on differences between runs that labels do not show."""
    left_out_count = sum(map(len, by_name)) - len(by_name) * len(names)
    changed_count = sum(len({fits[name].content for fits in by_name}) > 1 for name in names)
    values = {
        key: [run_entries.get(key) for run_entries in entries]
        for key in sorted({*NOTED_SETTINGS} & {key for run_entries in entries for key in run_entries})
    }
    return [
        *([f"{left_out_count} tasks that not all runs have are left out"] if left_out_count else []),
        *(
            [f"{changed_count} tasks in common have other content in other runs, and the same name"]
            if changed_count
            else []
        ),
        *(
            f"{key}: {', '.join(map(str, run_values))}"
            for key, run_values in values.items()
            if any(value != run_values[0] for value in run_values)
        ),
    ]
