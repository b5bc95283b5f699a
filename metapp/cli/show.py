"""A table of `metapp evaluate` for a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rich.table import Table as RichTable
from rich.text import Text

from metapp.cli.console import out
from metapp.evaluation.notes import title_of
from metapp.evaluation.rows import Column, Row, Table
from metapp.evaluation.subject import Subject

FEWEST_COLUMNS = 3  # are shown however narrow the terminal


def rich_table(table: Table, subject: Subject, rows: list[Row]) -> Any:
    """The table of one application for a terminal."""
    shown = RichTable(title=title_of(table, subject, rows), caption=Text("\n".join(table.notes(subject, rows))))
    columns = fitting(table.columns, rows, out().width)
    for column in columns:
        left = column.left
        shown.add_column("\n".join(heading(column)), justify="left" if left else "right", no_wrap=not left)
    for row in rows:
        shown.add_row(*(Text(column.text(row)) for column in columns))
    return shown


def heading(column: Column) -> list[str]:
    """A title on two lines where it is long: most columns are of short numbers."""
    first, _, last = column.title.rpartition(" ")
    return [first, last] if first and len(column.title) > 9 else [column.title]


def fitting(columns: Sequence[Column], rows: Sequence[Row], width: int) -> Sequence[Column]:
    """As many columns, from the left, as a terminal of that many characters has room for."""
    total = 1
    for i, column in enumerate(columns):
        total += max(map(len, [*heading(column), *(column.text(row) for row in rows)])) + 3
        if total > width and i >= FEWEST_COLUMNS:
            return columns[:i]
    return columns
