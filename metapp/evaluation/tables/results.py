"""The paper's main table, error and time of every paradigm, and that of General, QuickFT and Meta at equal steps."""

from __future__ import annotations

import statistics
from collections.abc import Collection

from metapp.apps import is_first_protocol
from metapp.evaluation.error_statistics import is_significant
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
from metapp.evaluation.subject import EvaluationRun
from metapp.evaluation.table import Row, Table, columns
from metapp.learning.app import App
from metapp.paradigms import PARADIGMS
from metapp.runs.reporter import format_number

COMPARED_ROWS = ("quickft", "general")  # rows that rows are compared with
EQUAL_STEPS_ROWS = ("general", "quickft", "meta")  # rows of the table of equal steps
RESULT_COLUMNS = columns(
    *("paradigm", "error", "seconds", "paper error", "paper seconds"),
    *("vs quickft", "interval", "steps", "median", "worst"),
)


def results(subject: EvaluationRun) -> Table:
    """Error and time of every paradigm, and of Meta by every rule that has a checkpoint."""
    rows = result_rows(subject, subject.runs)
    floor = errors_by_task(subject.records("overfit"))
    for row in rows:  # of the tasks that Overfit was fitted to
        errors = errors_by_task(subject.records(row["paradigm"]))
        is_known = floor and floor.keys() <= errors.keys()
        row["shared_error"] = statistics.fmean(errors[task] for task in floor) if is_known else None
    notes = [
        *subset_note(subject),
        *(["the paper's figures are of its own data and machine"] if is_first_protocol(subject.app) else []),
        *comparison_notes(rows),
    ]
    title = f"mean error{subject.app.error_measure.factor}, median seconds of inference"
    fits = {name: subject.records(name) for name in PARADIGMS}
    findings = (subject.presenter.caption(), describe_gap(subject.app, rows))
    return Table(subject.title, title, RESULT_COLUMNS, rows, notes, fits, findings)


def result_rows(subject: EvaluationRun, names: Collection[str]) -> list[Row]:
    """Rows of paradigms and of Meta's rules; fits of few steps are measured first: most of a table is soon there."""
    for name in sorted(names, key=lambda name: subject.runs[name].paradigm.steps):
        subject.records(name)
    rows = []
    for name in names:
        run = subject.runs[name]
        rule = run.options.rule if run.paradigm.has_learned_rule else None
        entries = {"rule": rule, "steps": run.paradigm.steps, "few": subject.is_of_few(name)}
        entries |= paper_entries(subject.app, name)
        rows.append(make_row(subject, name, subject.records(name), entries, COMPARED_ROWS))
    return rows


def describe_gap(app: App, rows: list[Row]) -> str:
    """Gap closed and speed-up beside the paper's.

    Under a further protocol Overfit fits less than errors are measured on: Meta is compared with General and QuickFT.
    """
    gap, speed = scale_free_figures(rows, "shared_error", "seconds")
    by_name = {row["paradigm"]: row for row in rows}
    meta = f"Meta ({by_name['meta']['rule']})"
    if not is_first_protocol(app):
        others = {"General": by_name["general"], "QuickFT": by_name["quickft"]}
        changes = [
            f"{text} {title}'s"
            for title, row in others.items()
            if (text := describe_error_change(by_name["meta"], row))
        ]
        text = f"Meta's error is {', '.join(changes)}; " if changes else ""
        floor = f"Overfit sees the {app.protocol} alone and is no floor"
        return f"{text}{floor}, speed-up of {meta} over it {format_number(speed, '.0f')}"
    paper_gap, paper_speed = scale_free_figures(rows, "paper_error", "paper_seconds")
    mark = "*" * (gap is not None and any(row["few"] for row in rows))
    return (
        f"gap closed {format_number(gap, '.2f')}{mark} (paper {format_number(paper_gap, '.2f')}), "
        f"speed-up of {meta} over Overfit {format_number(speed, '.0f')} (paper {format_number(paper_speed, '.0f')})"
    )


def describe_error_change(one: Row, other: Row) -> str:
    """The difference of a row's error from another's, in percent of that: "12 % below"; "" if one is not known."""
    if one["error"] is None or not other["error"]:
        return ""
    percent = 100 * (one["error"] - other["error"]) / abs(other["error"])
    return f"{abs(percent):.0f} % {'above' if percent > 0 else 'below'}"


def quickft(subject: EvaluationRun) -> Table:
    """General, QuickFT and Meta, each with whether chance could be why its error is not QuickFT's."""
    rows = [row | {"apart": is_significant(row["vs_quickft"])} for row in result_rows(subject, EQUAL_STEPS_ROWS)]
    _, of_quickft, meta = rows
    notes = [*comparison_notes(rows), *measures_note(subject, rows)]
    if None not in (meta["paper_error"], of_quickft["paper_error"]):
        notes.append(f"paper: meta {meta['paper_error']:.3f}, quickft {of_quickft['paper_error']:.3f}")
    notes.append("quickft's Adam is searched on validation tasks")
    title = f"mean error{subject.app.error_measure.factor} after as many steps"
    findings = (
        subject.presenter.caption(),
        *(line for other in COMPARED_ROWS for line in describe_winner(meta, other)),
    )
    return Table(subject.title, title, RESULT_COLUMNS, rows, notes, findings=findings)
