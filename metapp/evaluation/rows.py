"""Rows of tables, and sentences about them. Figures come from records, the paper's from `paper.json`."""

from __future__ import annotations

import functools
import json
import statistics
from collections.abc import Sequence
from importlib import resources

from metapp.apps import is_first_protocol, protocol_entry
from metapp.evaluation.error_statistics import (
    MIN_TASK_GROUPS,
    ErrorsByTask,
    PairedComparison,
    compare_errors,
    is_significant,
    summarise_errors,
)
from metapp.evaluation.subject import EvaluationRun
from metapp.evaluation.table import Row
from metapp.learning.app import App
from metapp.runs.fitting import LOSS_ROSE_CLAUSE
from metapp.storage import Document
from metapp.storage.fit_folders import Record, count_guarded


@functools.cache
def paper_figures() -> Document:
    """The paper's figures, with their places in it."""
    result: Document = json.loads((resources.files("metapp") / "paper.json").read_text())
    return result


def make_row(
    subject: EvaluationRun,
    name: str,
    records: Sequence[Record],
    entries: Row,
    against: Sequence[str] = (),
) -> Row:
    """A row of records, with the statistics of their errors.

    Args:
        subject: of which application.
        name: the paradigm, as the row calls it.
        records: of tasks; another measure may stand in them as `error`.
        entries: further or other entries.
        against: rows of the results whose errors of the same tasks it is compared with, as `vs_<row>`.
    """
    app, groups = subject.app, subject.groups
    clauses = [record["warning"].split("; ") for record in records if record.get("warning")]
    of_measures = {key: [record[key] for record in records if key in record] for key in app.error_measure.further}
    seconds = [record["seconds"] for record in records if "seconds" in record]
    row = {
        "app": app.name,
        "paradigm": name,
        **protocol_entry(app),
        **summarise_errors(errors_by_task(records), groups),
        "seconds": statistics.median(seconds) if seconds else None,
        "tasks": len(records),
        "warnings": sum(some[0].startswith(LOSS_ROSE_CLAUSE) for some in clauses),
        "doubtful": sum(not some[-1].startswith(LOSS_ROSE_CLAUSE) for some in clauses),
        "guarded": count_guarded(records),
        "threads": ", ".join(map(str, sorted({one["threads"] for one in records if one.get("threads")}))) or None,
        "paper_error": None,
        "paper_seconds": None,
        **{f"mean_{key}": statistics.fmean(values) if values else None for key, values in of_measures.items()},
        **entries,
        **app.conditions(),
    }
    for other in against:
        theirs = errors_by_task(subject.records(other)) if other != name else {}
        row[f"vs_{other}"] = compare_errors(
            errors_by_task(records), theirs, groups, logarithmic=app.error_measure.logarithmic
        )
    return row


def paper_entries(app: App, name: str) -> Row:
    """The paper's figures of a paradigm, under the paper's protocol."""
    figures = paper_figures() if is_first_protocol(app) else {}
    return {f"paper_{key}": figures.get(key, {}).get(app.name, {}).get(name) for key in ("error", "seconds")}


def errors_by_task(records: Sequence[Record]) -> ErrorsByTask:
    """The errors of records, by the task's name, of those that have one."""
    return {record["name"]: record["error"] for record in records if record["error"] is not None}


# Sentences


def comparison_notes(rows: Sequence[Row], other: str = "quickft") -> list[str]:
    """Notes on rows that are compared with another: comparisons, threads, fits that went wrong."""
    return [*paired_columns_note(rows, other), *_threads_note(rows), *fit_remarks(rows)]


def paired_columns_note(rows: Sequence[Row], other: str = "quickft") -> list[str]:
    """A note on the columns that compare."""
    kinds = {pair.kind: pair.level for row in rows if (pair := row[f"vs_{other}"])}
    return [
        f"vs {other}: {kind} of mean errors, 95 % interval by paired bootstrap; below {level:g}: a lower error"
        for kind, level in sorted(kinds.items())
    ]


def comparison_text(pair: PairedComparison, other: str) -> str:
    """A comparison in words: error ratio 0.962 [0.952, 0.972] vs quickft, lower on 15 of 20 tasks."""
    return f"error {pair.kind} {pair} vs {other}, lower on {pair.ahead} of {pair.tasks} tasks"


def describe_winner(row: Row, other: str = "quickft") -> list[str]:
    """The winner of a row's method and another: the one of the lower error, unless chance could be the reason."""
    pair: PairedComparison | None = row[f"vs_{other}"]
    if pair is None:
        return []
    winner = row["paradigm"] if pair.value < pair.level else other
    says = {
        None: f"{pair.groups} different tasks, fewer than {MIN_TASK_GROUPS}, are too few to call a win",
        False: "no win",
        True: f"{winner} wins",
    }
    return [f"{row['paradigm']}: {comparison_text(pair, other)}; {says[is_significant(pair)]}"]


def fit_remarks(rows: Sequence[Row]) -> list[str]:
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


def measures_note(subject: EvaluationRun, rows: Sequence[Row]) -> list[str]:
    """The means of the further errors that the application states, a line each."""
    means_by_title = {
        title: [f"{row['paradigm']} {row[f'mean_{key}']:.3f}" for row in rows if row[f"mean_{key}"] is not None]
        for key, title in subject.app.error_measure.further.items()
    }
    return [f"{title}: {', '.join(means)}" for title, means in means_by_title.items() if means]


def _threads_note(rows: Sequence[Row]) -> list[str]:
    """The threads that seconds are of, if records say so."""
    by_count: dict[str, list[str]] = {}
    for row in rows:
        if row["threads"]:
            by_count.setdefault(row["threads"], []).append(row["paradigm"])
    if len(by_count) > 1:
        text = "; ".join(f"{', '.join(names)} {count}" for count, names in by_count.items())
        return [f"threads: {text}; seconds of different threads do not compare"]
    return [f"threads: {count}" for count in by_count]


def subset_note(subject: EvaluationRun) -> list[str]:
    """A note on the rows that are of some of the tasks."""
    names = [name for name in subject.runs if subject.is_of_few(name)]
    count = len(subject.tasks_of(names[0])) if names else 0
    return [f"*: on {count} evenly spaced tasks; --whole measures all"] if names else []


def scale_free_figures(rows: Sequence[Row], error: str, seconds: str) -> tuple[float | None, float | None]:
    """The two figures that carry across data sets and machines: Meta's gap closed, and its speed-up over Overfit.

    There is no gap to close if Overfit is no better than General.
    """
    by_name = {row["paradigm"]: row for row in rows}
    general, overfit, meta = (by_name[name] for name in ("general", "overfit", "meta"))
    gap = speed = None
    if None not in (general[error], overfit[error], meta[error]) and overfit[error] < general[error]:
        gap = (general[error] - meta[error]) / (general[error] - overfit[error])
    if None not in (overfit[seconds], meta[seconds]):
        speed = overfit[seconds] / meta[seconds]
    return gap, speed
