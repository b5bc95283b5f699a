"""The paper's main table, error and time of every paradigm, and that of General, QuickFT and Meta at equal steps."""

from __future__ import annotations

import statistics

from metapp.evaluation.cell import Cell
from metapp.evaluation.notes import (
    carried,
    change,
    few_note,
    measures_note,
    paired_note,
    threads_note,
    verdict,
    warned,
)
from metapp.evaluation.pictures import draw_paradigms
from metapp.evaluation.rows import Row, Table, against, columns, paired_of, row_of, values_of
from metapp.evaluation.subject import Subject
from metapp.learning.app import App
from metapp.runs.naming import caption_of, is_first_protocol
from metapp.runs.outputs.statistics import apart
from metapp.runs.reporter import number

COMPARED = ("quickft", "general")
EQUAL = ("general", "quickft", "meta")  # rows of the table of equal steps


def cells(subject: Subject) -> list[Cell]:
    """The fits of every paradigm, and of Meta by every rule that has a checkpoint."""
    return [subject.cell(name) for name in subject.fits]


def rows(subject: Subject) -> list[Row]:
    """A row for each of them."""
    return [result_row(subject, name) for name in subject.fits]


def result_row(subject: Subject, name: str) -> Row:
    """Error and time of one paradigm, or of one of Meta's rules, also beside QuickFT's and General's."""
    fit = subject.fits[name]
    rule = fit.paradigm.rule_name if fit.paradigm.name == "meta" else None
    versus = against(subject, name, *COMPARED)
    entries = {"rule": rule, "steps": fit.steps, "shared_error": shared_error(subject, name)}
    entries |= {"few": subject.is_of_few(name)}
    return row_of(subject, name, [subject.cell(name)], entries, against=versus)


def shared_error(subject: Subject, name: str) -> float | None:
    """The mean error of the tasks that Overfit was fitted to; None where one of them has no record yet."""
    errors, tasks = (values_of(subject.cell(row)) for row in (name, "overfit"))
    return statistics.fmean(errors[task] for task in tasks) if tasks and tasks.keys() <= errors.keys() else None


def notes(subject: Subject, all_rows: list[Row]) -> list[str]:
    """Gap closed, speed-up, who wins, what the errors are, and what differs from the recipe and the paper."""
    meta = next(row for row in all_rows if row["paradigm"] == "meta")
    return [
        closing(subject.app, all_rows),
        *filter(None, (verdict(meta, other) for other in COMPARED)),
        *warned(all_rows),
        f"meta: {meta['rule']}; {caption_of(subject.app)}",
        *measures_note(subject, all_rows),
        *paired_note(all_rows),
        *threads_note(all_rows),
        *few_note(subject, all_rows),
        *(["the paper's figures are of its own data and machine"] if is_first_protocol(subject.app) else []),
    ]


def closing(app: App, all_rows: list[Row]) -> str:
    """Gap closed and speed-up beside the paper's.

    Under a further protocol Overfit fits less than errors are measured on: Meta is compared with General and QuickFT.
    """
    gap, speed = carried(all_rows, "shared_error", "seconds")
    if not is_first_protocol(app):
        by_name = {row["paradigm"]: row for row in all_rows}
        others = {"General": by_name["general"], "QuickFT": by_name["quickft"]}
        changes = [f"{text} {title}'s" for title, row in others.items() if (text := change(by_name["meta"], row))]
        text = f"Meta's error is {', '.join(changes)}; " if changes else ""
        floor = f"Overfit sees the {app.protocol} alone and is no floor"
        return f"{text}{floor}, speed-up of Meta over it {number(speed, '.0f')}"
    paper_gap, paper_speed = carried(all_rows, "paper_error", "paper_seconds")
    mark = "*" * any(row["few"] for row in all_rows)
    return (
        f"gap closed {number(gap, '.2f')}{mark} (paper {number(paper_gap, '.2f')}), "
        f"speed-up of Meta over Overfit {number(speed, '.0f')} (paper {number(paper_speed, '.0f')})"
    )


def equal_cells(subject: Subject) -> list[Cell]:
    """General's, QuickFT's and Meta's fits."""
    return [subject.cell(name) for name in EQUAL]


def equal_rows(subject: Subject) -> list[Row]:
    """The three, each with whether chance could be why its error is not QuickFT's."""
    all_rows = [result_row(subject, name) for name in EQUAL]
    return [row | {"apart": apart(paired_of(row, "quickft"))} for row in all_rows]


def equal_notes(subject: Subject, all_rows: list[Row]) -> list[str]:
    """Who wins, on how many tasks, and in the paper."""
    _, quickft, meta = all_rows
    lines = [verdict(meta), verdict(meta, "general"), *warned(all_rows)]
    if None not in (meta["paper_error"], quickft["paper_error"]):
        errors = {row["paradigm"]: number(row["paper_error"], ".3f") for row in (meta, quickft)}
        lines.append(f"paper: meta {errors['meta']}, quickft {errors['quickft']}")
    lines += [caption_of(subject.app), "quickft's Adam is searched on validation tasks"]
    return [*filter(None, lines), *paired_note(all_rows), *threads_note(all_rows)]


COLUMNS = columns(
    *("paradigm", "error", "seconds", "paper error", "paper seconds"),
    *("vs quickft", "interval", "steps", "median", "worst"),
)
RESULTS = Table(
    "results",
    "mean error{factor}, median seconds of inference",
    COLUMNS,
    rows,
    notes,
    cells,
    heading="Error and time",
    picture=draw_paradigms,
)
EQUAL_COLUMNS = columns(
    *("paradigm", "error", "vs quickft", "paper error", "interval", "steps", "seconds", "median", "worst")
)
QUICKFT = Table(
    "quickft",
    "mean error{factor} after as many steps",
    EQUAL_COLUMNS,
    equal_rows,
    equal_notes,
    equal_cells,
    heading="Against as many steps of fine-tuning",
)
