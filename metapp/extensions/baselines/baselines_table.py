"""The table of baselines: methods without a network beside paradigms, on the same samples of the same tasks.

Rows of paradigms come from kept fits, as in all tables. Predictions of methods are kept, too, so that each is made
once.
"""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from pathlib import Path

from metapp.evaluation.error_statistics import is_significant
from metapp.evaluation.evaluation_run import EvaluationRun
from metapp.evaluation.rows import (
    comparison_notes,
    comparison_text,
    make_row,
    measures_note,
    paper_entries,
    subset_note,
)
from metapp.evaluation.table import Column, Row, Table, bytes_column, columns
from metapp.evaluation.tables.storage import checkpoint_bytes, parameter_bytes
from metapp.extensions.baselines import baselines_of
from metapp.extensions.baselines.baseline import Baseline
from metapp.extensions.baselines.baseline_fits import (
    baseline_spec,
    find_training_folder,
    fit_baselines,
    parameters_per_task,
)
from metapp.learning.task import Task
from metapp.paradigms import PARADIGMS
from metapp.runs.fit import Fit
from metapp.runs.reporter import say
from metapp.runs.resolve import app_of
from metapp.storage.fit_folders import PARAMS

SHOWN_PARADIGMS = ("general", "quickft", "meta", "finetune", "overfit")
BASELINE_COLUMNS = columns(
    Column("method", "paradigm"),
    *("error", "seconds", "vs meta"),
    Column("numbers", "numbers", ",.0f"),
    bytes_column("bytes", "kept_bytes"),
    bytes_column("shared bytes", "shared"),
    *("interval", "median", "worst"),
)


def baselines_table(evaluation: EvaluationRun) -> Table:
    """Return the table of the paradigms, then of the baselines that can be fitted: errors, times and bytes."""
    # Rules of Meta whose runs have an application, and so a network, of their own are compared, too.
    own_network_names = [
        name
        for name, spec in evaluation.specs.items()
        if app_of(spec) != evaluation.app and name not in SHOWN_PARADIGMS
    ]
    available_baselines = _available_baselines(evaluation)
    answers = {baseline.name: baseline_fits(evaluation, baseline) for baseline in available_baselines}
    rows = [
        *(_make_paradigm_row(evaluation, name) for name in (*SHOWN_PARADIGMS, *own_network_names)),
        *(_make_baseline_row(evaluation, name, fits) for name, fits in answers.items()),
    ]
    notes = [
        *_describe_missing_rows(evaluation, rows, available_baselines),
        *_describe_baselines(available_baselines),
        "bytes: of what is kept of a task; shared: of what all tasks share, to be fitted or to be evaluated",
        *comparison_notes(rows, "meta"),
        *measures_note(evaluation, rows),
        *subset_note(evaluation),
    ]
    pictured = {name: fits for name, fits in answers.items() if fits and (fits[0].folder / PARAMS).is_file()}
    meta = evaluation.fits("meta")
    title = (
        f"mean error{evaluation.app.error_measure.factor} and what is kept, "
        "of paradigms and of methods without a network"
    )
    fits = {"meta": meta} | pictured if meta and pictured else {}
    findings = (evaluation.presenter.caption(), *_describe_comparisons([row for row in rows if row["baseline"]]))
    return Table(evaluation.title, title, BASELINE_COLUMNS, rows, notes, fits, findings)


def _available_baselines(evaluation: EvaluationRun) -> list[Baseline]:
    """Return the baselines that lack neither training tasks nor, in any task, the tensor with their predictions."""

    def is_available(baseline: Baseline) -> bool:
        if baseline.stored_tensor:
            return bool(evaluation.tasks) and all(baseline.stored_tensor in task.data for task in evaluation.tasks)
        if not (baseline.learns and evaluation.tasks):
            return True
        return _training_folder(evaluation, baseline, make=evaluation.is_measuring) is not None

    return [
        baseline for baseline in baselines_of(evaluation.given.application, evaluation.app) if is_available(baseline)
    ]


def _training_folder(evaluation: EvaluationRun, baseline: Baseline, *, make: bool = False) -> Path | None:
    """Return the data set whose training tasks a baseline learns from; None for none."""
    data = evaluation.options.data
    return find_training_folder(evaluation.specs["general"], baseline, data, make=make and not data)


