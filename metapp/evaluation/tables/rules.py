"""The rule study as a table: every rule, trained alike, at several numbers of gradient steps, beside a tuned Adam."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator, Sequence
from functools import partial
from typing import Any

from metapp.evaluation.study import QUICKFT, Case
from metapp.evaluation.tables.results import on_threads
from metapp.evaluation.tables.rows import Row, blank, interval, numbers, words
from metapp.evaluation.tables.seeds import Errors, paired_over_seeds, statistics_of_seeds
from metapp.evaluation.tables.statistics import apart, paired_columns, paired_entries, paired_note, paired_of
from metapp.evaluation.tables.subject import Cell, Record, Subject, remarks
from metapp.evaluation.tables.table import Table
from metapp.learning.learn import MetaParameters
from metapp.learning.task import Task
from metapp.runs.reporter import number, say
from metapp.runs.run import fit_and_keep, run_path
from metapp.runs.session import Checkpoint, caption_of, name_of, observe_of, settings_of, threads_of
from metapp.storage.records import FIT, NUMBER, OPTIONAL, RunFolder, digest

TRAINED = {"error": OPTIONAL, "seconds": NUMBER, "step": OPTIONAL}  # of a training's record
STARTS = {
    "random": "a random initialisation",
    "mean": "the mean of General's predictions",
    "encoder": "General's own, which QuickFT starts from, too",
}
A_STEP = 5e-3  # seconds of an outer step, for each gradient step, before any was measured


def cells(subject: Subject) -> list[Cell]:
    """A training and its fits for each case, one after the other."""
    if not subject.tasks or (not subject.run and subject.study.general is None):
        return [Cell(f"{name_of(subject.app)} rules", [], None, lambda missing: iter(()), 0, _command(subject))]
    found: dict[Any, Cell] = {}  # QuickFT's search is the same for all seeds
    for case in subject.study.cases():
        for cell in (train_cell(subject, case), fit_cell(subject, case)):
            assert cell.folder is not None
            found.setdefault(cell.folder.path, cell._replace(stage=len(found)))
    return list(found.values())


def train_cell(subject: Subject, case: Case) -> Cell:
    """One training; its record holds its seconds, the validation error and the outer step of that."""
    study = subject.study
    said = study.settings(case, subject.label)
    path = subject.options.out / subject.app.name / "rules" / f"{subject.label}-{study.place(case).recipe}"
    path = path.with_name("-".join(filter(None, (path.name, f"seed{said['seed']}", case.rule, subject.app.protocol))))
    folder = RunFolder(path, said, TRAINED)

    def measure(missing: list[Task]) -> Iterator[Record]:
        for task in missing:
            record = {"name": task.name, **_trained(subject, case)}
            folder.add(record)
            yield record

    outer = 0 if case.rule == QUICKFT else study.training(case.rule).steps
    return Cell(
        f"{name_of(subject.app)} rules: train {case.rule}, {case.steps} steps, seed {said['seed']}",
        [Task(case.rule, {})],
        folder,
        measure,
        case.steps,
        _command(subject),
        threads=threads_of(subject.app),
        guess=case.steps * A_STEP * max(outer, 1),
    )


def _command(subject: Subject) -> str:
    """The command of the whole study."""
    budget = subject.study.budget
    words = ["--train-steps", str(budget.outer), *(word for each in budget.steps for word in ("--steps", str(each)))]
    words += [
        "--seeds",
        str(budget.seeds),
        "--start",
        budget.start,
        *(word for rule in budget.rules for word in ("--rule", rule)),
    ]
    return f"{subject.command('rules')} {' '.join(words)}"


def _trained(subject: Subject, case: Case) -> Record:
    """Train a case; a training that diverges is a result, too."""
    begin = time.process_time()
    try:
        _, prepared, seconds = subject.study.train(case)
    except FloatingPointError as error:
        say(f"warning: {case.rule}, {case.steps} steps, seed {case.seed}: {error}")
        return {"error": None, "seconds": time.process_time() - begin, "step": None}
    return {"error": prepared.validation, "seconds": seconds, "step": prepared.step}


def _diverged(cell: Cell) -> bool:
    """Whether a training has a record of having failed."""
    return any(record["step"] is None for record in cell.records())


def fit_cell(subject: Subject, case: Case) -> Cell:
    """Fits of all test tasks by what a case has trained."""
    study = subject.study
    options, trained = study.place(case), digest(study.settings(case, subject.label))
    said = settings_of(options, case.paradigm, Checkpoint(MetaParameters(), "", trained), subject.label)
    if case.rule == QUICKFT:
        said["adam"] = "searched"
    folder = RunFolder(run_path(options, said, subject.label), said, FIT)

    def measure(missing: list[Task]) -> Iterator[Record]:
        if _diverged(train_cell(subject, case)):
            return
        try:
            yield from fit_and_keep(options, case.paradigm, study.checkpoint(case), missing, folder)
        except FloatingPointError as error:
            say(f"warning: {case.rule}, {case.steps} steps, seed {case.seed}: {error}")

    return Cell(
        f"{name_of(subject.app)} rules: {case.rule}, {case.steps} steps, seed {case.seed}",
        subject.tasks,
        folder,
        measure,
        case.steps,
        _command(subject),
        threads=threads_of(subject.app),
    )


def rows(subject: Subject) -> list[Row]:
    """A row for each rule and number of steps that has fits of all tasks, of all seeds that have."""
    if not subject.tasks or (not subject.run and subject.study.general is None):
        return []
    study, found = subject.study, []
    for steps in sorted(set(study.budget.steps)):
        reference = _errors(_complete(subject, QUICKFT, steps))
        for rule in (QUICKFT, *study.rules):
            done = _complete(subject, rule, steps)
            if done:
                found.append(_row(subject, rule, steps, done, reference if rule != QUICKFT else []))
    return found


def _complete(subject: Subject, rule: str, steps: int) -> list[tuple[Case, Cell]]:
    """The seeds of a rule whose training and fits are all done."""
    each = [case for case in subject.study.cases() if (case.rule, case.steps) == (rule, steps)]
    both = [(case, fit_cell(subject, case)) for case in each]
    return [(case, cell) for case, cell in both if not cell.missing() and not train_cell(subject, case).missing()]


def _errors(done: Sequence[tuple[Case, Cell]]) -> list[Errors]:
    return [
        {record["name"]: record["error"] for record in cell.records() if record["error"] is not None}
        for _, cell in done
    ]


def _row(
    subject: Subject, rule: str, steps: int, done: Sequence[tuple[Case, Cell]], reference: Sequence[Errors]
) -> Row:
    records = [record for _, cell in done for record in cell.records()]
    trainings = [train_cell(subject, case).records()[0] for case, _ in done]
    groups, errors = subject.groups(done[0][1]), _errors(done)
    row = blank(subject.app.name, QUICKFT if rule == QUICKFT else "meta", **observe_of(subject.app))
    row |= statistics_of_seeds(errors, groups) | remarks(records)
    row |= {
        "paper_error": None,
        "paper_seconds": None,
        "rule": f"{QUICKFT} (tuned Adam)" if rule == QUICKFT else rule,
        "steps": steps,
        "seeds": len(done),
        "seconds": statistics.median(record["seconds"] for record in records),
        "train_seconds": statistics.fmean(record["seconds"] for record in trainings),
        "validation": statistics.fmean(record["error"] for record in trainings),
        "start": subject.study.budget.start,
        "outer": None if rule == QUICKFT else subject.study.training(rule).steps,
        "tasks": len(subject.tasks),
    }
    compare = partial(paired_over_seeds, groups=groups, logarithmic=subject.presentation.logarithmic)
    found = compare(errors, reference) if reference else None
    return row | paired_entries(QUICKFT, found) | {"apart": apart(found)} | subject.app.conditions()


def notes(subject: Subject, found: list[Row]) -> list[str]:
    """The budget, who wins at each number of steps, what seconds are, what was not run and what does not apply."""
    study = subject.study
    budget, usual = study.budget, study.options.job.recipe.training(study.options.rule).steps
    said = [
        f"each rule is trained for {budget.outer:,} outer steps (the recipe: {usual:,}) at each number of steps, from "
        f"{STARTS[budget.start]}; its best state on validation tasks is kept",
        *(f"{steps} steps: {_winners(found, steps)}" for steps in sorted({row["steps"] for row in found})),
        "seconds: median of a fit; training s: mean processor time of one training, General's not counted; of "
        f"{QUICKFT} the search of its Adam at that number of steps",
        "95 % intervals: bootstrap over tasks and over seeds",
        caption_of(subject.app),
        *paired_note(found),
        *on_threads(found),
    ]
    refused = [f"{rule}: does not apply, {reason}" for rule, reason in study.refused.items()]
    return [*said, *_not_run(subject, found), *refused]


def _winners(found: list[Row], steps: int) -> str:
    """The rule of the lowest error, and how many rules are below, level with and above the tuned Adam."""
    here = [row for row in found if row["steps"] == steps]
    best = min(here, key=lambda row: row["error"])
    compared = [(row, pair) for row in here if (pair := paired_of(row, QUICKFT))]
    below = sum(bool(row["apart"]) and pair.value < pair.level for row, pair in compared)
    above = sum(bool(row["apart"]) and pair.value > pair.level for row, pair in compared)
    level = len(compared) - below - above
    return (
        f"lowest {best['rule']} {number(best['error'], '.3f')}; of {len(compared)} rules {below} are below {QUICKFT}, "
        f"{above} above, {level} not told apart"
    )


def _not_run(subject: Subject, found: list[Row]) -> list[str]:
    """What the budget holds that has no row, as it was not run or diverged."""
    study, there = subject.study, {(row["rule"], row["steps"]) for row in found}
    said = []
    for steps in sorted(set(study.budget.steps)):
        missing = [rule for rule in study.rules if (rule, steps) not in there]
        diverged = [rule for rule in missing if _diverged(train_cell(subject, Case(rule, steps, study.options.seed)))]
        rest = [rule for rule in missing if rule not in diverged]
        said += [f"{steps} steps: training diverged: {', '.join(diverged)}"] if diverged else []
        said += [f"{steps} steps: not run: {', '.join(rest)}"] if rest else []
    return said


TABLE = Table(
    "rules",
    "mean error{factor} of update rules after few outer steps",
    (
        words("rule", "rule"),
        numbers("steps", "steps", "d"),
        numbers("error", "error", ".3f"),
        *paired_columns(QUICKFT),
        numbers("seconds", "seconds", ".4f"),
        numbers("training s", "train_seconds", ".0f"),
        numbers("seeds", "seeds", "d"),
        interval(),
        numbers("validation", "validation", ".3f"),
        numbers("worst", "worst", ".3f"),
    ),
    cells,
    rows,
    notes,
)
