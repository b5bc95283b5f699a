"""The table of baselines: methods without a network, fitted to the same samples of the same tasks as paradigms."""

from __future__ import annotations

import statistics
from collections.abc import Iterator
from pathlib import Path

from metapp.evaluation.cell import Cell
from metapp.evaluation.notes import compared_text, few_note, measures_note, paired_note, threads_note
from metapp.evaluation.pictures import draw_cells
from metapp.evaluation.rows import Row, Table, against, bytes_column, columns, numbers, paired_of, row_of, words
from metapp.evaluation.subject import Subject
from metapp.evaluation.tables.storage import size, stored
from metapp.extensions.baselines import baselines_of
from metapp.extensions.baselines.baseline import Baseline
from metapp.extensions.baselines.fits import (
    ENTRIES,
    fit_baselines,
    own_parameters,
    settings_of,
    training_folder,
)
from metapp.learning.task import Params, Task
from metapp.runs.naming import caption_of, name_of
from metapp.runs.outputs.statistics import apart
from metapp.runs.reporter import say
from metapp.storage.fits import PARAMS, Record

SHOWN = ("general", "quickft", "meta", "finetune", "overfit")
RUN = SHOWN[:3]  # the others take long and stand here where there are records of them


def cells(subject: Subject) -> list[Cell]:
    """The fits of General, QuickFT and Meta, and of the baselines that there are training tasks for."""
    names = [*RUN, *_larger(subject)]
    return [*(subject.cell(name) for name in names), *(baseline_cell(subject, baseline) for baseline in _able(subject))]


def _larger(subject: Subject) -> list[str]:
    """Meta's rules that have a network of their own."""
    return [name for name, fit in subject.fits.items() if fit.app != subject.app and name not in SHOWN]


def _able(subject: Subject) -> list[Baseline]:
    """The baselines that lack neither training tasks nor, in any task, the tensor that holds their answers."""

    def able(baseline: Baseline) -> bool:
        if baseline.stored:
            return bool(subject.tasks) and all(baseline.stored in task.data for task in subject.tasks)
        return not (baseline.learns and subject.tasks) or training_folder(subject.plan, baseline) is not None

    return [baseline for baseline in baselines_of(subject.app) if able(baseline)]


def baseline_cell(subject: Subject, baseline: Baseline) -> Cell:
    """The fits of a baseline."""
    kept = None
    if subject.tasks and (not baseline.learns or training_folder(subject.plan, baseline)):
        settings = settings_of(subject.plan, baseline, subject.label)
        kept = subject.kept(f"baseline-{baseline.name}", settings, ENTRIES)

    def measured(tasks: list[Task]) -> Iterator[tuple[Record, Params | None]]:
        """The record and the picture of each task, as far as it can be fitted."""
        try:
            for record, picture, _ in fit_baselines(subject.plan, baseline, tasks):
                yield record, picture
        except ValueError as error:
            say(f"{name_of(subject.app)} {baseline.name}: {error}")

    return subject.make_cell(baseline.name, kept, measured)


def picture(subject: Subject) -> Path | None:
    """Draw Meta's fits and those of baselines that are pictures; None where either is missing."""
    meta, others = subject.cell("meta"), picture_cells(subject)
    return draw_cells(subject, {"meta": meta} | others, "baselines") if others and meta.whole else None


def picture_cells(subject: Subject) -> dict[str, Cell]:
    """The fits of the baselines that are measured and are pictures, by name."""
    cells = {baseline.name: baseline_cell(subject, baseline) for baseline in _able(subject)}
    measured = {name: cell for name, cell in cells.items() if cell.whole}
    return {name: cell for name, cell in measured.items() if Path(cell.records()[0]["folder"], PARAMS).is_file()}


def rows(subject: Subject) -> list[Row]:
    """The paradigms, then the baselines."""
    return [
        *(_row_of_paradigm(subject, name) for name in (*SHOWN, *_larger(subject))),
        *baseline_rows(subject),
    ]


def baseline_rows(subject: Subject) -> list[Row]:
    """The baselines alone."""
    return [_row_of_baseline(subject, baseline) for baseline in _able(subject)]


def _row_of_paradigm(subject: Subject, name: str) -> Row:
    fit = subject.fits[name]
    theta = own_parameters(fit.app)
    kept = {"numbers": sum(value.numel() for value in theta.values()), "size": size(theta)}
    entries = kept | {"shared": stored(fit.checkpoint), "baseline": False, "few": subject.is_of_few(name)}
    return row_of(subject, name, [subject.cell(name)], entries, against=against(subject, name, "meta"))


def _row_of_baseline(subject: Subject, baseline: Baseline) -> Row:
    cell, name = baseline_cell(subject, baseline), baseline.name
    records = cell.records()
    kept = {key: statistics.fmean(each[key] for each in records) if records else None for key in ("numbers", "size")}
    entries = kept | {"shared": records[-1]["shared"] if records else None, "baseline": True}
    return row_of(subject, name, [cell], entries, against=against(subject, name, "meta"))


def notes(subject: Subject, all_rows: list[Row]) -> list[str]:
    """Which baselines have a lower error than Meta, at what cost, what they are and cannot do."""
    by_name = {row["paradigm"]: row for row in all_rows}
    baselines = _able(subject)
    return [
        *_compared([by_name[baseline.name] for baseline in baselines]),
        *_missing(subject, all_rows),
        *_described(baselines),
        "bytes: of what is kept of a task; shared: of what all tasks share, to be fitted or to be evaluated",
        caption_of(subject.app),
        *measures_note(subject, all_rows),
        *paired_note(all_rows, "meta"),
        *threads_note(all_rows),
        *few_note(subject),
    ]


def _compared(all_rows: list[Row]) -> list[str]:
    """The baselines of a lower error than Meta's, of a higher one, and those not told apart."""
    pairs = {row["paradigm"]: pair for row in all_rows if (pair := paired_of(row, "meta"))}
    higher = [name for name, pair in pairs.items() if apart(pair) and pair.value > pair.level]
    level = [name for name, pair in pairs.items() if not apart(pair)]
    return [
        *(f"{name}: {compared_text(pairs[name], 'meta')}" for name in pairs if name not in (*higher, *level)),
        *([f"a higher error than meta's: {', '.join(higher)}"] if higher else []),
        *([f"no win either way: {', '.join(level)}"] if level else []),
    ]


def _missing(subject: Subject, all_rows: list[Row]) -> list[str]:
    """Rows without records, and the commands that make them."""
    absent = [row["paradigm"] for row in all_rows if not row["tasks"] and not row["baseline"]]
    lines = [f"no records yet of {', '.join(absent)}; {subject.command('results')} makes them"] if absent else []
    able = {baseline.name for baseline in _able(subject)}
    others = [baseline for baseline in baselines_of(subject.app) if baseline.name not in able]
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


COLUMNS = columns(
    words("method", "paradigm"),
    *("error", "seconds", "vs meta"),
    numbers("numbers", "numbers", ",.0f"),
    bytes_column("bytes", "size"),
    bytes_column("shared bytes", "shared"),
    *("interval", "median", "worst"),
)
TITLE = "mean error{factor} and what is kept, of paradigms and of methods without a network"
BASELINES = Table("baselines", TITLE, COLUMNS, rows, notes, cells, "Methods without a network", picture, baseline_rows)
