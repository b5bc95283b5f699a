"""A table as markdown, LaTeX (booktabs), CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

from metapp.evaluation.rows import Row, Table
from metapp.evaluation.subject import Subject
from metapp.runs.naming import factor_of


def text_table(table: Table, by_subject: Sequence[tuple[Subject, list[Row]]], form: str) -> str:
    """The table of all applications as "markdown", "latex" or "csv"."""
    rows = [row for _, rows in by_subject for row in rows]
    if form == "csv":
        return csv_of(rows)
    header = ["app", *(column.title for column in table.columns)]
    body = [[key_of(row), *(column.text(row) for column in table.columns)] for row in rows]
    notes = [(key_of(rows[0]) if rows else subject.title, table.notes(subject, rows)) for subject, rows in by_subject]
    if form == "markdown":
        grid = [header, ["---"] * len(header), *body]
        below = [line for name, lines in notes for line in ("", f"{name}:", "", *(f"- {note}" for note in lines))]
        return "\n".join([*("| " + " | ".join(line) + " |" for line in grid), *below])
    escape = str.maketrans({"_": r"\_", "%": r"\%", "&": r"\&", "#": r"\#"})
    tex = [" & ".join(text.translate(escape) for text in line) + r" \\" for line in (header, *body)]
    align = "l" + "".join("l" if column.left else "r" for column in table.columns)
    below = [f"% {name}: {note}" for name, lines in notes for note in lines]
    top = [rf"\begin{{tabular}}{{{align}}}", r"\toprule", tex[0], r"\midrule"]
    return "\n".join([*top, *tex[1:], r"\bottomrule", r"\end{tabular}", *below])


def csv_of(rows: Sequence[Row]) -> str:
    """Rows with all they hold, whatever columns show."""
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, list(dict.fromkeys(key for row in rows for key in row)), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return buffer.getvalue().rstrip("\n")


def key_of(row: Row) -> str:
    """The application of a row, and its protocol, if any."""
    return f"{row['app']} {row.get('observe', '')}".rstrip()


def title_of(table: Table, subject: Subject, rows: list[Row]) -> str:
    """What a table shows, of what and of how many tasks."""
    count = max((row["tasks"] for row in rows), default=0)
    title = table.title.format(factor=factor_of(subject.app))
    return f"{subject.title}, {f'{count} unseen tasks: ' if count else ''}{title}"
