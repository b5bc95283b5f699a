"""Tables, their columns and rows. Nothing is typed in: figures come from records, the paper's from `paper.json`."""

from __future__ import annotations

import functools
import json
import statistics
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

from metapp.evaluation.cell import Cell
from metapp.evaluation.subject import Subject
from metapp.runs.fitting import ROSE
from metapp.runs.naming import is_first_protocol, observe_of
from metapp.runs.outputs.statistics import Errors, Paired, paired, statistics_of
from metapp.runs.reporter import number
from metapp.storage import Document
from metapp.storage.fits import Record, guarded

Row = Document
Take = Callable[[Record], float | None]  # a measure of a record; None where it has none


class Column(NamedTuple):
    """A column of a table.

    Attributes:
        title: above it.
        text: a row as this column shows it.
        left: align left, as words are.
    """

    title: str
    text: Callable[[Row], str]
    left: bool = False


def _none(subject: Subject) -> list[Any]:
    """No cells and no rows: of a table for which nothing has to be run, or that no figure shows."""
    return []


def _nothing(*_: object) -> None:
    """No picture of a table."""


class Table(NamedTuple):
    """One of the paper's tables, for any application.

    Attributes:
        name: a value of --which.
        title: what it shows, after the application's title; {factor} stands for the factor of its errors.
        columns: from left to right, after the application's; a terminal shows as many as it has room for.
        rows: of what has been measured so far.
        notes: what must be said below it.
        cells: what must have been measured.
        heading: above it in the report; "" for its name.
        picture: draws the fits that it compares side by side, where there are any.
        plane: further rows of the quality-speed plane.
    """

    name: str
    title: str
    columns: tuple[Column, ...]
    rows: Callable[[Subject], list[Row]]
    notes: Callable[[Subject, list[Row]], list[str]]
    cells: Callable[[Subject], list[Cell]] = _none
    heading: str = ""
    picture: Callable[[Subject], Path | None] = _nothing
    plane: Callable[[Subject], list[Row]] = _none


# Columns


def numbers(title: str, key: str, form: str) -> Column:
    """A column of numbers; a dash where there is none."""
    return Column(title, lambda row: number(row.get(key), form))


def words(title: str, key: str) -> Column:
    """A column of words."""
    return Column(title, lambda row: "-" if row.get(key) is None else str(row[key]), left=True)


def bytes_column(title: str, key: str) -> Column:
    """A column of bytes, to three digits; a dash where they are not known."""

    def text(row: Row) -> str:
        value = row[key]
        if value is None:
            return "-"
        for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
            if value >= scale:
                return f"{value / scale:.3g} {unit}"
        return f"{value:.0f} B"

    return Column(title, text)


def paired_columns(other: str) -> tuple[Column, Column]:
    """The columns that compare rows with another method."""

    def text(row: Row) -> str:
        pair = paired_of(row, other)
        return str(pair) if pair else "-"

    def lower(row: Row) -> str:
        pair = paired_of(row, other)
        return f"{pair.ahead}/{pair.tasks}" if pair else "-"

    return Column(f"vs {other}", text), Column("lower on", lower)


COMMON = {
    "paradigm": words("paradigm", "paradigm"),
    "rule": words("rule", "rule"),
    "error": Column("error", lambda row: number(row["error"], ".3f") + "*" * bool(row.get("few"))),
    "seconds": numbers("seconds", "seconds", ".4f"),
    "paper error": numbers("paper error", "paper_error", ".3f"),
    "paper seconds": numbers("paper seconds", "paper_seconds", ".3f"),
    "interval": Column(
        "95 % interval", lambda row: "-" if row["low"] is None else f"{row['low']:.3f} .. {row['high']:.3f}"
    ),
    "steps": numbers("steps", "steps", "d"),
    "median": numbers("median", "median", ".3f"),
    "worst": numbers("worst", "worst", ".3f"),
}


def columns(*names: str | Column) -> tuple[Column, ...]:
    """Columns from left to right, those that tables share by name; "vs <row>" are two, which compare with that row."""
    result: list[Column] = []
    for name in names:
        if isinstance(name, Column):
            result.append(name)
        else:
            result += paired_columns(name.removeprefix("vs ")) if name.startswith("vs ") else [COMMON[name]]
    return tuple(result)


# Rows


@functools.cache
def paper() -> Document:
    """The paper's figures, with where they stand in it."""
    result: Document = json.loads((resources.files("metapp") / "paper.json").read_text())
    return result


