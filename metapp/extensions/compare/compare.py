"""Two runs of an application side by side: errors and seconds task by task, their paired ratio, one picture."""

from __future__ import annotations

import statistics
from pathlib import Path
from typing import NamedTuple

import numpy as np

from metapp.appearance.colorimetry import colour_difference
from metapp.evaluation.statistics import Paired, paired
from metapp.learning.app import App
from metapp.learning.task import Task
from metapp.runs.outputs.pictures import COMPARED, Column, column_of, write_compared
from metapp.runs.outputs.recorded import read_run, tasks_as
from metapp.runs.reporter import progress
from metapp.runs.run import Run
from metapp.runs.surroundings import threads
from metapp.storage import Document
from metapp.storage.fits import PARAMS, summary

SPHERES = ("brdf",)  # applications whose pictures are spheres: colours of the same places
# settings that tell runs apart, the clearest first
LABEL_KEYS = ("paradigm", "rule", "recipe", "steps", "observe", "seed", "checkpoint")


class Side(NamedTuple):
    """A run that is compared.

    Attributes:
        label: a word that tells it from the other.
        app: as it was at the first fit.
        folder: of the run.
        records: of the tasks in common, in the same order.
    """

    label: str
    app: App
    folder: Path
    records: list[Document]

    def errors(self, measure: str = "error") -> dict[str, float]:
        """By the task's name, of those that have one; also further ones that records state."""
        return {record["name"]: record[measure] for record in self.records if record.get(measure) is not None}

    def mean(self, measure: str = "error") -> float | None:
        """Of the errors; None if there are none."""
        return statistics.fmean(self.errors(measure).values()) if self.errors(measure) else None

    def seconds(self) -> float | None:
        """The median of a fit; None of answers that were made elsewhere."""
        return summary(self.records)["seconds"]


Measured = tuple[tuple[float, float], Paired | None]  # the means of a further error of both runs, and their ratio


class Comparison(NamedTuple):
    """Two runs on the tasks that they have in common.

    Attributes:
        sides: the two.
        tasks: of the fits, in the order of the records; none if they cannot be read.
        ratio: the mean error of the first over that of the second, or their difference; None if there is none.
        measures: the same of further errors that both have, by their titles.
        notes: important differences beside the runs' settings.
    """

    sides: tuple[Side, Side]
    tasks: list[Task]
    ratio: Paired | None
    measures: dict[str, Measured]
    notes: list[str]

    def document(self, picture: Path | None) -> Document:
        """The document that --json prints."""
        one, other = self.sides
        pairs = zip(one.records, other.records, strict=True)
        return {
            "app": one.app.name,
            "runs": [
                {"label": side.label, "out": str(side.folder), "error": side.mean(), "seconds": side.seconds()}
                for side in self.sides
            ],
            "compared": self.ratio and self.ratio._asdict(),
            "measures": {
                title: {"means": means, "compared": ratio and ratio._asdict()}
                for title, (means, ratio) in self.measures.items()
            },
            "tasks": [
                {"name": a["name"], "error": [a["error"], b["error"]], "seconds": [a.get("seconds"), b.get("seconds")]}
                for a, b in pairs
            ],
            "notes": self.notes,
            "picture": picture and str(picture),
        }


def compare(first: Path, second: Path, task: str, inputs: list[Path], data: Path | None) -> Comparison:
    """Put two runs side by side.

    Args:
        first: folder of a run, or of one of its tasks.
        second: of the other one.
        task: the one to compare; "" for all in common.
        inputs: the fitted files, if they are not in the places of records.
        data: the data set that was fitted, for the same.

    Raises:
        ValueError: no runs, of different applications, or without a task in common.
    """
    runs = [read_run(path, task, by_paradigm=False) for path in (first, second)]
    settings = [run.records[-1]["settings"] for run in runs]
    if settings[0]["app"] != settings[1]["app"]:
        apps = " and ".join(each["app"] for each in settings)
        raise ValueError(f"{second}: runs of {apps}, expected two of one application; take another run.")
    by_name = [{record["name"]: record for record in run.records} for run in runs]
    names = [name for name in by_name[0] if name in by_name[1]]
    if not names:
        counts = f"{len(by_name[0])} and {len(by_name[1])} tasks, none in common"
        raise ValueError(f"{second}: {counts}, expected some; compare runs of the same data.")
    sides = [
        Side(label, Run.of_settings(each).app, run.folder, [of[name] for name in names])
        for label, each, run, of in zip(_labels(*settings), settings, runs, by_name, strict=True)
    ]
    tasks_by_name = tasks_as(runs[0].records, sides[0].app, inputs, data)
    tasks = [tasks_by_name[name] for name in names if name in tasks_by_name]
    groups = {name: (tasks_by_name[name].group if name in tasks_by_name else "") or name for name in names}
    one, other = sides
    ratio_of_errors = paired(one.errors(), other.errors(), groups, logarithmic=one.app.logarithmic)
    measures = {}
    for key, title in one.app.measures.items():
        if (first_mean := one.mean(key)) is not None and (second_mean := other.mean(key)) is not None:
            ratio = paired(one.errors(key), other.errors(key), groups, logarithmic=False)
            measures[title] = (first_mean, second_mean), ratio
    return Comparison((one, other), tasks, ratio_of_errors, measures, _notes(settings, by_name, names))


