"""Tables of `metapp evaluate`, printed."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Table as RichTable
from rich.text import Text

from metapp.cli.console import escaped, out, print_json
from metapp.evaluation.notes import csv_of, text_table, title_of
from metapp.evaluation.rows import Column, Row, Table
from metapp.evaluation.subject import Subject
from metapp.evaluation.tables import ALL

FEWEST_COLUMNS = 3  # are shown however narrow the terminal


def show(tables: list[Table], subjects: list[Subject], form: str) -> None:
    """Print tables in a format."""
    several = len(tables) > 1
    by_table = {table.name: [(one, rows) for one in subjects if (rows := table.rows(one))] for table in tables}
    if form in ("json", "csv"):
        rows = [
            row | ({"table": name} if several else {})
            for name in by_table
            for _, some in by_table[name]
            for row in some
        ]
        if form == "csv":
            out().print(csv_of(rows), soft_wrap=True)
        else:
            print_json({"which": ALL if several else tables[0].name, "rows": rows})
        return
    for table in tables:
        if form == "rich":
            for subject, rows in by_table[table.name]:
                out().print(rich_table(table, subject, rows))
        else:
            out().print(text_table(table, by_table[table.name], form), soft_wrap=True)


def rich_table(table: Table, subject: Subject, rows: list[Row]) -> RichTable:
    """The table of one application for a terminal."""
    grid = RichTable(title=title_of(table, subject, rows), caption=Text("\n".join(table.notes(subject, rows))))
    columns = fitting(table.columns, rows, out().width)
    for column in columns:
        left = column.left
        grid.add_column("\n".join(heading(column)), justify="left" if left else "right", no_wrap=not left)
    for row in rows:
        grid.add_row(*(Text(escaped(column.text(row))) for column in columns))
    return grid


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
