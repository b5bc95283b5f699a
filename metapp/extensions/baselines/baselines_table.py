"""The table of baselines: methods without a network, fitted to the same samples of the same tasks as paradigms."""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from pathlib import Path

from metapp.apps import full_name
from metapp.evaluation.error_statistics import is_significant
from metapp.evaluation.rows import (
    comparison_notes,
    comparison_text,
    make_row,
    measures_note,
    paper_entries,
    subset_note,
)
from metapp.evaluation.subject import EvaluationRun
from metapp.evaluation.table import Column, Row, Table, bytes_column, columns
from metapp.evaluation.tables.storage import checkpoint_bytes, parameter_bytes
from metapp.extensions.baselines import baselines_of
from metapp.extensions.baselines.baseline import Baseline
from metapp.extensions.baselines.baseline_fits import (
    BASELINE_RECORD_KEYS,
    baseline_settings,
    find_training_folder,
    fit_baselines,
    parameters_per_task,
)
from metapp.learning.task import Params, Task
from metapp.runs.reporter import say
from metapp.storage.fit_folders import PARAMS, Record

SHOWN_PARADIGMS = ("general", "quickft", "meta", "finetune", "overfit")
BASELINE_COLUMNS = columns(
    Column("method", "paradigm"),
    *("error", "seconds", "vs meta"),
    Column("numbers", "numbers", ",.0f"),
    bytes_column("bytes", "kept_bytes"),
    bytes_column("shared bytes", "shared"),
    *("interval", "median", "worst"),
)


def baselines_table(subject: EvaluationRun) -> Table:
    """The paradigms, then the baselines that there are training tasks for: their errors, times and bytes."""
    # Meta's rules that have a network of their own are compared, too
    larger = [name for name, run in subject.runs.items() if run.app != subject.app and name not in SHOWN_PARADIGMS]
    able = _able(subject)
    records = {baseline.name: baseline_records(subject, baseline) for baseline in able}
    rows = [
        *(_row_of_paradigm(subject, name) for name in (*SHOWN_PARADIGMS, *larger)),
        *(_row_of_baseline(subject, name, of_baseline) for name, of_baseline in records.items()),
    ]
    notes = [
        *_missing(subject, rows, able),
        *_described(able),
        "bytes: of what is kept of a task; shared: of what all tasks share, to be fitted or to be evaluated",
        *comparison_notes(rows, "meta"),
        *measures_note(subject, rows),
        *subset_note(subject),
    ]
    pictures = {name: some for name, some in records.items() if some and Path(some[0]["folder"], PARAMS).is_file()}
    meta = subject.records("meta")
    title = (
        f"mean error{subject.app.error_measure.factor} and what is kept, of paradigms and of methods without a network"
    )
    fits = {"meta": meta} | pictures if meta and pictures else {}
    findings = (subject.presenter.caption(), *_compared([row for row in rows if row["baseline"]]))
    return Table(subject.title, title, BASELINE_COLUMNS, rows, notes, fits, findings)


def _able(subject: EvaluationRun) -> list[Baseline]:
    """The baselines that lack neither training tasks nor, in any task, the tensor that holds their answers."""

    def able(baseline: Baseline) -> bool:
        if baseline.stored:
            return bool(subject.tasks) and all(baseline.stored in task.data for task in subject.tasks)
        if not (baseline.learns and subject.tasks):
            return True
        return find_training_folder(subject.run, baseline, make=subject.is_measuring) is not None

    return [baseline for baseline in baselines_of(subject.app) if able(baseline)]


def baseline_records(subject: EvaluationRun, baseline: Baseline) -> list[Record]:
    """The fits of a baseline."""
    kept = None
    if subject.tasks and (not baseline.learns or find_training_folder(subject.run, baseline)):
        settings = baseline_settings(subject.run, baseline, subject.label)
        kept = subject.record_folder(f"baseline-{baseline.name}", settings, BASELINE_RECORD_KEYS)

    def measured(tasks: list[Task]) -> Iterator[tuple[Record, Params | None]]:
        """The record and the picture of each task, as far as it can be fitted."""
        try:
            for record, picture, _ in fit_baselines(subject.run, baseline, tasks):
                yield record, picture
        except ValueError as error:
            say(f"{full_name(subject.app)} {baseline.name}: {error}")

    return subject.measure_records(baseline.name, kept, measured, subject.tasks)


def _row_of_paradigm(subject: EvaluationRun, name: str) -> Row:
    run = subject.runs[name]
    theta = parameters_per_task(run.app)
    entries = {"shared": checkpoint_bytes(run.checkpoint), "baseline": False, "few": subject.is_of_subset(name)}
    entries |= {"numbers": sum(value.numel() for value in theta.values()), "kept_bytes": parameter_bytes(theta)}
    entries |= paper_entries(run.app, name)
    records = subject.existing_records(name) if run.paradigm.takes_long else subject.records(name)
    return make_row(subject, name, records, entries, ("meta",))


def _row_of_baseline(subject: EvaluationRun, name: str, records: list[Record]) -> Row:
    kept = {
        key: statistics.fmean(each[key] for each in records) if records else None for key in ("numbers", "kept_bytes")
    }
    entries = kept | {"shared": records[-1]["shared"] if records else None, "baseline": True}
    return make_row(subject, name, records, entries, ("meta",))


def _compared(all_rows: list[Row]) -> list[str]:
    """The baselines of a lower error than Meta's, of a higher one, and those not told apart."""
    pairs = {row["paradigm"]: pair for row in all_rows if (pair := row["vs_meta"])}
    higher = [name for name, pair in pairs.items() if is_significant(pair) and pair.value > pair.equal_value]
    level = [name for name, pair in pairs.items() if not is_significant(pair)]
    return [
        *(f"{name}: {comparison_text(pairs[name], 'meta')}" for name in pairs if name not in (*higher, *level)),
        *([f"a higher error than meta's: {', '.join(higher)}"] if higher else []),
        *([f"no win either way: {', '.join(level)}"] if level else []),
    ]


def _missing(subject: EvaluationRun, all_rows: list[Row], able: list[Baseline]) -> list[str]:
    """Rows without records, and the commands that make them."""
    absent = [row["paradigm"] for row in all_rows if not row["tasks"] and not row["baseline"]]
    lines = [f"no records yet of {', '.join(absent)}: --which results measures them"] if absent else []
    names = {baseline.name for baseline in able}
    others = [baseline for baseline in baselines_of(subject.app) if baseline.name not in names]
    lines += [f"{each.name}: left out, as not all tasks hold {each.title}" for each in others if each.stored]
    if without := [baseline.name for baseline in others if not baseline.stored]:
        remedy = f"metapp data synth {subject.app.name} makes the embedded ones"
        lines.append(f"{', '.join(without)}: no training tasks; {remedy}")
    return lines


def _described(baselines: list[Baseline]) -> list[str]:
    """Titles and limits of baselines, once for those that are the same."""
    named: dict[tuple[str, str], list[str]] = {}
    for baseline in baselines:
        named.setdefault((baseline.title, baseline.cannot), []).append(baseline.name)
    return [f"{', '.join(names)}: {title}; cannot {cannot}" for (title, cannot), names in named.items()]
