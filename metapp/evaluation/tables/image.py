"""Measures in image space, of pictures that fits make beside the references: `App.image_errors`."""

from __future__ import annotations

import statistics
from collections.abc import Iterator

from metapp.appearance.picture_measures import image_errors, picture_measures
from metapp.evaluation.cell import Cell
from metapp.evaluation.notes import few_note
from metapp.evaluation.rows import Row, Table, columns, numbers, paper, row_of, values_of, words
from metapp.evaluation.subject import Subject
from metapp.learning.pictures import REFERENCE, Fitted
from metapp.learning.task import Task
from metapp.registry import registry
from metapp.storage.checkpoints import digest
from metapp.storage.fits import Record, read_params


def fits_of(subject: Subject) -> dict[str, Cell]:
    """The fits whose pictures are measured: of every paradigm; none where the application has no such measure."""
    if not subject.app.image_measure:
        return {}
    return {name: subject.cell(name) for name, fit in subject.fits.items() if name == fit.paradigm.name}


def cells(subject: Subject) -> list[Cell]:
    """The fits, and the measures of their pictures."""
    fits = fits_of(subject)
    return [*fits.values(), image_cell(subject)] if fits else []


def image_cell(subject: Subject) -> Cell:
    """The measures of all paradigms' pictures, a task at a time, since they share its reference."""
    fits, app = fits_of(subject), subject.app
    keys = {name: digest(cell.fits.settings) for name, cell in fits.items() if cell.fits}
    further = picture_measures(subject.app.name)[0]
    settings = {"app": app.name, "measure": [app.image_measure, further], "fits": keys}
    kept = subject.kept("image", settings, ("measures",), of_fits=True) if len(keys) == len(fits) else None

    def measure(tasks: list[Task]) -> Iterator[tuple[Record, None]]:
        records = {name: {record["name"]: record for record in fits[name].records()} for name in fits}
        for task in tasks:
            of_task = {name: records[name][task.name] for name in fits}
            fitted = {name: Fitted(read_params(one["folder"]), one["seconds"]) for name, one in of_task.items()}
            yield {"name": task.name, "error": None, "measures": image_errors(app, fitted, task)}, None

    cell = subject.make_cell("pictures", kept, measure)
    return cell._replace(stage=1, tasks=min((fit.tasks for fit in fits.values()), key=len))


def rows(subject: Subject) -> list[Row]:
    """A row for each measure of each picture; those that are made without a fit come first."""
    fits = fits_of(subject)
    if not fits:
        return []
    cell = image_cell(subject)
    measures = [record["measures"] for record in cell.records()]
    others = dict.fromkeys(name for by_name in measures for name in by_name if name not in fits)
    keys = dict.fromkeys(key for by_name in measures for values in by_name.values() for key in values)
    return [
        measured_row(subject, name, cell, key)
        for key in keys or ("",)
        for name in (*others, *fits)
        if name != REFERENCE or any(key in by_name[name] for by_name in measures)
    ]


def measured_row(subject: Subject, name: str, cell: Cell, key: str) -> Row:
    """A row of one measure; "" where nothing was measured yet."""
    figures, app, measure = paper(), subject.app.name, registry().measures.get(key)
    bound, ssim = figures["ssim"]["at_least"], key.startswith("SSIM")
    more_is_better = ssim or (measure is not None and measure.load().more_is_better)

    def take(record: Record) -> float | None:
        result: float | None = record["measures"].get(name, {}).get(key)
        return result

    row = row_of(subject, name, [cell], {"measure": key or None}, take=take, beside_paper=False)
    values = list(values_of(cell, take).values())
    return row | {
        "paper_error": figures["image"].get(app, {}).get(key, {}).get(name),
        "worst": (min(values) if more_is_better else max(values)) if values else None,
        "share": statistics.fmean(value >= bound for value in values) if ssim and values else None,
        "measured": len(values),
        "paper_share": figures["ssim"]["share"].get(app, {}).get(name) if ssim else None,
    }


def notes(subject: Subject, all_rows: list[Row]) -> list[str]:
    """Notes on the measures."""
    sources = paper()["sources"]
    of_references = [
        f"the references themselves are off by {row['error']:.3f} {row['measure']}, which all figures of it contain"
        for row in all_rows
        if row["paradigm"] == REFERENCE and row["error"] is not None
    ]
    measures, missing = picture_measures(subject.app.name)
    lines = [", ".join([subject.app.image_measure, *of_references]), *few_note(subject)]
    lines += [*(f"{name}: {note}" for name, note in measures.items()), *missing]
    lines += [
        f"{row['paradigm']}, {row['measure']}: mean of {row['measured']} of {row['tasks']} tasks, the others have none"
        for row in all_rows
        if row["paradigm"] != REFERENCE and 0 < row["measured"] < row["tasks"]
    ]
    if any(row["paper_share"] is not None for row in all_rows):
        lines.append(f"paper: {sources['ssim']}")
    if subject.app.name in paper()["image"]:
        lines.append(f"paper: {sources['image']}")
    return lines


COLUMNS = columns(
    "paradigm",
    words("measure", "measure"),
    numbers("mean", "error", ".3f"),
    numbers("paper", "paper_error", ".3f"),
    numbers(f"share >= {paper()['ssim']['at_least']}", "share", ".0%"),
    numbers("paper share", "paper_share", ".0%"),
    *("interval", "worst"),
)
IMAGE = Table("image", "measures in image space", COLUMNS, rows, notes, cells, "In image space")
