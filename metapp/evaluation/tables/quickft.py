"""The paper's table of equal steps: is Meta more than a quick fine-tuning of General?"""

from __future__ import annotations

from metapp.evaluation.tables.comparison import change, paired_columns, paired_note, paired_of, verdict, warned
from metapp.evaluation.tables.results import on_threads, result_row
from metapp.evaluation.tables.rows import LAST, Row, numbers, words
from metapp.evaluation.tables.subject import Cell, Subject
from metapp.evaluation.tables.table import Table
from metapp.runs.reporter import number
from metapp.runs.session import caption_of
from metapp.runs.statistics import apart

COMPARED = ("general", "quickft", "meta")


def cells(subject: Subject) -> list[Cell]:
    """General's, QuickFT's and Meta's fits."""
    return [subject.cell(name) for name in COMPARED]


def rows(subject: Subject) -> list[Row]:
    """The three, each with how far it is below QuickFT and on how many tasks it is ahead of it."""
    found = [result_row(subject, name) for name in COMPARED]
    for row in found:
        row["against_quickft"] = change(row, found[1]) if row is not found[1] else None
        row["apart"] = apart(paired_of(row, "quickft"))
    found[2]["ahead"] = found[2]["vs_quickft_ahead"]
    return found


def notes(subject: Subject, found: list[Row]) -> list[str]:
    """Who wins, on how many tasks, and in the paper."""
    by = {row["paradigm"]: row["paper_error"] for row in found}
    said = [verdict(found[2]), verdict(found[2], "general"), *warned(found)]
    if None not in (by["meta"], by["quickft"]):
        said.append(f"paper: meta {number(by['meta'], '.3f')}, quickft {number(by['quickft'], '.3f')}")
    said += [caption_of(subject.app), "quickft's Adam is searched on validation tasks"]
    return [*filter(None, said), *paired_note(found), *on_threads(found)]


TABLE = Table(
    "quickft",
    "mean error{factor} after as many steps",
    (
        words("paradigm", "paradigm"),
        numbers("error", "error", ".3f"),
        *paired_columns("quickft"),
        numbers("paper error", "paper_error", ".3f"),
        *LAST,
    ),
    cells,
    rows,
    notes,
)
