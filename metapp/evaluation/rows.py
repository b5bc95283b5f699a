"""Rows of tables, made of fits, and sentences about rows.

A row holds all that is known of a method; which of its entries a table shows is decided in
:mod:`metapp.evaluation.table`. The paper's own figures come from the file `paper.json`.
"""

from __future__ import annotations

import functools
import json
import statistics
from collections.abc import Sequence
from importlib import resources
from typing import Any

from metapp.evaluation.error_statistics import (
    MIN_TASK_GROUPS,
    ErrorsByTask,
    PairedComparison,
    compare_errors,
    is_significant,
    summarise_errors,
)
from metapp.evaluation.evaluation_run import EvaluationRun
from metapp.evaluation.table import Row
from metapp.runs.fit import Fit
from metapp.runs.fit_tables import count_guarded
from metapp.runs.fitting import LOSS_ROSE_CLAUSE
from metapp.storage import Document

# CPU seconds of fits over their seconds, below which a note says that other programs took the CPU: on an idle machine a
# fit by one thread has 1.0
MIN_CPU_SHARE = 0.8


@functools.cache
def paper_figures() -> Document:
    """Return the paper's figures, with the places in the paper where they stand."""
    figures: Document = json.loads((resources.files("metapp") / "paper.json").read_text())
    return figures


def make_row(
    evaluation: EvaluationRun,
    name: str,
    fits: Sequence[Fit],
    entries: Row,
    compared_rows: Sequence[str] = (),
) -> Row:
    """Make a row of fits, with the statistics of their errors.

    Args:
        evaluation: the application, with its tasks and fits.
        name: the name of the row's method, such as a paradigm.
        fits: fits of tasks; their `error` may hold another measure than the application's error.
        entries: further entries. They replace figures of fits that have the same names, such as `tasks`; but not the
            application's recorded conditions, nor the entries `vs_<name>`.
        compared_rows: names of rows of the results. For each there is an entry `vs_<name>`, the comparison of errors
            with that row's on the same tasks. It is None if the row would be compared with itself, or if
            :func:`compare_errors` returns no comparison, as when there is no common task.
    """
    app, groups = evaluation.app, evaluation.groups
    # A warning is a list of clauses. If one says that the loss rose, it is the first; all others doubt the fit.
    warnings = [fit.warning.split("; ") for fit in fits if fit.warning]
    measure_values = {
        key: [value for fit in fits if (value := fit.further_errors.get(key)) is not None]
        for key in app.error_measure.further
    }
    seconds = [fit.seconds for fit in fits if fit.seconds is not None]
    times = [(fit.cpu_seconds, fit.seconds) for fit in fits]
    known_times = [(cpu, whole) for cpu, whole in times if cpu is not None and whole]
    row = {
        "app": app.name,
        "paradigm": name,
        **app.observation,
        "scale": app.error_measure.scale,
        **summarise_errors(errors_by_task(fits), groups),
        "seconds": statistics.median(seconds) if seconds else None,
        "tasks": len(fits),
        "warnings": sum(clauses[0].startswith(LOSS_ROSE_CLAUSE) for clauses in warnings),
        "doubtful": sum(not clauses[-1].startswith(LOSS_ROSE_CLAUSE) for clauses in warnings),
        "guarded": count_guarded(fits),
        "threads": ", ".join(map(str, sorted({fit.threads for fit in fits if fit.threads}))) or None,
        "cpu_share": (
            sum(cpu for cpu, _ in known_times) / sum(whole for _, whole in known_times) if known_times else None
        ),
        "paper_error": None,
        "paper_seconds": None,
        **{f"mean_{key}": statistics.fmean(values) if values else None for key, values in measure_values.items()},
        **entries,
        **app.recorded_conditions(),
    }
    for compared_row in compared_rows:
        other_errors = errors_by_task(evaluation.fits(compared_row)) if compared_row != name else {}
        row[f"vs_{compared_row}"] = compare_errors(
            errors_by_task(fits), other_errors, groups, logarithmic=app.error_measure.logarithmic
        )
    return row


def paper_figure(evaluation: EvaluationRun, *keys: str) -> Any:
    """Return one of the paper's figures, to stand beside those of an evaluation.

    Args:
        evaluation: the application, with its tasks.
        keys: the keys of `paper.json` that lead to the figure.

    Returns:
        The figure; None if the paper states none, or if it does not belong beside this evaluation's, see
        :attr:`metapp.evaluation.evaluation_run.EvaluationRun.has_paper_figures`.
    """
    figure: Any = paper_figures() if evaluation.has_paper_figures else {}
    for key in keys:
        figure = figure.get(key, {})
    return None if figure == {} else figure


def paper_entries(evaluation: EvaluationRun, name: str) -> Row:
    """Return the error and the seconds that the paper states for a paradigm, as entries of a row; None for none."""
    return {f"paper_{key}": paper_figure(evaluation, key, evaluation.app.name, name) for key in ("error", "seconds")}


def errors_by_task(fits: Sequence[Fit]) -> ErrorsByTask:
    """Return errors by the name of the task; fits whose error is None are left out."""
    return {fit.name: fit.error for fit in fits if fit.error is not None}


# Sentences about rows


def comparison_notes(rows: Sequence[Row], compared_row: str = "quickft") -> list[str]:
    """Return the notes below a table whose rows are compared with another row.

    They explain the comparisons, state the threads, say whose seconds are too long, and count fits that went wrong.
    """
    return [
        *paired_columns_note(rows, compared_row),
        *_threads_note(rows),
        *_busy_machine_note(rows),
        *fit_remarks(rows),
    ]


