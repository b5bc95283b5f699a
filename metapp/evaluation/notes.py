"""Tables as text: titles, formats, and the notes below them that several share."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

from metapp.evaluation.rows import Row, Table, paired_of
from metapp.evaluation.subject import Subject
from metapp.runs.naming import factor_of
from metapp.runs.outputs.statistics import FEWEST, Paired, apart
from metapp.runs.reporter import number


def paired_note(rows: Sequence[Row], other: str = "quickft") -> list[str]:
    """A note on the columns that compare."""
    kinds = {pair.kind: pair.level for row in rows if (pair := paired_of(row, other))}
    return [
        f"vs {other}: {kind} of mean errors with a 95 % interval (paired bootstrap over tasks); below {level:g} means "
        "a lower error; lower on: tasks whose error is lower"
        for kind, level in sorted(kinds.items())
    ]


def change(one: Row, other: Row) -> str:
    """The difference of a row's error from another's, in percent of that: "12 % below"; "" where one is not known."""
    if one["error"] is None or not other["error"]:
        return ""
    percent = 100 * (one["error"] - other["error"]) / abs(other["error"])
    return f"{abs(percent):.0f} % {'above' if percent > 0 else 'below'}"


def compared_text(pair: Paired, other: str) -> str:
    """A comparison in words: error ratio 0.962 [0.952, 0.972] vs quickft, lower on 15 of 20 tasks."""
    return f"error {pair.kind} {pair} vs {other}, lower on {pair.ahead} of {pair.tasks} tasks"


def verdict(row: Row, other: str = "quickft") -> str:
    """The winner of a row's method and another: the one of the lower error, unless chance could be the reason."""
    pair, one = paired_of(row, other), row["paradigm"]
    if pair is None:
        return ""
    text, differ = f"{one}: {compared_text(pair, other)}", apart(pair)
    if differ is None:
        return f"{text}; {pair.groups} different tasks, fewer than {FEWEST}, are too few to call a win"
    if not differ:
        return f"{text}; no win"
    return f"{text}; {one if pair.value < pair.level else other} wins"


def warned(rows: Sequence[Row]) -> list[str]:
    """Counts of fits that end above their initialisation's loss or look doubtful, and of those that were guarded."""
    remarks = (
        ("warnings", "{} of {} fits ended above their initialisation's loss"),
        ("doubtful", "{} of {} fits look doubtful; their records say why, as `warning`"),
        ("guarded", "the guard acted on {} of {} tasks, which took twice the steps"),
    )
    return [
        f"{row['paradigm']}: {remark.format(row[key], row['tasks'])}"
        for key, remark in remarks
        for row in rows
        if row.get(key)
    ]


def measures_note(subject: Subject, rows: Sequence[Row]) -> list[str]:
    """The means of the further errors that the application states, a line each."""
    means_by_title = {
        title: [f"{row['paradigm']} {row[f'mean_{key}']:.3f}" for row in rows if row.get(f"mean_{key}") is not None]
        for key, title in subject.app.measures.items()
    }
    return [f"{title}: {', '.join(means)}" for title, means in means_by_title.items() if means]


def threads_note(rows: Sequence[Row]) -> list[str]:
    """The threads that seconds are of, where records say so."""
    counts = list(dict.fromkeys(row["threads"] for row in rows if row["threads"]))
    if len(counts) > 1:
        text = "; ".join(f"{row['paradigm']} {row['threads']}" for row in rows if row["threads"])
        return [f"threads: {text}; seconds of different threads do not compare"]
    return [f"threads: {count}" for count in counts]


def few_note(subject: Subject, rows: Sequence[Row] = ()) -> list[str]:
    """A note on the rows that are of some of the tasks, with the errors of all rows on these."""
    names = [name for name in subject.fits if subject.is_of_few(name)]
    if not names:
        return []
    errors = ", ".join(f"{row['paradigm']} {number(row['shared_error'], '.3f')}" for row in rows)
    where = f", where mean errors are {errors}" if errors else ""
    few = f"{len(subject.cell(names[0]).tasks)} of the {len(subject.tasks)} tasks, evenly spaced"
    return [f"* {', '.join(names)}: of {few}{where}; --whole measures all tasks"]


def carried(rows: Sequence[Row], error: str, seconds: str) -> tuple[float | None, float | None]:
    """The two figures that carry across data sets and machines: Meta's gap closed, and its speed-up over Overfit.

    There is no gap to close where Overfit is no better than General.
    """
    by_name = {row["paradigm"]: row for row in rows}
    general, overfit, meta = (by_name[name] for name in ("general", "overfit", "meta"))
    gap = speed = None
    if None not in (general[error], overfit[error], meta[error]) and overfit[error] < general[error]:
        gap = (general[error] - meta[error]) / (general[error] - overfit[error])
    if None not in (overfit[seconds], meta[seconds]):
        speed = overfit[seconds] / meta[seconds]
    return gap, speed


# Formats


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
    """The title of a table, with its subject and number of tasks."""
    count = max((row["tasks"] for row in rows), default=0)
    title = table.title.format(factor=factor_of(subject.app))
    return f"{subject.title}, {f'{count} unseen tasks: ' if count else ''}{title}"