def draw(compared: Comparison, file: Path, *, quiet: bool) -> tuple[Path | None, Comparison]:
    """Write a picture of up to COMPARED tasks, a column each: the reference, and the fits of both runs below it.

    Returns:
        The file; None if tasks cannot be read, or one run is of a method that keeps no picture. And the
        comparison, of spheres with the colour differences of the pictures.
    """
    kept = (Path(record["folder"], PARAMS) for side in compared.sides for record in side.records)
    if not compared.tasks or not all(path.is_file() for path in kept):
        return None, compared
    records = [{record["name"]: record for record in side.records} for side in compared.sides]
    drawn, app = compared.tasks[:COMPARED], compared.sides[0].app
    columns = []
    with progress("picture", len(drawn), quiet=quiet) as bar, threads(single=app.single_threaded):
        for task in drawn:
            pairs = zip(compared.sides, records, strict=True)
            columns.append(column_of(task, [(side.label, side.app, of[task.name]) for side, of in pairs]))
            bar.advance(task.name)
    judged = [column for column in columns if "reference" in column.pictures]
    if app.name in SPHERES and judged:
        compared = compared._replace(measures=compared.measures | _colour_differences(judged, compared))
    return write_compared(app, columns, file), compared


def _colour_differences(columns: list[Column], compared: Comparison) -> dict[str, Measured]:
    """Of both fits' spheres from the reference's, by their titles: median and 95th percentile of a sphere's pixels."""
    found: list[tuple[dict[str, float], dict[str, float]]] = [({}, {}), ({}, {})]
    for column in columns:
        reference, *fits = column.pictures.values()
        touched = np.min([reference, *fits], 0).min(-1) < 1  # the background is white
        for side, fit in enumerate(fits):
            values = np.quantile(colour_difference(fit[touched], reference[touched]), (0.5, 0.95))
            for measure, value in zip(found[side], values.tolist(), strict=True):
                measure[column.name] = value
    groups = {task.name: task.group or task.name for task in compared.tasks}
    return {
        f"CIE 2000 colour difference of {len(columns)} spheres drawn, {share} of pixels": (
            (statistics.fmean(one.values()), statistics.fmean(other.values())),
            paired(one, other, groups, logarithmic=False),
        )
        for share, one, other in zip(("median", "95 %"), *found, strict=True)
    }


def _labels(first: Document, second: Document) -> tuple[str, str]:
    """Labels that tell two runs apart, a word each; A and B if nothing in LABEL_KEYS does."""
    first, second = ({"paradigm": each.get("method"), **each} for each in (first, second))
    for key in LABEL_KEYS:
        if first.get(key) != second.get(key):
            kind = "" if key in ("paradigm", "rule", "recipe") else f"{key}-"
            one, other = (f"{kind}{each.get(key)}" for each in (first, second))
            return one, other
    return "A", "B"


def _notes(settings: list[Document], by_name: list[Document], names: list[str]) -> list[str]:
    """Notes on differences beside the labels."""
    one, other = settings
    left_out = sum(map(len, by_name)) - 2 * len(names)
    differ = sum(len({of[name].get("content") for of in by_name}) > 1 for name in names)
    return [
        *([f"{left_out} tasks of one run alone are left out"] if left_out else []),
        *([f"{differ} tasks in common have other content in the two runs, and the same name"] if differ else []),
        *(
            f"{key}: {one.get(key)} and {other.get(key)}"
            for key in sorted({*one, *other})
            if key in ("device", "versions", "features", "precision", "observe") and one.get(key) != other.get(key)
        ),
    ]
