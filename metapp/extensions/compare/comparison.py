"""Runs of an application side by side: errors and seconds task by task, compared with the first run, one picture."""

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
from metapp.runs.outputs.contact_sheet import Tiles, tiles_of_methods, write_comparison_sheet
from metapp.runs.outputs.run_records import find_fitted_tasks, read_run_records
from metapp.runs.reporter import progress
from metapp.runs.run import Run
from metapp.storage import Document
from metapp.storage.fit_folders import PARAMS, summary

MAX_COMPARED_PICTURES = 20  # tasks whose pictures are compared
SPHERE_PICTURE_APPS = ("brdf",)  # applications whose pictures are spheres: colours of the same places
# settings that tell runs apart, the clearest first
NOTED_SETTINGS = ("device", "versions", "features", "precision", "observe")
LABEL_KEYS = ("paradigm", "rule", "recipe", "steps", "observe", "seed", "checkpoint")


class ComparedRun(NamedTuple):
    """A run that is compared.

    Attributes:
        label: a word that tells it from the others.
        presenter: of the application, as it was at the first fit.
        folder: of the run.
        records: of the tasks in common, in the same order.
    """

    label: str
    presenter: Presenter[Any]
    folder: Path
    records: list[Document]

    def errors(self, measure: str = "error") -> dict[str, float]:
        """By the task's name, of those that have one; also further ones that records state."""
        return {record["name"]: record[measure] for record in self.records if record.get(measure) is not None}

    def seconds(self) -> float | None:
        """The median of a fit; None of answers that were made elsewhere."""
        return summary(self.records)["seconds"]


class MeanComparison(NamedTuple):
    """The mean of an error of a run, None if it has none, and its comparison with the base, which has none itself."""

    mean: float | None
    compared: PairedComparison | None

    def document(self) -> Document:
        """It as --json prints it."""
        return {"mean": self.mean, "compared": self.compared and self.compared._asdict()}


class Comparison(NamedTuple):
    """Runs on the tasks that they have in common.

    Attributes:
        sides: two or more; the first is the base.
        tasks: of the fits, in the order of the records; none if they cannot be read.
        errors: of each side; compared by the ratio to the base's, or by the difference from it.
        measures: further errors of each side that all have, by their titles.
        notes: important differences beside the runs' settings.
    """

    sides: list[ComparedRun]
    tasks: list[Task]
    errors: list[MeanComparison]
    measures: dict[str, list[MeanComparison]]
    notes: list[str]

    def document(self, picture: Path | None) -> Document:
        """The document that --json prints."""
        return {
            "app": self.sides[0].presenter.app.name,
            "runs": [
                {
                    **{"label": side.label, "out": str(side.folder), "error": error.mean, "seconds": side.seconds()},
                    "compared": error.document()["compared"],
                    "measures": {title: some[i].document() for title, some in self.measures.items()},
                }
                for i, (side, error) in enumerate(zip(self.sides, self.errors, strict=True))
            ],
            "tasks": [
                {"name": of[0]["name"], **{key: [one.get(key) for one in of] for key in ("error", "seconds")}}
                for of in zip(*(side.records for side in self.sides), strict=True)
            ],
            "notes": self.notes,
            "picture": picture and str(picture),
        }


def read_comparison(paths: Sequence[Path], task: str, inputs: list[Path], data: Path | None) -> Comparison:
    """Put runs side by side.

    Args:
        paths: folders of two or more runs, or of one of their tasks; the first is the base.
        task: the one to compare; "" for all in common.
        inputs: the fitted files, if they are not in the places of records.
        data: the data set that was fitted, for the same.

    Raises:
        ValueError: no runs, of different applications, or without a task in common.
    """
    found = [read_run_records(path, task, by_paradigm=False) for path in paths]
    settings = [each.records[-1]["settings"] for each in found]
    by_name = [{record["name"]: record for record in each.records} for each in found]
    names = list(by_name[0])
    for path, each, of in zip(paths[1:], settings[1:], by_name[1:], strict=True):
        if each["app"] != settings[0]["app"]:
            apps = f"{settings[0]['app']} and {each['app']}"
            raise ValueError(f"{path}: runs of {apps}, expected runs of one application; take another run.")
        before, names = len(names), [name for name in names if name in of]
        if not names:
            counts = f"{before} and {len(of)} tasks, none in common"
            raise ValueError(f"{path}: {counts}, expected some; compare runs of the same data.")
    sides = [
        ComparedRun(label, Run.from_settings(each).presenter, place.folder, [of[name] for name in names])
        for label, each, place, of in zip(_labels(settings), settings, found, by_name, strict=True)
    ]
    app = sides[0].presenter.app
    tasks_by_name = find_fitted_tasks(found[0].records, app, inputs, data)
    tasks = [tasks_by_name[name] for name in names if name in tasks_by_name]
    groups = {name: (tasks_by_name[name].group if name in tasks_by_name else "") or name for name in names}
    errors = _measured([side.errors() for side in sides], groups, logarithmic=app.error_measure.logarithmic)
    of_measures = {title: [side.errors(key) for side in sides] for key, title in app.error_measure.further.items()}
    measures = {title: _measured(some, groups) for title, some in of_measures.items() if all(some)}
    return Comparison(sides, tasks, errors, measures, _notes(settings, by_name, names))


