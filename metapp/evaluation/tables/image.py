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
from metapp.runs.fit import Fit

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
    return make_image_table(evaluation, fits_with_measures(evaluation) if evaluation.presenter.picture_measure else [])


def make_image_table(evaluation: EvaluationRun, fits: list[Fit]) -> Table:
    """Make the table of image measures of fits that hold them, see :func:`fits_with_measures`."""
    rows = _make_rows(evaluation, fits) if evaluation.presenter.picture_measure else []
    notes = image_notes(evaluation, rows)
    return Table(evaluation.title, "measures in image space", IMAGE_COLUMNS, rows, notes)


def fits_with_measures(evaluation: EvaluationRun) -> list[Fit]:
    """Measure the pictures of all paradigms, task by task, since the paradigms share a task's reference."""
    app = evaluation.app
    by_paradigm = {name: {fit.name: fit for fit in evaluation.fits(name)} for name in PARADIGMS}

    def measure(tasks: list[Task]) -> Iterator[Fit]:
        for task in tasks:
            fits = {
                name: TimedFit(fits[task.name].parameters, fits[task.name].seconds or 0.0)
                for name, fits in by_paradigm.items()
            }
            measures = measure_pictures(evaluation.presenter, fits, task)
            yield Fit(name=task.name, spec=evaluation.given, figures={"measures": measures}, source=task.name)

    measure_texts = [evaluation.presenter.picture_measure, describe_picture_measures(app.name)[0]]
    spec, tasks = (
        evaluation.spec_of_kind("image", {"measure": measure_texts}, PARADIGMS),
        map(evaluation.tasks_of, PARADIGMS),
    )
    return evaluation.measure("pictures", evaluation.folder("image"), spec, measure, min(tasks, key=len))


def _make_rows(evaluation: EvaluationRun, fits: list[Fit]) -> list[Row]:
    """Make the rows of all measures, of pictures without a fit and of all paradigms."""
    measures = [fit.figures["measures"] for fit in fits]
    other_names = dict.fromkeys(name for by_name in measures for name in by_name if name not in PARADIGMS)
    keys = dict.fromkeys(key for by_name in measures for values in by_name.values() for key in values)
    return [
        _make_measure_row(evaluation, name, fits, key)
        for key in keys or ("",)
        for name in (*other_names, *PARADIGMS)
        if name != REFERENCE_ERROR_NAME or any(key in by_name[name] for by_name in measures)
    ]


def _make_measure_row(evaluation: EvaluationRun, name: str, fits: list[Fit], key: str) -> Row:
    """Make the row of one method by one measure.

    Args:
        evaluation: the application, with its tasks and fits.
        name: a paradigm, or the name of a picture that is made without a fit.
        fits: fits of tasks, with their measures.
        key: the measure; "" if nothing was measured yet.
    """
    app, measure = evaluation.app.name, registry().measures.get(key)
    bound, is_ssim = paper_figures()["ssim"]["at_least"], key.startswith("SSIM")
    more_is_better = is_ssim or (measure is not None and measure.load().more_is_better)

    measured = [replace(fit, error=fit.figures["measures"].get(name, {}).get(key)) for fit in fits]
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
