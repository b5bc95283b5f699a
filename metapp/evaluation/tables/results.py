"""The paper's main table: error and time of every paradigm, and the two figures that carry across data and machines."""

from __future__ import annotations

from metapp.evaluation.tables.rows import Column, Row, interval, numbers, words
from metapp.evaluation.tables.statistics import (
    carried,
    change,
    paired_columns,
    paired_entries,
    paired_note,
    verdict,
    warned,
)
from metapp.evaluation.tables.subject import Cell, Subject
from metapp.evaluation.tables.table import Table
from metapp.learning.app import App
from metapp.runs.reporter import number
from metapp.runs.session import caption_of, is_first_protocol

COMPARED = ("quickft", "general")


def cells(subject: Subject) -> list[Cell]:
    """The fits of every paradigm, and of Meta by every rule that has a checkpoint."""
    return [subject.cell(name) for name in subject.fits]


def rows(subject: Subject) -> list[Row]:
    """A row for each of them."""
    return [result_row(subject, name) for name in subject.fits]


def result_row(subject: Subject, name: str) -> Row:
    """Error and time of one paradigm, or of one of Meta's rules, also beside QuickFT's and General's."""
    fit, cell = subject.fits[name], subject.cell(name)
    row = subject.row(
        name,
        cell,
        rule=fit.options.rule if fit.paradigm.name == "meta" else None,
        steps=fit.paradigm.count(fit.options.job),
    )
    for other in COMPARED:
        row |= paired_entries(other, subject.paired(cell, subject.cell(other)) if other != name else None)
    return row


def notes(subject: Subject, found: list[Row]) -> list[str]:
    """Gap closed, speed-up, who wins, what the errors are, and what differs from the recipe and the paper."""
    meta = next(row for row in found if row["paradigm"] == "meta")
    return [
        closing(subject.app, found),
        *filter(None, (verdict(meta, other) for other in COMPARED)),
        *warned(found),
        f"meta: {meta['rule']}; {caption_of(subject.app)}",
        *paired_note(found),
        *on_threads(found),
        *budget(subject),
        *(["the paper's figures are of its own data and machine"] if subject.is_papers else []),
    ]


def on_threads(found: list[Row]) -> list[str]:
    """The threads that seconds are of, where records say so."""
    known = list(dict.fromkeys(row["threads"] for row in found if row["threads"]))
    if len(known) > 1:
        said = "; ".join(f"{row['paradigm']} {row['threads']}" for row in found if row["threads"])
        return [f"threads: {said}; seconds of different threads do not compare"]
    return [f"threads: {each}" for each in known]


def budget(subject: Subject) -> list[str]:
    """What is said where Overfit takes fewer steps than the recipe's."""
    if subject.share == 1:
        return []
    steps, recipe = subject.fits["overfit"].options.steps, subject.options.job.recipe.overfit_steps
    changed = "its error and the gap closed are too high, its time and the speed-up too low"
    return [f"overfit: {steps:,} of the recipe's {recipe:,} steps, so {changed}"]


def closing(app: App, found: list[Row]) -> str:
    """Gap closed and speed-up beside the paper's.

    Under a further protocol Overfit fits less than errors are measured on: Meta is compared with General and QuickFT.
    """
    gap, speed = carried(found, "error", "seconds")
    if not is_first_protocol(app):
        floor = f"Overfit sees the {app.protocol} alone and is no floor"
        return f"{_changes(found)}{floor}, speed-up of Meta over it {number(speed, '.0f')}"
    paper_gap, paper_speed = carried(found, "paper_error", "paper_seconds")
    return (
        f"gap closed {number(gap, '.2f')} (paper {number(paper_gap, '.2f')}), "
        f"speed-up of Meta over Overfit {number(speed, '.0f')} (paper {number(paper_speed, '.0f')})"
    )


def _changes(found: list[Row]) -> str:
    """How far Meta's error is from General's and QuickFT's, in percent, as far as there are such errors."""
    by = {row["paradigm"]: row for row in found}
    others = (("general", "General"), ("quickft", "QuickFT"))
    said = [f"{change(by['meta'], by[name])} {title}'s" for name, title in others if change(by["meta"], by[name])]
    return f"Meta's error is {', '.join(said)}; " if said else ""


COLUMNS: tuple[Column, ...] = (
    words("paradigm", "paradigm"),
    numbers("error", "error", ".3f"),
    numbers("seconds", "seconds", ".4f"),
    numbers("paper error", "paper_error", ".3f"),
    numbers("paper seconds", "paper_seconds", ".3f"),
    *paired_columns("quickft"),
    interval(),
    numbers("steps", "steps", "d"),
    numbers("median", "median", ".3f"),
    numbers("worst", "worst", ".3f"),
)
TABLE = Table("results", "mean error{factor}, median seconds of inference", COLUMNS, cells, rows, notes)
