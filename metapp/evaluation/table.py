"""A table: columns, rows, notes, and its text as Markdown, LaTeX and CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from metapp.evaluation.error_statistics import PairedComparison
from metapp.storage import Document
from metapp.storage.fit_folders import Record

Row = Document  # all that is known of a method, whatever columns show; comparisons with another row are `PairedComparison`


class Column(NamedTuple):
    """A column of a table.

    Attributes:
        title: above it.
        key: of the entry that it shows; a dash if that is missing or None.
        form: a format of numbers, "" for words, which are aligned left, or a function of the row.
    """

    title: str
    key: str
    form: str | Callable[[Row], str] = ""

    def text(self, row: Row) -> str:
        """The entry of a row as this column shows it."""
        value = row.get(self.key)
        if value is None:
            return "-"
        return format(value, self.form) if isinstance(self.form, str) else self.form(row)


class Table(NamedTuple):
    """A table of one application under one protocol.

    Attributes:
        subject: title of the application.
        title: the figures that it shows.
        columns: from left to right, after the application's; a terminal shows as many as it has room for.
        rows: one a method; none if the application has nothing to show.
        notes: sentences on its columns and rows, which tables may share.
        fits: records of fits that a picture shows side by side, by the method's name.
        findings: sentences above it: the error's definition, and what it shows.
    """

    subject: str
    title: str
    columns: tuple[Column, ...]
    rows: list[Row]
    notes: list[str]
    fits: Mapping[str, list[Record]] = {}
    findings: Sequence[str] = ()

    @property
    def whole_title(self) -> str:
        """The title with the application and the number of tasks."""
        count = max((row["tasks"] for row in self.rows), default=0)
        return f"{self.subject}, {f'{count} unseen tasks: ' if count else ''}{self.title}"


def bytes_column(title: str, key: str) -> Column:
    """A column of bytes, to three digits."""

    def text(row: Row) -> str:
        for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
            if row[key] >= scale:
                return f"{row[key] / scale:.3g} {unit}"
        return f"{row[key]:.0f} B"

    return Column(title, key, text)


def comparison_columns(other: str) -> tuple[Column, Column]:
    """The columns that compare rows with another one."""
    key = f"vs_{other}"
    return (
        Column(f"vs {other}", key, lambda row: str(row[key])),
        Column("lower on", key, lambda row: f"{row[key].ahead}/{row[key].tasks}"),
    )


COMMON_COLUMNS = {
    "paradigm": (Column("paradigm", "paradigm"),),
    "rule": (Column("rule", "rule"),),
    "error": (Column("error", "error", lambda row: f"{row['error']:.3f}" + "*" * bool(row.get("few"))),),
    "seconds": (Column("seconds", "seconds", ".4f"),),
    "paper error": (Column("paper error", "paper_error", ".3f"),),
    "paper seconds": (Column("paper seconds", "paper_seconds", ".3f"),),
    "interval": (Column("95 % interval", "low", lambda row: f"{row['low']:.3f} .. {row['high']:.3f}"),),
    "steps": (Column("steps", "steps", "d"),),
    "median": (Column("median", "median", ".3f"),),
    "worst": (Column("worst", "worst", ".3f"),),
    "vs quickft": comparison_columns("quickft"),
    "vs meta": comparison_columns("meta"),
}


def columns(*items: str | Column) -> tuple[Column, ...]:
    """Columns from left to right, of COMMON if they are given by name."""
    return tuple(column for item in items for column in ([item] if isinstance(item, Column) else COMMON_COLUMNS[item]))


def flatten_row(row: Row) -> Row:
    """A row as JSON and CSV have it: `vs_<row>` is a comparison's value, `vs_<row>_low` and so on the rest of it."""
    plain: Row = {}
    for key, value in row.items():
        if key.startswith("vs_"):
            fields = value._asdict() if value else dict.fromkeys(PairedComparison._fields)
            plain |= {key if name == "value" else f"{key}_{name}": entry for name, entry in fields.items()}
        else:
            plain[key] = value
    return plain


def app_and_protocol(row: Row) -> str:
    """The application of a row, and its protocol, if any."""
    return f"{row['app']} {row.get('observe', '')}".rstrip()


def format_csv(rows: Sequence[Row]) -> str:
    """Rows, as of `flatten_row`, with all they hold, whatever columns show.

    >>> csv_of([{"app": "brdf", "error": 0.72}, {"app": "texture", "error": None}]).splitlines()
    ['app,error', 'brdf,0.72', 'texture,']
    """
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, list(dict.fromkeys(key for row in rows for key in row)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return buffer.getvalue().rstrip("\n")


def format_tables(tables: Sequence[Table], form: str) -> str:
    """The tables of several applications, of the same columns, as one in "markdown" or "latex"."""
    shown = tables[0].columns
    header = ["app", *(column.title for column in shown)]
    body = [[app_and_protocol(row), *(column.text(row) for column in shown)] for table in tables for row in table.rows]
    notes = [(app_and_protocol(table.rows[0]), [*table.findings, *table.notes]) for table in tables if table.rows]
    if form == "markdown":
        grid = [header, ["---"] * len(header), *body]
        below = [line for name, lines in notes for line in ("", f"{name}:", "", *(f"- {note}" for note in lines))]
        return "\n".join([*("| " + " | ".join(line) + " |" for line in grid), *below])
    escape = str.maketrans({"_": r"\_", "%": r"\%", "&": r"\&", "#": r"\#"})
    tex = [" & ".join(text.translate(escape) for text in line) + r" \\" for line in (header, *body)]
    align = "l" + "".join("r" if column.form else "l" for column in shown)
    below = [f"% {name}: {note}" for name, lines in notes for note in lines]
    top = [rf"\begin{{tabular}}{{{align}}}", r"\toprule", tex[0], r"\midrule"]
    return "\n".join([*top, *tex[1:], r"\bottomrule", r"\end{tabular}", *below])
