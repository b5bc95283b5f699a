"""Measures in image space, of pictures that fits make beside the references'; `App.image_errors` says which."""

from __future__ import annotations

import operator
import statistics
from collections.abc import Iterator
from typing import Any

from safetensors.torch import load_file

from metapp.cli.session import name_of, versions
from metapp.cli.tables import Row, Table, interval, numbers, paper, words
from metapp.cli.tables.subject import Cell, Record, Subject
from metapp.records import RunFolder, file_name
from metapp.task import Task


def names(subject: Subject) -> list[str]:
    """The rows, by what makes their pictures: nothing, where that makes one, and the paradigms."""
    if not subject.app.image_measure:
        return []
    paradigms = [name for name, fit in subject.fits.items() if name == fit.paradigm.name]
    return [*filter(None, [subject.app.unfitted]), *paradigms]


def cells(subject: Subject) -> list[Cell]:
    """The fits, and the measures of their pictures."""
    return [
        cell
        for name in names(subject)
        for cell in ([subject.cell(name)] if name in subject.fits else []) + [image_cell(subject, name)]
    ]


def image_cell(subject: Subject, name: str) -> Cell:
    """The measures of what one paradigm has fitted, or of the picture that is made without any fit."""
    app, options = subject.app, subject.options
    fits = subject.cell(name) if name in subject.fits else None
    path, folder = options.out / app.name / "image" / f"{subject.label}-{options.recipe}-seed{options.seed}", None
    settings: dict[str, Any] = {"app": app.name, "measure": "image", "seed": options.seed, "versions": versions()}
    if fits is None:
        folder = RunFolder(path.with_name(f"{path.name}-{name}"), settings | {"data": subject.label})
    elif fits.folder is not None:
        run = fits.folder.path
        folder = RunFolder(path.with_name(f"{run.name}-{run.parent.name}"), settings | {"fit": fits.folder.key})

    def measure(missing: list[Task]) -> Iterator[Record]:
        assert folder is not None
        for task in missing:
            theta = None
            if fits is not None:
                assert fits.folder is not None
                theta = load_file(fits.folder.path / "params" / f"{file_name(task.name)}.safetensors")
            record = {"name": task.name, "error": None, **app.image_errors(theta, task)}
            folder.add(record)
            yield record

    title, command = f"{name_of(app)} picture of {name}", subject.command("image")
    return Cell(title, subject.tasks, folder, measure, steps=0, command=command, stage=1)


def rows(subject: Subject) -> list[Row]:
    """A row for each measure of each paradigm."""
    found = {name: image_cell(subject, name) for name in names(subject)}
    keys = dict.fromkeys(
        key for cell in found.values() for record in cell.records() for key in record if key not in RESERVED
    )
    return [measured_row(subject, name, cell, key) for key in keys or ("",) for name, cell in found.items()]


def measured_row(subject: Subject, name: str, cell: Cell, key: str) -> Row:
    """A row of one measure; "" where nothing was measured yet."""
    told, app = paper(), subject.app.name
    bound = told["ssim"]["at_least"]
    better = key.startswith("SSIM")  # more of it is
    values = [record[key] for record in cell.records() if record.get(key) is not None]
    return subject.row(name, cell, operator.methodcaller("get", key), measure=key or None) | {
        "paper_error": told["image"].get(app, {}).get(key, {}).get(name),
        "paper_seconds": None,
        "worst": (min(values) if better else max(values)) if values else None,
        "share": statistics.fmean(value >= bound for value in values) if better and values else None,
        "paper_share": told["ssim"]["share"].get(app, {}).get(name) if better else None,
    }


RESERVED = ("name", "error", "key", "settings")


def notes(subject: Subject, found: list[Row]) -> list[str]:
    """What the measures are of."""
    if not names(subject):
        return ["no measure in image space"]
    told = paper()
    said = [subject.app.image_measure]
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
    5,
    cells,
    rows,
    notes,
)