def baseline_fits(evaluation: EvaluationRun, baseline: Baseline) -> list[Fit]:
    """Return the fits of a baseline; fits that are missing are made now, where they may be."""
    general, training_folder = evaluation.specs["general"], _training_folder(evaluation, baseline)
    can_be_fitted = evaluation.tasks and (not baseline.learns or training_folder)
    spec = baseline_spec(general, baseline, training_folder) if can_be_fitted else None

    def fit_tasks(tasks: list[Task]) -> Iterator[Fit]:
        """Yield the fit of each task, until one cannot be fitted."""
        try:
            for fit, _ in fit_baselines(general, baseline, tasks, training_folder):
                yield fit
        except ValueError as error:
            say(f"{evaluation.app.full_name} {baseline.name}: {error}")

    folder = evaluation.folder(f"baseline-{baseline.name}")
    return evaluation.measure(baseline.name, folder, spec, fit_tasks, evaluation.tasks)


def _make_paradigm_row(evaluation: EvaluationRun, name: str) -> Row:
    """Return the row of a paradigm, or of a rule of Meta, with the numbers and bytes that its fits keep."""
    spec = evaluation.specs[name]
    theta = parameters_per_task(app_of(spec))
    entries = {
        "shared": checkpoint_bytes(evaluation.fitters.get(name)),
        "baseline": False,
        "few": evaluation.is_of_subset(name),
    }
    entries |= {"numbers": sum(value.numel() for value in theta.values()), "kept_bytes": parameter_bytes(theta)}
    entries |= paper_entries(evaluation, name)
    fits = evaluation.existing_fits(name) if PARADIGMS[spec.paradigm].takes_long else evaluation.fits(name)
    return make_row(evaluation, name, fits, entries, ("meta",))


def _make_baseline_row(evaluation: EvaluationRun, name: str, fits: list[Fit]) -> Row:
    """Return the row of a baseline, with the mean numbers and bytes that its fits keep."""
    kept_means = {
        key: statistics.fmean(fit.figures[key] for fit in fits) if fits else None for key in ("numbers", "kept_bytes")
    }
    entries = kept_means | {"shared": fits[-1].figures["shared"] if fits else None, "baseline": True}
    return make_row(evaluation, name, fits, entries, ("meta",))


def _describe_comparisons(all_rows: list[Row]) -> list[str]:
    """Return lines on which baselines have a lower error than Meta, which a higher one, and which no clear one."""
    pairs = {row["paradigm"]: pair for row in all_rows if (pair := row["vs_meta"])}
    higher = [name for name, pair in pairs.items() if is_significant(pair) and pair.value > pair.equal_value]
    undecided = [name for name, pair in pairs.items() if not is_significant(pair)]
    return [
        *(f"{name}: {comparison_text(pairs[name], 'meta')}" for name in pairs if name not in (*higher, *undecided)),
        *([f"a higher error than meta's: {', '.join(higher)}"] if higher else []),
        *([f"no win either way: {', '.join(undecided)}"] if undecided else []),
    ]


def _describe_missing_rows(evaluation: EvaluationRun, all_rows: list[Row], able: list[Baseline]) -> list[str]:
    """Return lines on rows without fits and baselines left out, with the commands that add them."""
    absent = [row["paradigm"] for row in all_rows if not row["tasks"] and not row["baseline"]]
    lines = [f"no records yet of {', '.join(absent)}: --which results measures them"] if absent else []
    names = {baseline.name for baseline in able}
    left_out = [
        baseline
        for baseline in baselines_of(evaluation.given.application, evaluation.app)
        if baseline.name not in names
    ]
    lines += [
        f"{baseline.name}: left out, as not all tasks hold {baseline.title}"
        for baseline in left_out
        if baseline.stored_tensor
    ]
    if untrained_names := [baseline.name for baseline in left_out if not baseline.stored_tensor]:
        remedy = f"metapp data synth {evaluation.app.name} makes the embedded ones"
        lines.append(f"{', '.join(untrained_names)}: no training tasks; {remedy}")
    return lines


def _describe_baselines(baselines: list[Baseline]) -> list[str]:
    """Return the titles and limits of baselines, once for baselines that have these in common."""
    names_by_text: dict[tuple[str, str], list[str]] = {}
    for baseline in baselines:
        names_by_text.setdefault((baseline.title, baseline.cannot), []).append(baseline.name)
    return [f"{', '.join(names)}: {title}; cannot {cannot}" for (title, cannot), names in names_by_text.items()]
