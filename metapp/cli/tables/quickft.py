"""The paper's table of equal steps: is Meta more than a quick fine-tuning of General?"""

from __future__ import annotations

from metapp.cli.console import number
from metapp.cli.fit import caption_of
from metapp.cli.tables import Row, Table, interval, numbers, words
from metapp.cli.tables.results import result_row
from metapp.cli.tables.statistics import change, overlap, verdict
from metapp.cli.tables.subject import Cell, Subject

COMPARED = ("general", "quickft", "meta")


def cells(subject: Subject) -> list[Cell]:
    """General's, QuickFT's and Meta's fits."""
    return [subject.cell(name) for name in COMPARED]


def rows(subject: Subject) -> list[Row]:
    """The three, each with how far it is below QuickFT and on how many tasks Meta is ahead of it."""
    found = [result_row(subject, name) for name in COMPARED]
    quickft, meta = ({r["name"]: r["error"] for r in subject.cell(name).records()} for name in COMPARED[1:])
    both = [name for name in meta if None not in (meta[name], quickft.get(name))]
    for row in found:
        row["against_quickft"] = change(row, found[1]) if row is not found[1] else None
        row["apart"] = None if (tied := overlap(row, found[1])) is None or row is found[1] else not tied
    found[2]["ahead"] = sum(meta[name] < quickft[name] for name in both) if both else None
    return found


def notes(subject: Subject, found: list[Row]) -> list[str]:
    """Who wins, on how many tasks, and in the paper."""
    by = {row["paradigm"]: row["paper_error"] for row in found}
    ahead = found[2]["ahead"]
    said = [verdict(found)]
    said += [f"meta is ahead on {ahead} of {found[2]['tasks']} tasks"] if ahead is not None else []
    if None not in (by["meta"], by["quickft"]):
        said.append(f"paper: meta {number(by['meta'], '.3f')}, quickft {number(by['quickft'], '.3f')}")
    return [*filter(None, said), caption_of(subject.app), "quickft's Adam is searched on validation tasks"]


TABLE = Table(
    "quickft",
    "mean error{factor} after as many steps",
    (
        words("paradigm", "paradigm"),
        numbers("error", "error", ".3f"),
        words("against quickft", "against_quickft"),
        interval(),
        numbers("paper error", "paper_error", ".3f"),
        numbers("steps", "steps", "d"),
        numbers("seconds", "seconds", ".4f"),
        numbers("median", "median", ".3f"),
        numbers("worst", "worst", ".3f"),
    ),
    5,
    cells,
    rows,
    notes,
)
