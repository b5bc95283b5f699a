"""The paper's main table, error and time of every paradigm, and its table of three paradigms at equal steps.

Which learned rules have rows follows from the checkpoints that exist; no rule is known here by its name.
"""

from __future__ import annotations

import statistics
from collections.abc import Collection

from metapp.evaluation.error_statistics import is_significant
from metapp.evaluation.evaluation_run import EvaluationRun
from metapp.evaluation.rows import (
    comparison_notes,
    describe_winner,
    errors_by_task,
    make_row,
    measures_note,
    paper_entries,
    scale_free_figures,
    subset_note,
)
from metapp.evaluation.table import Row, Table, columns
from metapp.paradigms import PARADIGMS
from metapp.runs.reporter import format_number

COMPARED_ROWS = ("quickft", "general")  # rows that all other rows are compared with
EQUAL_STEPS_ROWS = ("general", "quickft", "meta")  # rows of the table of equal steps
RESULT_COLUMNS = columns(
    *("paradigm", "error", "seconds", "paper error", "paper seconds"),
    *("vs quickft", "interval", "steps", "median", "worst"),
)


def results(evaluation: EvaluationRun) -> Table:
    """Make the table of error and time of every paradigm, and of Meta by every rule that has a checkpoint."""
    rows = result_rows(evaluation, evaluation.specs)
    overfit_errors = errors_by_task(evaluation.fits("overfit"))
    for row in rows:  # the gap closed needs errors of equal tasks: of the tasks that Overfit was fitted to
        errors = errors_by_task(evaluation.fits(row["paradigm"]))
        is_known = overfit_errors and overfit_errors.keys() <= errors.keys()
        row["shared_error"] = statistics.fmean(errors[task] for task in overfit_errors) if is_known else None
    notes = [
        *subset_note(evaluation),
        *(["the paper measured its figures on other data and another machine"] if evaluation.has_paper_figures else []),
        *comparison_notes(rows),
    ]
    title = f"mean error{evaluation.app.error_measure.factor}, median seconds of inference"
    fits = {name: evaluation.fits(name) for name in PARADIGMS}
    findings = (evaluation.presenter.caption(), describe_gap(evaluation, rows))
    return Table(evaluation.title, title, RESULT_COLUMNS, rows, notes, fits, findings)


def result_rows(evaluation: EvaluationRun, names: Collection[str]) -> list[Row]:
    """Make rows of paradigms and of Meta's rules.

    Fits of few steps are measured first, so that most of a table is known soon.
    """
    for name in sorted(names, key=evaluation.steps):
        evaluation.fits(name)
    rows = []
    for name in names:
        rule, steps = evaluation.specs[name].rule or None, evaluation.steps(name)
        entries = {"rule": rule, "steps": steps, "few": evaluation.is_of_subset(name)}
        entries |= paper_entries(evaluation, name)
        rows.append(make_row(evaluation, name, evaluation.fits(name), entries, COMPARED_ROWS))
    return rows


def describe_gap(evaluation: EvaluationRun, rows: list[Row]) -> str:
    """Return the sentence on the gap that Meta closes and on its speed-up, beside the paper's.

    Where fits see something else than the paper's do, Overfit sees less than errors are measured on. Its error is no
    lower bound then, and Meta is compared with General and QuickFT instead.
    """
    gap, speed_up = scale_free_figures(rows, "shared_error", "seconds")
    by_name = {row["paradigm"]: row for row in rows}
    meta = f"Meta ({by_name['meta']['rule']})"
    if not evaluation.observes_default:
        compared_rows = {"General": by_name["general"], "QuickFT": by_name["quickft"]}
        changes = [
            f"{text} {title}'s"
            for title, row in compared_rows.items()
            if (text := describe_error_change(by_name["meta"], row))
        ]
        text = f"Meta's error is {', '.join(changes)}; " if changes else ""
        floor = f"Overfit sees the {evaluation.app.observes} alone, so its error is no lower bound"
        return f"{text}{floor}, speed-up of {meta} over it {format_number(speed_up, '.0f')}"
    paper_gap, paper_speed_up = scale_free_figures(rows, "paper_error", "paper_seconds")
    mark = "*" * (gap is not None and any(row["few"] for row in rows))
    paper_texts = [
        "" if figure is None else f" (paper {figure:{form}})"
        for figure, form in ((paper_gap, ".2f"), (paper_speed_up, ".0f"))
    ]
    return (
        f"gap closed {format_number(gap, '.2f')}{mark}{paper_texts[0]}, "
        f"speed-up of {meta} over Overfit {format_number(speed_up, '.0f')}{paper_texts[1]}"
    )


def describe_error_change(row: Row, compared_row: Row) -> str:
    """Return how far a row's error is from another row's, in percent of the other's, such as "12 % below"."""
    if row["error"] is None or not compared_row["error"]:
        return ""
    percent = 100 * (row["error"] - compared_row["error"]) / abs(compared_row["error"])
    return f"{abs(percent):.0f} % {'above' if percent > 0 else 'below'}"


def quickft(evaluation: EvaluationRun) -> Table:
    """Make the table of General, QuickFT and Meta at equal steps, and say whether Meta's lead could be chance."""
    rows = [row | {"apart": is_significant(row["vs_quickft"])} for row in result_rows(evaluation, EQUAL_STEPS_ROWS)]
    _, quickft_row, meta_row = rows
    notes = [*comparison_notes(rows), *measures_note(evaluation, rows)]
    if None not in (meta_row["paper_error"], quickft_row["paper_error"]):
        notes.append(f"paper: meta {meta_row['paper_error']:.3f}, quickft {quickft_row['paper_error']:.3f}")
    notes.append("the options of quickft's Adam were searched on validation tasks")
    title = f"mean error{evaluation.app.error_measure.factor} after equally many steps"
    findings = (
        evaluation.presenter.caption(),
        *(line for name in COMPARED_ROWS for line in describe_winner(meta_row, name)),
    )
    return Table(evaluation.title, title, RESULT_COLUMNS, rows, notes, findings=findings)