def _measured(
    errors: Sequence[Mapping[str, float]], groups: Mapping[str, str], *, logarithmic: bool = False
) -> list[MeanComparison]:
    """Means of runs' errors of tasks, and each compared with the first."""
    return [
        MeanComparison(
            statistics.fmean(own.values()) if own else None,
            compare_errors(own, errors[0], groups, logarithmic=logarithmic) if i else None,
        )
        for i, own in enumerate(errors)
    ]


def draw_comparison(compared: Comparison, file: Path, *, quiet: bool) -> tuple[Path | None, Comparison]:
    """Write a picture of tasks, the reference beside the fits of all runs, and measure COMPARED spheres.

    Returns:
        The file; None if tasks cannot be read, or a run is of a method that keeps no picture. And the
        comparison, of spheres with the colour differences of the pictures.
    """
    kept = (Path(record["folder"], PARAMS) for side in compared.sides for record in side.records)
    if not compared.tasks or not all(path.is_file() for path in kept):
        return None, compared
    records = [{record["name"]: record for record in side.records} for side in compared.sides]
    drawn, presenter = compared.tasks[:MAX_COMPARED_PICTURES], compared.sides[0].presenter
    columns = []
    with progress("picture", len(drawn), quiet=quiet) as bar, torch_defaults(single=presenter.app.single_threaded):
        for task in drawn:
            pairs = zip(compared.sides, records, strict=True)
            columns.append(tiles_of_methods(task, [(side.label, side.presenter, of[task.name]) for side, of in pairs]))
            bar.advance(task.name)
    judged = [column for column in columns if "reference" in column.pictures]
    if presenter.app.name in SPHERE_PICTURE_APPS and judged:
        compared = compared._replace(measures=compared.measures | _colour_differences(judged, compared))
    return write_comparison_sheet(presenter, columns, file), compared


def _colour_differences(columns: list[Tiles], compared: Comparison) -> dict[str, list[MeanComparison]]:
    """Of the fits' spheres from the reference's, by their titles: median and 95th percentile of a sphere's pixels."""
    shares = ("median", "95 %")
    found: list[list[dict[str, float]]] = [[{} for _ in compared.sides] for _ in shares]
    for column in columns:
        reference, *fits = column.pictures.values()
        touched = np.min([reference, *fits], 0).min(-1) < 1  # the background is white
        for side, fit in enumerate(fits):
            values = np.quantile(colour_difference(fit[touched], reference[touched]), (0.5, 0.95))
            for measure, value in zip(found, values.tolist(), strict=True):
                measure[side][column.name] = value
    groups = {task.name: task.group or task.name for task in compared.tasks}
    return {
        f"CIE 2000 colour difference of {len(columns)} spheres drawn, {share} of pixels": _measured(measure, groups)
        for share, measure in zip(shares, found, strict=True)
    }


def _labels(settings: Sequence[Document]) -> list[str]:
    """Labels that tell runs apart, of as few settings as that takes; A, B and so on if nothing in LABEL_KEYS does."""
    words: list[tuple[str, ...]] = [() for _ in settings]
    for key in LABEL_KEYS:
        kind = "" if key in ("paradigm", "rule", "recipe") else f"{key}-"
        values = [f"{kind}{each.get(key, each.get('method') if key == 'paradigm' else None)}" for each in settings]
        more = [(*some, value) for some, value in zip(words, values, strict=True)]
        words = more if len({*more}) > len({*words}) else words
    if len({*words}) < len(words):
        words = [(chr(ord("A") + i), *some) for i, some in enumerate(words)]
    return ["-".join(some) for some in words]


def _notes(settings: list[Document], by_name: list[Document], names: list[str]) -> list[str]:
    """Notes on differences beside the labels."""
    left_out = sum(map(len, by_name)) - len(by_name) * len(names)
    differ = sum(len({of[name].get("content") for of in by_name}) > 1 for name in names)
    values = {
        key: [one.get(key) for one in settings]
        for key in sorted({*NOTED_SETTINGS} & {key for one in settings for key in one})
    }
    return [
        *([f"{left_out} tasks that not all runs have are left out"] if left_out else []),
        *([f"{differ} tasks in common have other content in other runs, and the same name"] if differ else []),
        *(f"{key}: {', '.join(map(str, of))}" for key, of in values.items() if any(value != of[0] for value in of)),
    ]
