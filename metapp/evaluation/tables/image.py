"""The table of measures in image space, of pictures that fits make beside the references.

A presenter makes the pictures and says what they are (`Presenter.picture_errors`); the registry has the measures.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator

from msgspec.structs import replace

from metapp.appearance.picture_measures import describe_picture_measures, measure_pictures
from metapp.appearance.pictures import REFERENCE_ERROR_NAME, TimedFit
from metapp.evaluation.evaluation_run import EvaluationRun
from metapp.evaluation.rows import errors_by_task, make_row, paper_figure, paper_figures, subset_note
from metapp.evaluation.table import Column, Row, Table, columns
from metapp.learning.task import Task
from metapp.paradigms import PARADIGMS
from metapp.registry import registry
from metapp.storage.fit_records import FitRecord, Settings
from metapp.storage.parameters import read_checked_params

IMAGE_COLUMNS = columns(
    "paradigm",
    Column("measure", "measure"),
    Column("mean", "error", ".3f"),
    Column("paper", "paper_error", ".3f", is_optional=True),
    Column(f"share >= {paper_figures()['ssim']['at_least']}", "share", ".0%"),
    Column("paper share", "paper_share", ".0%", is_optional=True),
    *("interval", "worst"),
)


def image(evaluation: EvaluationRun) -> Table:
    """Make the table of image measures: a row for each measure of each picture, those without a fit first."""
    return make_image_table(evaluation, picture_records(evaluation) if evaluation.presenter.picture_measure else [])


def make_image_table(evaluation: EvaluationRun, records: list[FitRecord]) -> Table:
    """Make the table of image measures of records that hold them, see :func:`picture_records`."""
    rows = _make_rows(evaluation, records) if evaluation.presenter.picture_measure else []
    notes = image_notes(evaluation, rows)
    return Table(evaluation.title, "measures in image space", IMAGE_COLUMNS, rows, notes)


def picture_records(evaluation: EvaluationRun) -> list[FitRecord]:
    """Measure the pictures of all paradigms, task by task, since the paradigms share a task's reference."""
    app = evaluation.app
    by_paradigm = {name: {record.name: record for record in evaluation.records(name)} for name in PARADIGMS}

    def measure(tasks: list[Task]) -> Iterator[tuple[FitRecord, None]]:
        for task in tasks:
            task_records = {name: records[task.name] for name, records in by_paradigm.items()}
            fits = {
                name: TimedFit(read_checked_params(record, app), record.seconds or 0.0)
                for name, record in task_records.items()
            }
            measures = measure_pictures(evaluation.presenter, fits, task)
            yield FitRecord(name=task.name, error=None, figures={"measures": measures}), None

    measure_texts = [evaluation.presenter.picture_measure, describe_picture_measures(app.name)[0]]
    settings = Settings(app=app.name, further={"measure": measure_texts})
    store = evaluation.record_store("image", settings, ("measures",), PARADIGMS)
    return evaluation.measure_records("pictures", store, measure, min(map(evaluation.tasks_of, PARADIGMS), key=len))


def _make_rows(evaluation: EvaluationRun, records: list[FitRecord]) -> list[Row]:
    """Make the rows of all measures, of pictures without a fit and of all paradigms."""
    measures = [record.figures["measures"] for record in records]
    other_names = dict.fromkeys(name for by_name in measures for name in by_name if name not in PARADIGMS)
    keys = dict.fromkeys(key for by_name in measures for values in by_name.values() for key in values)
    return [
        _make_measure_row(evaluation, name, records, key)
        for key in keys or ("",)
        for name in (*other_names, *PARADIGMS)
        if name != REFERENCE_ERROR_NAME or any(key in by_name[name] for by_name in measures)
    ]


def _make_measure_row(evaluation: EvaluationRun, name: str, records: list[FitRecord], key: str) -> Row:
    """Make the row of one method by one measure.

    Args:
        evaluation: the application, with its tasks and records.
        name: a paradigm, or the name of a picture that is made without a fit.
        records: the records of tasks, with their measures.
        key: the measure; "" if nothing was measured yet.
    """
    app, measure = evaluation.app.name, registry().measures.get(key)
    bound, is_ssim = paper_figures()["ssim"]["at_least"], key.startswith("SSIM")
    more_is_better = is_ssim or (measure is not None and measure.load().more_is_better)

    measured = [replace(record, error=record.figures["measures"].get(name, {}).get(key)) for record in records]
    values = list(errors_by_task(measured).values())
    return make_row(evaluation, name, measured, {}) | {
        "measure": key or None,
        "paper_error": paper_figure(evaluation, "image", app, key, name),
        "worst": (min(values) if more_is_better else max(values)) if values else None,
        "share": statistics.fmean(value >= bound for value in values) if is_ssim and values else None,
        "measured": len(values),
        "paper_share": paper_figure(evaluation, "ssim", "share", app, name) if is_ssim else None,
    }


def image_notes(evaluation: EvaluationRun, rows: list[Row]) -> list[str]:
    """Return sentences on the measures, the references and the paper."""
    sources = paper_figures()["sources"]
    reference_notes = [
        f"the references themselves have an error of {row['error']:.3f} {row['measure']}, which all errors "
        "by this measure contain"
        for row in rows
        if row["paradigm"] == REFERENCE_ERROR_NAME and row["error"] is not None
    ]
    measures, missing = describe_picture_measures(evaluation.app.name)
    lines = [", ".join([evaluation.presenter.picture_measure, *reference_notes]), *subset_note(evaluation)]
    lines += [*(f"{name}: {note}" for name, note in measures.items()), *missing]
    lines += [
        f"{row['paradigm']}, {row['measure']}: mean of {row['measured']} of {row['tasks']} tasks, the others have none"
        for row in rows
        if row["paradigm"] != REFERENCE_ERROR_NAME and 0 < row["measured"] < row["tasks"]
    ]
    if any(row["paper_share"] is not None for row in rows):
        lines.append(f"paper: {sources['ssim']}")
    if paper_figure(evaluation, "image", evaluation.app.name):
        lines.append(f"paper: {sources['image']}")
    return lines
