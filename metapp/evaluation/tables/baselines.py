"""What a reader would use instead of a network, fitted to the same samples of the same tasks, beside the paradigms."""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from metapp.baselines import baselines_of
from metapp.baselines.baseline import Baseline
from metapp.evaluation.baseline_fits import (
    FORM,
    allowed_for,
    baseline_versions,
    fit_baselines,
    own_parameters,
    training_folder,
    training_of,
)
from metapp.evaluation.tables.comparison import compared_text, paired_columns, paired_entries, paired_note, paired_of
from metapp.evaluation.tables.results import budget, on_threads
from metapp.evaluation.tables.rows import Row, bytes_column, interval, numbers, words
from metapp.evaluation.tables.storage import kept, size
from metapp.evaluation.tables.subject import Cell, Record, Subject
from metapp.evaluation.tables.table import Table
from metapp.learning.task import Task
from metapp.runs.inputs import data_label
from metapp.runs.origin import origin_of
from metapp.runs.reporter import say
from metapp.runs.session import caption_of, name_of, observe_of, threads_of
from metapp.runs.statistics import apart
from metapp.storage.records import RunFolder

SHOWN = ("general", "quickft", "meta", "finetune", "overfit")
RUN = SHOWN[:3]  # the others take long and stand here where there are records of them
GUESS = 0.3  # seconds of a fit, about


def cells(subject: Subject) -> list[Cell]:
    """The fits of General, QuickFT and Meta, and of the baselines that there are training tasks for."""
    names = [*RUN, *_larger(subject)]
    return [*(subject.cell(name) for name in names), *(baseline_cell(subject, baseline) for baseline in _able(subject))]


def _larger(subject: Subject) -> list[str]:
    """Meta's rules that have a network of their own."""
    return [name for name, fit in subject.fits.items() if fit.options.app is not subject.app and name not in SHOWN]


def _able(subject: Subject) -> list[Baseline]:
    """The baselines that lack no training tasks."""
    without = _untrained(subject)
    return [baseline for baseline in baselines_of(subject.app) if baseline.name not in without]


def _untrained(subject: Subject) -> list[str]:
    """The baselines that need training tasks where there are none."""
    learning = [baseline.name for baseline in baselines_of(subject.app) if baseline.learns]
    return learning if learning and subject.tasks and training_folder(subject.options) is None else []


def baseline_cell(subject: Subject, baseline: Baseline) -> Cell:
    """The fits of a baseline; those that match Meta's errors come after Meta's."""
    app, options, meta = subject.app, subject.options, subject.cell("meta")
    source = training_folder(options) if baseline.learns and subject.tasks else None
    missing = not subject.tasks or (baseline.learns and source is None) or (baseline.matches and meta.folder is None)
    folder = None
    if not missing:
        name = f"{subject.label}-{options.recipe}-seed{options.seed}"
        name += f"-{app.protocol}" if app.protocol else ""
        path = options.out / app.name / "baselines" / baseline.name / name
        folder = RunFolder(path, _settings(subject, baseline, source), FORM, origin_of(options))

    def measure(tasks: list[Task]) -> Iterator[Record]:
        assert folder is not None
        errors = {record["name"]: record["error"] for record in meta.records()} if baseline.matches else {}
        try:
            for record, picture in fit_baselines(options, baseline, training_of(app, source), tasks, errors):
                folder.add(record, picture)
                yield record
        except ValueError as error:
            say(f"{name_of(app)} {baseline.name}: {error}")

    title, threads = f"{name_of(app)} {baseline.name}", threads_of(app)
    command = subject.command("baselines")
    return Cell(title, subject.tasks, folder, measure, 0, command, int(baseline.matches), threads=threads, guess=GUESS)


def _settings(subject: Subject, baseline: Baseline, source: Path | None) -> dict[str, Any]:
    """Everything that a baseline's figures depend on; `source`: the data set that it learns from."""
    app, options, meta = subject.app, subject.options, subject.cell("meta")
    return {
        "app": app.name,
        **observe_of(app),
        "baseline": baseline.name,
        "data": subject.label,
        "training": source and data_label(source),
        "allowed": allowed_for(options)._asdict(),
        "recipe": options.recipe,
        "seed": options.seed,
        "versions": baseline_versions(),
        **app.conditions(),
        **({"meta": meta.folder.key} if baseline.matches and meta.folder else {}),
    }


def baselines_with_pictures(subject: Subject) -> list[tuple[str, Path, list[Record]]]:
    """Name, folder and records of the baselines that are measured and are pictures."""
    cells = {baseline.name: baseline_cell(subject, baseline) for baseline in _able(subject)}
    return [
        (name, cell.folder.path, cell.records())
        for name, cell in cells.items()
        if cell.folder and subject.tasks and not cell.missing() and cell.folder.params(subject.tasks[0].name).is_file()
    ]


def rows(subject: Subject) -> list[Row]:
    """The paradigms, then the baselines."""
    return [
        *(_row_of_paradigm(subject, name) for name in (*SHOWN, *_larger(subject))),
        *baseline_rows(subject),
    ]


def baseline_rows(subject: Subject) -> list[Row]:
    """The baselines alone."""
    return [_row_of_baselines(subject, baseline) for baseline in _able(subject)]


