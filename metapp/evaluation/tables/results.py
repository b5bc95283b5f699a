"""The paper's main table: error and time of every paradigm, and the two figures that carry across data and machines."""

from __future__ import annotations

from metapp.evaluation.cell import Cell
from metapp.evaluation.notes import carried, change, overfit_note, paired_note, threads_note, verdict, warned
from metapp.evaluation.rows import (
    ERROR,
    INTERVAL,
    MEDIAN,
    PARADIGM,
    SECONDS,
    STEPS,
    WORST,
    Row,
    Table,
    against,
    numbers,
    paired_columns,
    row_of,
)
from metapp.evaluation.subject import Subject
from metapp.learning.app import App
from metapp.runs.naming import caption_of, is_first_protocol
from metapp.runs.reporter import number

COMPARED = ("quickft", "general")


def cells(subject: Subject) -> list[Cell]:
    """The fits of every paradigm, and of Meta by every rule that has a checkpoint."""
    return [subject.cell(name) for name in subject.fits]


def rows(subject: Subject) -> list[Row]:
    """A row for each of them."""
    return [result_row(subject, name) for name in subject.fits]


def result_row(subject: Subject, name: str) -> Row:
    """Error and time of one paradigm, or of one of Meta's rules, also beside QuickFT's and General's."""
    fit = subject.fits[name]
    rule = fit.job.rule if fit.paradigm.name == "meta" else None
    versus = against(subject, name, *COMPARED)
    return row_of(subject, name, [subject.cell(name)], {"rule": rule, "steps": fit.steps}, against=versus)


def notes(subject: Subject, found: list[Row]) -> list[str]:
    """Gap closed, speed-up, who wins, what the errors are, and what differs from the recipe and the paper."""
    meta = next(row for row in found if row["paradigm"] == "meta")
    return [
        closing(subject.app, found),
        *filter(None, (verdict(meta, other) for other in COMPARED)),
        *warned(found),
        f"meta: {meta['rule']}; {caption_of(subject.app)}",
        *paired_note(found),
        *threads_note(found),
        *overfit_note(subject),
        *(["the paper's figures are of its own data and machine"] if is_first_protocol(subject.app) else []),
    ]


def closing(app: App, found: list[Row]) -> str:
    """Gap closed and speed-up beside the paper's.

    Under a further protocol Overfit fits less than errors are measured on: Meta is compared with General and QuickFT.
    """
    gap, speed = carried(found, "error", "seconds")
    if not is_first_protocol(app):
        by_name = {row["paradigm"]: row for row in found}
        others = {"General": by_name["general"], "QuickFT": by_name["quickft"]}
        changes = [f"{text} {title}'s" for title, row in others.items() if (text := change(by_name["meta"], row))]
        said = f"Meta's error is {', '.join(changes)}; " if changes else ""
        floor = f"Overfit sees the {app.protocol} alone and is no floor"
        return f"{said}{floor}, speed-up of Meta over it {number(speed, '.0f')}"
    paper_gap, paper_speed = carried(found, "paper_error", "paper_seconds")
    return (
        f"gap closed {number(gap, '.2f')} (paper {number(paper_gap, '.2f')}), "
        f"speed-up of Meta over Overfit {number(speed, '.0f')} (paper {number(paper_speed, '.0f')})"
    )


PAPER_ERROR = numbers("paper error", "paper_error", ".3f")
PAPER_SECONDS = numbers("paper seconds", "paper_seconds", ".3f")
COMPARISON = paired_columns("quickft")
COLUMNS = (PARADIGM, ERROR, SECONDS, PAPER_ERROR, PAPER_SECONDS, *COMPARISON, INTERVAL, STEPS, MEDIAN, WORST)
TABLE = Table("results", "mean error{factor}, median seconds of inference", COLUMNS, rows, notes, cells)