def paired_columns_note(rows: Sequence[Row], compared_row: str = "quickft") -> list[str]:
    """Return a note for each kind of comparison, ratio or difference, in the column of comparisons with another row.

    The note says what the column shows, and which values mean a lower error. A table of one application has one kind.
    [] if no row is compared.

    Args:
        rows: rows with the entry `vs_<compared_row>`.
        compared_row: the name of the row that they are compared with.
    """
    kinds = {comparison.kind: comparison.equal_value for row in rows if (comparison := row[f"vs_{compared_row}"])}
    return [
        f"vs {compared_row}: {kind} of mean errors, 95 % interval by paired bootstrap; "
        f"below {equal_value:g}: a lower error"
        for kind, equal_value in sorted(kinds.items())
    ]


def comparison_text(comparison: PairedComparison, compared_row: str) -> str:
    """Return a comparison in words: error ratio 0.962 [0.952, 0.972] vs quickft, lower on 15 of 20 tasks."""
    share = f"{comparison.ahead} of {comparison.tasks} tasks"
    return f"error {comparison.kind} {comparison} vs {compared_row}, lower on {share}"


def describe_winner(row: Row, compared_row: str = "quickft") -> list[str]:
    """Return a line that compares a row's method with another one by their errors; [] if the row has no comparison.

    The line ends in a verdict: one of the two methods wins, or there is no win as the methods differ no more than by
    chance, or there are too few different tasks to call a win.
    """
    comparison: PairedComparison | None = row[f"vs_{compared_row}"]
    if comparison is None:
        return []
    winner = row["paradigm"] if comparison.value < comparison.equal_value else compared_row
    verdicts = {
        None: f"{comparison.groups} different tasks, fewer than {MIN_TASK_GROUPS}, are too few to call a win",
        False: "no win",
        True: f"{winner} wins",
    }
    return [f"{row['paradigm']}: {comparison_text(comparison, compared_row)}; {verdicts[is_significant(comparison)]}"]


def fit_remarks(rows: Sequence[Row]) -> list[str]:
    """Return remarks on rows with fits that ended above their initialisation's loss, look doubtful, or were guarded.

    Each of the three remarks is a line for each row that it applies to. Lines with one remark come together.
    """
    remarks = (
        ("warnings", "{} of {} fits ended above their initialisation's loss"),
        ("doubtful", "{} of {} fits look doubtful; the entry `warning` of their records says why"),
        ("guarded", "the learned rule did badly on {} of {} tasks, on which as many steps of Adam followed"),
    )
    return [
        f"{row['paradigm']}: {remark.format(row[key], row['tasks'])}"
        for key, remark in remarks
        for row in rows
        if row.get(key)
    ]


def measures_note(evaluation: EvaluationRun, rows: Sequence[Row]) -> list[str]:
    """Return a line for each further error that the application states, with its mean in each row."""
    means_by_title = {
        title: [f"{row['paradigm']} {row[f'mean_{key}']:.3f}" for row in rows if row[f"mean_{key}"] is not None]
        for key, title in evaluation.app.error_measure.further.items()
    }
    return [f"{title}: {', '.join(means)}" for title, means in means_by_title.items() if means]


def _threads_note(rows: Sequence[Row]) -> list[str]:
    """Return a note on the numbers of threads that the rows' seconds were measured with, if records say so."""
    methods_by_threads: dict[str, list[str]] = {}
    for row in rows:
        if row["threads"]:
            methods_by_threads.setdefault(row["threads"], []).append(row["paradigm"])
    if len(methods_by_threads) > 1:
        text = "; ".join(f"{', '.join(methods)} {count}" for count, methods in methods_by_threads.items())
        return [f"threads: {text}; seconds with different numbers of threads cannot be compared"]
    return [f"threads: {count}" for count in methods_by_threads]


def _busy_machine_note(rows: Sequence[Row]) -> list[str]:
    """Return a note on rows whose fits got less CPU time than time passed; [] without such rows."""
    shares = [f"{row['paradigm']} {row['cpu_share']:.2f}" for row in rows if (row["cpu_share"] or 1) < MIN_CPU_SHARE]
    if not shares:
        return []
    return [f"seconds are too long, as other programs took the CPU; CPU seconds a second: {', '.join(shares)}"]


def subset_note(evaluation: EvaluationRun) -> list[str]:
    """Return a note that explains the asterisk of rows which cover a subset of the test tasks; [] without such rows."""
    subset_rows = [name for name in evaluation.specs if evaluation.is_of_subset(name)]
    if not subset_rows:
        return []
    task_count = len(evaluation.tasks_of(subset_rows[0]))  # all subsets are of one size
    return [f"*: on {task_count} evenly spaced tasks; --whole measures all"]


def scale_free_figures(rows: Sequence[Row], error: str, seconds: str) -> tuple[float | None, float | None]:
    """Return the share of the gap that Meta closes and its speed-up over Overfit.

    Neither depends on the scale of errors or the speed of a machine, so both can be compared between data sets. The gap
    is between the errors of General and Overfit; without one, where Overfit is no better, the share is None.

    Args:
        rows: rows that include General's, Overfit's and Meta's.
        error: the key of the errors to take.
        seconds: the key of the seconds to take.

    Returns:
        The share and the speed-up; None each if it cannot be computed.
    """
    by_name = {row["paradigm"]: row for row in rows}
    general, overfit, meta = (by_name[name] for name in ("general", "overfit", "meta"))
    gap = speed_up = None
    if None not in (general[error], overfit[error], meta[error]) and overfit[error] < general[error]:
        gap = (general[error] - meta[error]) / (general[error] - overfit[error])
    if None not in (overfit[seconds], meta[seconds]):
        speed_up = overfit[seconds] / meta[seconds]
    return gap, speed_up
