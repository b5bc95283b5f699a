"""The paper's table of equal steps: is Meta more than a quick fine-tuning of General?"""

from __future__ import annotations

from metapp.evaluation.cell import Cell
from metapp.evaluation.notes import change, paired_note, threads_note, verdict, warned
from metapp.evaluation.rows import Row, Table, columns, paired_of
from metapp.evaluation.subject import Subject
from metapp.evaluation.tables.results import result_row
from metapp.runs.naming import caption_of
from metapp.runs.reporter import number
from metapp.runs.statistics import apart

COMPARED = ("general", "quickft", "meta")


def cells(subject: Subject) -> list[Cell]:
    """General's, QuickFT's and Meta's fits."""
    return [subject.cell(name) for name in COMPARED]


def rows(subject: Subject) -> list[Row]:
    """The three, each with how far its error is from QuickFT's and on how many tasks it is lower."""
    all_rows = [result_row(subject, name) for name in COMPARED]
    _, quickft, meta = all_rows
    for row in all_rows:
        row["against_quickft"] = change(row, quickft) if row is not quickft else None
        row["apart"] = apart(paired_of(row, "quickft"))
    meta["ahead"] = meta["vs_quickft_ahead"]
    return all_rows


def notes(subject: Subject, all_rows: list[Row]) -> list[str]:
    """Who wins, on how many tasks, and in the paper."""
    _, quickft, meta = all_rows
    lines = [verdict(meta), verdict(meta, "general"), *warned(all_rows)]
    if None not in (meta["paper_error"], quickft["paper_error"]):
        errors = {row["paradigm"]: number(row["paper_error"], ".3f") for row in (meta, quickft)}
        lines.append(f"paper: meta {errors['meta']}, quickft {errors['quickft']}")
    lines += [caption_of(subject.app), "quickft's Adam is searched on validation tasks"]
    return [*filter(None, lines), *paired_note(all_rows), *threads_note(all_rows)]


COLUMNS = columns(
    *("paradigm", "error", "vs quickft", "paper error", "interval", "steps", "seconds", "median", "worst")
)
TABLE = Table("quickft", "mean error{factor} after as many steps", COLUMNS, rows, notes, cells)
