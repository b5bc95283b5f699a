"""The report of `metapp evaluate`: tables as Markdown, with links to the figures."""

from __future__ import annotations

import functools
import re
from collections.abc import Sequence
from pathlib import Path

from metapp.evaluation.figures import write_figures
from metapp.evaluation.notes import text_table
from metapp.evaluation.rows import Table
from metapp.evaluation.subject import Subject
from metapp.storage.files import write_atomically

REPORT = "index.md"


def write_report(subjects: Sequence[Subject], folder: Path, tables: Sequence[Table]) -> Path:
    """Write figures and these tables, of what has been measured so far.

    Returns:
        The Markdown file.
    """
    parts = ["# Tables and figures"]
    for table in tables:
        measured = [(subject, rows) for subject in subjects if (rows := table.rows(subject))]
        content = text_table(table, measured, "markdown") if measured else "Not measured yet."
        parts += [f"## {table.heading or table.name}", content]
    for file, caption in write_figures(subjects, folder).items():
        text = re.sub(r"[\\`*_{}\[\]<>&!#|~$]", r"\\\g<0>", caption)  # names of tasks are no markup
        parts += [f"## {file.stem}", f"![{text}]({file.name})", text]
    content = "\n\n".join(parts) + "\n"
    write = functools.partial(Path.write_text, data=content, encoding="utf-8", errors="backslashreplace")
    write_atomically(folder / REPORT, write)
    return folder / REPORT
