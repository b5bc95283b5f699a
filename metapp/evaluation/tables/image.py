"""Measures in image space, of pictures that fits make beside the references: `Presenter.picture_errors`."""

from __future__ import annotations

import statistics
from collections.abc import Iterator

from metapp.appearance.picture_measures import describe_picture_measures, measure_pictures
from metapp.appearance.pictures import REFERENCE_ERROR_NAME, TimedFit
from metapp.evaluation.rows import errors_by_task, make_row, paper_figures, subset_note
from metapp.evaluation.subject import EvaluationRun
from metapp.evaluation.table import Column, Row, Table, columns
from metapp.learning.task import Task
from metapp.paradigms import PARADIGMS
from metapp.registry import registry
from metapp.storage.fit_folders import Record
from metapp.storage.parameters import read_checked_params

IMAGE_COLUMNS = columns(
    "paradigm",
    Column("measure", "measure"),
    Column("mean", "error", ".3f"),
    Column("paper", "paper_error", ".3f"),
    Column(f"share >= {paper_figures()['ssim']['at_least']}", "share", ".0%"),
    Column("paper share", "paper_share", ".0%"),
    *("interval", "worst"),
)


def image(subject: EvaluationRun) -> Table:
    """A row for each measure of each picture; those that are made without a fit come first."""
    rows = _rows(subject, picture_records(subject)) if subject.presenter.picture_measure else []
    notes = image_notes(subject, rows)
    return Table(subject.title, "measures in image space", IMAGE_COLUMNS, rows, notes)


def picture_records(subject: EvaluationRun) -> list[Record]:
    """The measures of all paradigms' pictures, a task at a time, since they share its reference."""
    app = subject.app
    by_paradigm = {name: {record["name"]: record for record in subject.records(name)} for name in PARADIGMS}

    def measure(tasks: list[Task]) -> Iterator[tuple[Record, None]]:
        for task in tasks:
            of_task = {name: records[task.name] for name, records in by_paradigm.items()}
            fitted = {name: TimedFit(read_checked_params(one, app), one["seconds"]) for name, one in of_task.items()}
            yield (
                {"name": task.name, "error": None, "measures": measure_pictures(subject.presenter, fitted, task)},
                None,
            )

    settings = {"app": app.name, "measure": [subject.presenter.picture_measure, describe_picture_measures(app.name)[0]]}
    kept = subject.kept("image", settings, ("measures",), PARADIGMS)
    return subject.measured("pictures", kept, measure, min(map(subject.tasks_of, PARADIGMS), key=len))


def _rows(subject: EvaluationRun, records: list[Record]) -> list[Row]:
    measures = [record["measures"] for record in records]
    others = dict.fromkeys(name for by_name in measures for name in by_name if name not in PARADIGMS)
    keys = dict.fromkeys(key for by_name in measures for values in by_name.values() for key in values)
    return [
        _row(subject, name, records, key)
        for key in keys or ("",)
        for name in (*others, *PARADIGMS)
        if name != REFERENCE_ERROR_NAME or any(key in by_name[name] for by_name in measures)
    ]


def _row(subject: EvaluationRun, name: str, records: list[Record], key: str) -> Row:
    """A row of one measure; "" if nothing was measured yet."""
    figures, app, measure = paper_figures(), subject.app.name, registry().measures.get(key)
    bound, ssim = figures["ssim"]["at_least"], key.startswith("SSIM")
    more_is_better = ssim or (measure is not None and measure.load().more_is_better)

    measured = [record | {"error": record["measures"].get(name, {}).get(key)} for record in records]
    values = list(errors_by_task(measured).values())
    return make_row(subject, name, measured, {}) | {
        "measure": key or None,
        "paper_error": figures["image"].get(app, {}).get(key, {}).get(name),
        "worst": (min(values) if more_is_better else max(values)) if values else None,
        "share": statistics.fmean(value >= bound for value in values) if ssim and values else None,
        "measured": len(values),
        "paper_share": figures["ssim"]["share"].get(app, {}).get(name) if ssim else None,
    }


def image_notes(subject: EvaluationRun, rows: list[Row]) -> list[str]:
    """Sentences on the measures, the references and the paper."""
    sources = paper_figures()["sources"]
    of_references = [
        f"the references themselves are off by {row['error']:.3f} {row['measure']}, which all figures of it contain"
        for row in rows
        if row["paradigm"] == REFERENCE_ERROR_NAME and row["error"] is not None
    ]
    measures, missing = describe_picture_measures(subject.app.name)
    lines = [", ".join([subject.presenter.picture_measure, *of_references]), *subset_note(subject)]
    lines += [*(f"{name}: {note}" for name, note in measures.items()), *missing]
    lines += [
        f"{row['paradigm']}, {row['measure']}: mean of {row['measured']} of {row['tasks']} tasks, the others have none"
        for row in rows
        if row["paradigm"] != REFERENCE_ERROR_NAME and 0 < row["measured"] < row["tasks"]
    ]
    if any(row["paper_share"] is not None for row in rows):
        lines.append(f"paper: {sources['ssim']}")
    if subject.app.name in paper_figures()["image"]:
        lines.append(f"paper: {sources['image']}")
    return lines
