"""Measures in image space, of pictures that fits make beside the references: `Presentation.image_errors`."""

from __future__ import annotations

import statistics
from collections.abc import Iterator

from metapp.appearance.presentation import REFERENCE, Fitted
from metapp.evaluation.tables.results import budget
from metapp.evaluation.tables.rows import Row, interval, numbers, paper, words
from metapp.evaluation.tables.subject import Cell, Record, Subject
from metapp.evaluation.tables.table import Table
from metapp.learning.task import Task
from metapp.runs.naming import name_of
from metapp.runs.surroundings import threads_of
from metapp.storage.records import OPTIONAL, RunFolder

FORM = {"measures": {...: {...: OPTIONAL}}}  # of a record


def compared(subject: Subject) -> dict[str, Cell]:
    """The fits whose pictures are measured: of every paradigm; none where the application has no such measure."""
    if not subject.presentation.image_measure:
        return {}
    return {name: subject.cell(name) for name, fit in subject.fits.items() if name == fit.plan.paradigm.name}


def cells(subject: Subject) -> list[Cell]:
    """The fits, and the measures of their pictures."""
    fits = compared(subject)
    return [*fits.values(), image_cell(subject)] if fits else []


def image_cell(subject: Subject) -> Cell:
    """The measures of all paradigms' pictures, a task at a time, since they share its reference."""
    app, plan, fits, shown = subject.app, subject.plan, compared(subject), subject.presentation
    folders = {name: cell.folder for name, cell in fits.items() if cell.folder}
    folder = None
    if len(folders) == len(fits):
        request = plan.request
        path = request.out / app.name / "image" / f"{subject.label}-{request.recipe}-seed{request.seed}"
        end = "-".join(filter(None, (plan.job.rule, subject.shortened, app.protocol)))
        keys = {name: each.key for name, each in folders.items()}
        said = {"app": app.name, "measure": shown.image_measure, "fits": keys}
        folder = RunFolder(path.with_name(f"{path.name}-{end}"), said, FORM)

    def measure(missing: list[Task]) -> Iterator[tuple[Record, None]]:
        seconds = {name: {record["name"]: record["seconds"] for record in fits[name].records()} for name in fits}
        for task in missing:
            fitted = {name: Fitted(folders[name].theta(task.name), seconds[name][task.name]) for name in fits}
            yield {"name": task.name, "error": None, "measures": shown.image_errors(fitted, task)}, None

    title = f"{name_of(app)} pictures"
    command, count = subject.command("image"), threads_of(app)
    return Cell(title, subject.tasks, folder, measure, 0, command, 1, threads=count, guess=shown.image_seconds)


def rows(subject: Subject) -> list[Row]:
    """A row for each measure of each picture; those that are made without a fit come first."""
    fits = compared(subject)
    if not fits:
        return []
    cell = image_cell(subject)
    measures = [record["measures"] for record in cell.records()]
    others = dict.fromkeys(name for each in measures for name in each if name not in fits)
    keys = dict.fromkeys(key for each in measures for of in each.values() for key in of)
    return [
        measured_row(subject, name, cell, key)
        for key in keys or ("",)
        for name in (*others, *fits)
        if name != REFERENCE or any(key in each[name] for each in measures)
    ]


def measured_row(subject: Subject, name: str, cell: Cell, key: str) -> Row:
    """A row of one measure; "" where nothing was measured yet."""
    told, app = paper(), subject.app.name
    bound, better = told["ssim"]["at_least"], key.startswith("SSIM")  # more of it is

    def take(record: Record) -> float | None:
        result: float | None = record["measures"].get(name, {}).get(key)
        return result

    values = [value for record in cell.records() if (value := take(record)) is not None]
    return subject.row(name, cell, take, measure=key or None) | {
        "paper_error": told["image"].get(app, {}).get(key, {}).get(name),
        "paper_seconds": None,
        "worst": (min(values) if better else max(values)) if values else None,
        "share": statistics.fmean(value >= bound for value in values) if better and values else None,
        "measured": len(values),
        "paper_share": told["ssim"]["share"].get(app, {}).get(name) if better else None,
    }


def notes(subject: Subject, found: list[Row]) -> list[str]:
    """What the measures are of."""
    told = paper()
    own = [
        f"the references themselves are off by {row['error']:.3f} {row['measure']}, which all figures of it contain"
        for row in found
        if row["paradigm"] == REFERENCE and row["error"] is not None
    ]
    said = [", ".join([subject.presentation.image_measure, *own]), *budget(subject)]
    said += [
        f"{row['paradigm']}, {row['measure']}: mean of {row['measured']} of {row['tasks']} tasks, the others have none"
        for row in found
        if row["paradigm"] != REFERENCE and 0 < row["measured"] < row["tasks"]
    ]
    if any(row["paper_share"] is not None for row in found):
        said.append(f"paper: {told['sources']['ssim']}")
    if subject.app.name in told["image"]:
        said.append(f"paper: {told['sources']['image']}")
    return said


TABLE = Table(
    "image",
    "measures in image space",
    (
        words("paradigm", "paradigm"),
        words("measure", "measure"),
        numbers("mean", "error", ".3f"),
        numbers("paper", "paper_error", ".3f"),
        numbers(f"share >= {paper()['ssim']['at_least']}", "share", ".0%"),
        numbers("paper share", "paper_share", ".0%"),
        interval(),
        numbers("worst", "worst", ".3f"),
    ),
    cells,
    rows,
    notes,
)
