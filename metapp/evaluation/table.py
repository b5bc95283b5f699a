"""A table as data: columns, rows and notes, and its text as Markdown, LaTeX and CSV.

A column is a function of a row, so that all tables share their columns and all formats show equal text. The module
knows neither how rows are made nor how a terminal draws a table.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from metapp.evaluation.error_statistics import PairedComparison
from metapp.runs.fit import Fit
from metapp.storage import Document

# All that is known of a method, whatever columns show. Its comparisons with another row are PairedComparison.
Row = Document


class Column(NamedTuple):
    """A column of a table.

    Attributes:
        title: the words above it.
        key: the key of the row's entry that it shows; a dash stands for an entry that is missing or None.
        form: a format of numbers, or "" for words, which are aligned left, or a function from the row to its text.
        is_optional: whether the column is left out where no row has an entry for it, as those of the paper's figures.
    """

    title: str
    key: str
    form: str | Callable[[Row], str] = ""
    is_optional: bool = False

    def text(self, row: Row) -> str:
        """Return the text that this column shows for a row."""
        value = row.get(self.key)
        if value is None:
            return "-"
        return format(value, self.form) if isinstance(self.form, str) else self.form(row)


class Table(NamedTuple):
    """A table of one application, whose fits all see the same.

    Attributes:
        app_title: the application's title.
        title: what the figures of the table are.
        columns: the columns from left to right, after the application's, see :func:`filled_columns`; a terminal shows
            as many as it has room for.
        rows: a row for each method; empty if the application has nothing to show.
        notes: sentences on columns and rows, which tables may share.
        fits: fits that a picture shows side by side, by the method's name.
        findings: sentences above the table: the error's definition, and what the table shows.
    """

    app_title: str
    title: str
    columns: tuple[Column, ...]
    rows: list[Row]
    notes: list[str]
    fits: Mapping[str, list[Fit]] = {}
    findings: Sequence[str] = ()

    @property
    def full_title(self) -> str:
        """The title with the application and the number of tasks."""
        count = max((row["tasks"] for row in self.rows), default=0)
        return f"{self.app_title}, {f'{count} unseen tasks: ' if count else ''}{self.title}"


def filled_columns(tables: Sequence[Table]) -> tuple[Column, ...]:
    """Return the columns that tables of equal columns show: all but optional ones in which every row has a dash."""
    rows = [row for table in tables for row in table.rows]
    return tuple(
        column
        for column in tables[0].columns
        if not column.is_optional or any(row.get(column.key) is not None for row in rows)
    )


def bytes_column(title: str, key: str) -> Column:
    """Make a column of byte counts, to three digits with a unit."""

    def text(row: Row) -> str:
        for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
            if row[key] >= scale:
                return f"{row[key] / scale:.3g} {unit}"
        return f"{row[key]:.0f} B"

    return Column(title, key, text)


def comparison_columns(compared_row: str) -> tuple[Column, Column]:
    """Make the two columns that compare rows with another row: by error, and by the tasks it is lower on."""
    key = f"vs_{compared_row}"
    return (
        Column(f"vs {compared_row}", key, lambda row: str(row[key])),
        Column("lower on", key, lambda row: f"{row[key].ahead}/{row[key].tasks}"),
    )


COMMON_COLUMNS = {
    "paradigm": (Column("paradigm", "paradigm"),),
    "rule": (Column("rule", "rule"),),
    "error": (Column("error", "error", lambda row: f"{row['error']:.3f}" + "*" * bool(row.get("few"))),),
    "seconds": (Column("seconds", "seconds", ".4f"),),
    "paper error": (Column("paper error", "paper_error", ".3f", is_optional=True),),
    "paper seconds": (Column("paper seconds", "paper_seconds", ".3f", is_optional=True),),
    "interval": (Column("95 % interval", "low", lambda row: f"{row['low']:.3f} .. {row['high']:.3f}"),),
    "steps": (Column("steps", "steps", "d"),),
    "median": (Column("median", "median", ".3f"),),
    "worst": (Column("worst", "worst", ".3f"),),
    "vs quickft": comparison_columns("quickft"),
    "vs meta": comparison_columns("meta"),
}


def columns(*names_or_columns: str | Column) -> tuple[Column, ...]:
    """Return columns from left to right; names stand for columns of COMMON_COLUMNS."""
    return tuple(
        column
        for name_or_column in names_or_columns
        for column in ([name_or_column] if isinstance(name_or_column, Column) else COMMON_COLUMNS[name_or_column])
    )


def flatten_row(row: Row) -> Row:
    """Return a row as JSON and CSV have it, with plain numbers for comparisons.

    A comparison's value stands under `vs_<row>`, its other fields under `vs_<row>_low` and so on.
    """
    flat_row: Row = {}
    for key, value in row.items():
        if key.startswith("vs_"):
            fields = value._asdict() if value else dict.fromkeys(PairedComparison._fields)
            flat_row |= {key if name == "value" else f"{key}_{name}": entry for name, entry in fields.items()}
        else:
            flat_row[key] = value
    return flat_row


def full_app_name(row: Row) -> str:
    """Return the name of a row's application, with what fits see, if that may differ."""
    return f"{row['app']} {row.get('observe', '')}".rstrip()


def format_csv(rows: Sequence[Row]) -> str:
    """Format rows as CSV, with all their entries, whatever columns show.

    Args:
        rows: rows that :func:`flatten_row` returned.

    >>> format_csv([{"app": "brdf", "error": 0.72}, {"app": "texture", "error": None}]).splitlines()
    ['app,error', 'brdf,0.72', 'texture,']
    """
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, list(dict.fromkeys(key for row in rows for key in row)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return buffer.getvalue().rstrip("\n")


def format_tables(tables: Sequence[Table], form: str) -> str:
    """Format tables of several applications, which have equal columns, as one table.

    Args:
        tables: the tables.
        form: "markdown" or "latex".
    """
    shown_columns = filled_columns(tables)
    header = ["app", *(column.title for column in shown_columns)]
    body = [
        [full_app_name(row), *(column.text(row) for column in shown_columns)] for table in tables for row in table.rows
    ]
    notes = [(full_app_name(table.rows[0]), [*table.findings, *table.notes]) for table in tables if table.rows]
    if form == "markdown":
        grid = [header, ["---"] * len(header), *body]
        note_lines = [line for name, lines in notes for line in ("", f"{name}:", "", *(f"- {note}" for note in lines))]
        return "\n".join([*("| " + " | ".join(line) + " |" for line in grid), *note_lines])
    escape = str.maketrans({"_": r"\_", "%": r"\%", "&": r"\&", "#": r"\#"})
    row_lines = [" & ".join(text.translate(escape) for text in line) + r" \\" for line in (header, *body)]
    align = "l" + "".join("r" if column.form else "l" for column in shown_columns)
    note_lines = [f"% {name}: {note}" for name, lines in notes for note in lines]
    head_lines = [rf"\begin{{tabular}}{{{align}}}", r"\toprule", row_lines[0], r"\midrule"]
    return "\n".join([*head_lines, *row_lines[1:], r"\bottomrule", r"\end{tabular}", *note_lines])