def _row_of_paradigm(subject: Subject, name: str) -> Row:
    fit, cell = subject.fits[name], subject.cell(name)
    theta = own_parameters(fit.options.app)
    count = sum(value.numel() for value in theta.values())
    stored = {"numbers": count, "size": size(theta), "shared": kept(fit.checkpoint), "unreached": 0}
    row = subject.row(name, cell, baseline=False, matches=False) | stored
    other = subject.paired(cell, subject.cell("meta")) if name != "meta" else None
    return row | paired_entries("meta", other)


def _row_of_baselines(subject: Subject, baseline: Baseline) -> Row:
    cell = baseline_cell(subject, baseline)
    records = cell.records()
    counts = [record["numbers"] for record in records if record["numbers"] is not None]
    stored = {
        "numbers": statistics.fmean(counts) if counts else None,
        "size": statistics.fmean(record["size"] for record in records) if records else None,
        "shared": records[-1]["shared"] if records else None,
        "unreached": sum(not record.get("reached", True) for record in records),
    }
    row = subject.row(baseline.name, cell, baseline=True, matches=baseline.matches) | stored
    return row | paired_entries("meta", subject.paired(cell, subject.cell("meta")))


def notes(subject: Subject, found: list[Row]) -> list[str]:
    """Which baselines have a lower error than Meta, at what cost, what they are and cannot do."""
    by = {row["paradigm"]: row for row in found}
    baselines, meta = tuple(_able(subject)), by["meta"]
    free = [by[baseline.name] for baseline in baselines if not baseline.matches]
    return [
        *(_ahead(row) for row in free if _wins(row)),
        *_behind(free),
        *(
            _matched(by[baseline.name], meta)
            for baseline in baselines
            if baseline.matches and by[baseline.name]["tasks"]
        ),
        *_missing(subject, found),
        *_described(baselines),
        "bytes: of what is kept of a task; shared: of what all tasks share, to be fitted or to be evaluated",
        caption_of(subject.app),
        *paired_note(found, "meta"),
        *on_threads(found),
        *budget(subject),
    ]


def _wins(row: Row) -> bool:
    """Whether a row's error is lower than Meta's by more than chance."""
    found = paired_of(row, "meta")
    return found is not None and bool(apart(found)) and found.value < found.level


def _ahead(row: Row) -> str:
    """By how much a baseline's error is lower than Meta's."""
    found = paired_of(row, "meta")
    assert found is not None
    return f"{row['paradigm']}: {compared_text(found, 'meta')}"


def _behind(found: list[Row]) -> list[str]:
    """The baselines of a higher error than Meta's, those that are level with it, and those that take more bytes."""
    told = {row["paradigm"]: each for row in found if (each := paired_of(row, "meta"))}
    behind = [name for name, each in told.items() if apart(each) and each.value > each.level]
    level = [name for name, each in told.items() if not apart(each)]
    large = [f"{row['paradigm']} on {row['unreached']} of {row['tasks']} tasks" for row in found if row["unreached"]]
    return [
        *([f"a higher error than meta's: {', '.join(behind)}"] if behind else []),
        *([f"no win either way: {', '.join(level)}"] if level else []),
        *([f"more bytes than a network's: {', '.join(large)}"] if large else []),
    ]


def _matched(row: Row, meta: Row) -> str:
    """How many bytes Meta's error takes."""
    share = row["size"] / meta["size"]
    said = f"{row['paradigm']}: {row['size']:,.0f} bytes at Meta's error, {share:.2g} of a network's"
    if row["unreached"]:
        said += f"; on {row['unreached']} of {row['tasks']} tasks it does not reach that error with all there are"
    return said


def _missing(subject: Subject, found: list[Row]) -> list[str]:
    """What has no records, and how to make them."""
    absent = [row["paradigm"] for row in found if not row["tasks"] and not row["baseline"]]
    said = [f"no records yet of {', '.join(absent)}; {subject.command('results')} makes them"] if absent else []
    if without := _untrained(subject):
        remedy = f"metapp data synth {subject.app.name} makes the embedded ones"
        said.append(f"{', '.join(without)}: no training tasks; {remedy}")
    return said


def _described(baselines: tuple[Baseline, ...]) -> list[str]:
    """What baselines are and cannot do, once for those that are the same."""
    named: dict[tuple[str, str], list[str]] = {}
    for baseline in baselines:
        if not baseline.matches:
            named.setdefault((baseline.title, baseline.cannot), []).append(baseline.name)
    return [f"{', '.join(names)}: {title}; cannot {cannot}" for (title, cannot), names in named.items()]


TABLE = Table(
    "baselines",
    "mean error{factor} and what is kept, beside what else there is",
    (
        words("method", "paradigm"),
        numbers("error", "error", ".3f"),
        numbers("seconds", "seconds", ".4f"),
        *paired_columns("meta"),
        numbers("numbers", "numbers", ",.0f"),
        bytes_column("bytes", "size"),
        bytes_column("shared bytes", "shared"),
        interval(),
        numbers("median", "median", ".3f"),
        numbers("worst", "worst", ".3f"),
    ),
    cells,
    rows,
    notes,
)