def blank(app: str, paradigm: str, *, beside_paper: bool = True, **entries: object) -> Row:
    """A row of which nothing is known yet but the paper's figures; all rows have these keys."""
    figures = paper() if beside_paper else {"error": {}, "seconds": {}}
    return {
        "app": app,
        "paradigm": paradigm,
        "error": None,
        "seconds": None,
        "tasks": 0,
        "warnings": 0,
        "doubtful": 0,
        "guarded": None,
        "threads": None,
        "low": None,
        "high": None,
        "paper_error": figures["error"].get(app, {}).get(paradigm),
        "paper_seconds": figures["seconds"].get(app, {}).get(paradigm),
        **entries,
    }


def row_of(
    subject: Subject,
    name: str,
    cells: Sequence[Cell],
    entries: Row,
    *,
    take: Take | None = None,
    against: Mapping[str, Sequence[Cell]] | None = None,
    beside_paper: bool = True,
) -> Row:
    """A row of what cells have measured, with the statistics of one measure.

    Args:
        subject: of which application.
        name: the paradigm, as the row calls it.
        cells: one of each seed of training.
        entries: further or other entries.
        take: the measure; None for the table's error.
        against: the cells that it is compared with, by name, in the same way; () for a comparison that is None.
        beside_paper: whether the paper has a figure for it, where fits see what the paper's do.
    """
    app, records = subject.app, [record for cell in cells for record in cell.records()]
    groups = {task.name: task.group or task.name for task in cells[0].tasks}
    seconds = [record["seconds"] for record in records if "seconds" in record]
    of_paper = beside_paper and is_first_protocol(app) and not name.startswith("meta:")
    row = blank(app.name, name, beside_paper=of_paper, **observe_of(app))
    row |= statistics_of(values_of(cells[0], take), groups)
    row |= {"seconds": statistics.median(seconds) if seconds else None, "tasks": len(cells[0].records())}
    row |= remarks(records) | means_of(subject, records) | entries | app.conditions()
    logarithmic, ours = subject.app.logarithmic, values_of(cells[0])
    for other, others in (against or {}).items():
        theirs = [values_of(cell) for cell in others]
        row |= paired_entries(other, paired(ours, theirs[0], groups, logarithmic=logarithmic) if theirs else None)
    return row


def means_of(subject: Subject, records: Sequence[Record]) -> Row:
    """The means of the further errors that the application states, `mean_<name>`, of records that have them."""
    by_measure = {key: [record[key] for record in records if key in record] for key in subject.app.measures}
    return {f"mean_{key}": statistics.fmean(values) if values else None for key, values in by_measure.items()}


def values_of(cell: Cell, take: Take | None = None) -> Errors:
    """A measure of a cell's records, by the task's name, of those that have it; None for the table's error."""
    take = take or (lambda record: record["error"])
    return {record["name"]: value for record in cell.records() if (value := take(record)) is not None}


def against(subject: Subject, name: str, *others: str) -> dict[str, list[Cell]]:
    """The fits of other rows that a row of that name is compared with, but not with itself."""
    return {other: [subject.cell(other)] if other != name else [] for other in others}


def remarks(records: Sequence[Record]) -> Row:
    """Counts of warnings by kind and of fits on which the guard acted, and the threads, where records say."""
    clauses = [record["warning"].split("; ") for record in records if record.get("warning")]
    threads = sorted({record["threads"] for record in records if record.get("threads")})
    return {
        "warnings": sum(some[0].startswith(ROSE) for some in clauses),
        "doubtful": sum(not some[-1].startswith(ROSE) for some in clauses),
        "guarded": guarded(records),
        "threads": ", ".join(map(str, threads)) or None,
    }


def paired_entries(other: str, pair: Paired | None) -> Row:
    """A comparison as entries of a row: `vs_<other>` and so on, None where there is none."""
    values = pair._asdict() if pair else dict.fromkeys(Paired._fields)
    named = {f"vs_{other}_{key}": value for key, value in values.items() if key != "value"}
    return {f"vs_{other}": values["value"], **named}


def paired_of(row: Row, other: str) -> Paired | None:
    """The inverse of `paired_entries`."""
    if row.get(f"vs_{other}") is None:
        return None
    return Paired(row[f"vs_{other}"], *(row[f"vs_{other}_{key}"] for key in Paired._fields[1:]))
