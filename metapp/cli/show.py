"""Tables of `metapp evaluate`, printed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.table import Table as RichTable
from rich.text import Text

from metapp.cli.console import escaped, out, print_json
from metapp.evaluation.table import Column, Row, Table, csv_of, flat, text_of

FEWEST_COLUMNS = 3  # are shown however narrow the terminal


def show(tables: Mapping[str, Sequence[Table]], form: str, which: str) -> None:
    """Print tables of several applications, by name, in a format other than rich; `which` was asked for."""
    if form in ("json", "csv"):
        several = len(tables) > 1
        pairs = [(name, row) for name, some in tables.items() for table in some for row in table.rows]
        rows = [flat(row) | ({"table": name} if several else {}) for name, row in pairs]
        if form == "csv":
            out().print(csv_of(rows), soft_wrap=True)
        else:
            print_json({"which": which, "rows": rows})
        return
    for some in tables.values():
        if some:
            out().print(text_of(some, form), soft_wrap=True)


def rich_table(table: Table) -> RichTable:
    """The table of one application for a terminal."""
    grid = RichTable(title=table.whole_title, caption=Text("\n".join(table.notes)), caption_justify="left")
    columns = fitting(table.columns, table.rows, out().width)
    for column in columns:
        right = bool(column.form)
        grid.add_column("\n".join(heading(column)), justify="right" if right else "left", no_wrap=right)
    for row in table.rows:
        grid.add_row(*(Text(escaped(column.text(row))) for column in columns))
    return grid


def heading(column: Column) -> list[str]:
    """A title on two lines if it is long: most columns are of short numbers."""
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
