"""The rule study as a table: every rule, trained alike, at several numbers of gradient steps, beside a tuned Adam."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from benchmarks.rule_study import QUICKFT, Case, Design, Study
from metapp.evaluation.cell import Cell
from metapp.evaluation.notes import paired_note, threads_note
from metapp.evaluation.rows import Row, Table, columns, numbers, paired_of, row_of
from metapp.evaluation.subject import Subject
from metapp.learning.learn import MetaParameters
from metapp.learning.task import Params, Task
from metapp.runs.fits.fitter import fit_tasks
from metapp.runs.outputs.statistics import apart
from metapp.runs.reporter import number, say
from metapp.runs.requests.naming import caption_of
from metapp.runs.requests.plan import Checkpoint, Plan
from metapp.storage.forms import NUMBER, OPTIONAL
from metapp.storage.records import FIT, Record, RunFolder, digest

TRAINED = {"error": OPTIONAL, "seconds": NUMBER, "step": OPTIONAL}  # of a training's record
INITIALISATIONS = {
    "random": "a random initialisation",
    "mean": "the mean of General's predictions",
    "encoder": "General's own prediction, which QuickFT begins at, too",
}


class Studied(Subject):
    """An application on a data set, and the study of its rules."""

    def __init__(self, plan: Plan, design: Design) -> None:
        super().__init__(plan, run=True, strict=True)
        self.study = Study(plan, design)


def study_of(subject: Subject) -> Study:
    """The study of a subject that has one."""
    assert isinstance(subject, Studied)
    return subject.study


def cells(subject: Subject) -> list[Cell]:
    """A training and its fits for each case, one after the other."""
    cases = study_of(subject).cases()
    once: dict[Path, Cell] = {}  # QuickFT's search is the same for all seeds
    for cell in (cell for case in cases for cell in (train_cell(subject, case), fit_cell(subject, case))):
        assert cell.folder is not None
        once.setdefault(cell.folder.path, cell)
    return [cell._replace(stage=i) for i, cell in enumerate(once.values())]


def train_cell(subject: Subject, case: Case) -> Cell:
    """One training; its record holds its seconds, the validation error and the outer step of that."""
    study = study_of(subject)
    settings = study.settings(case, subject.label)
    recipe, seed = study.plan_of(case).request.recipe, settings["seed"]
    words = [subject.label, recipe, f"seed{seed}", case.rule, subject.app.protocol]
    path = subject.plan.request.out / subject.app.name / "rules" / "-".join(filter(None, words))

    def measure(tasks: list[Task]) -> Iterator[tuple[Record, None]]:
        for task in tasks:
            yield {"name": task.name, **_trained(subject, case)}, None

    title = f"rules: train {case.rule}, {case.steps} steps, seed {seed}"
    folder = RunFolder(path, settings, TRAINED)
    outer = 1 if case.rule == QUICKFT else study.training(case.rule).steps
    cell = subject.make_cell(title, folder, measure, case.steps * outer)
    return cell._replace(tasks=[Task(case.rule, {})])


def _trained(subject: Subject, case: Case) -> Record:
    """Train a case; a training that diverges is a result, too."""
    begin = time.process_time()
    try:
        _, _, prepared, seconds = study_of(subject).train(case)
    except FloatingPointError as error:
        say(f"warning: {case.rule}, {case.steps} steps, seed {case.seed}: {error}")
        return {"error": None, "seconds": time.process_time() - begin, "step": None}
    return {"error": prepared.validation, "seconds": seconds, "step": prepared.step}


def _diverged(cell: Cell) -> bool:
    """True if a training has a record of having failed."""
    return any(record["step"] is None for record in cell.records())


def fit_cell(subject: Subject, case: Case) -> Cell:
    """Fits of all test tasks by what a case has trained."""
    study = study_of(subject)
    trained = Checkpoint(MetaParameters(), "", digest(study.settings(case, subject.label)))
    plan = replace(study.plan_of(case), checkpoint=trained)
    settings = plan.settings(subject.label)
    if case.rule == QUICKFT:
        settings["adam"] = "searched"

    def measure(tasks: list[Task]) -> Iterator[tuple[Record, Params]]:
        if _diverged(train_cell(subject, case)):
            return
        try:
            yield from fit_tasks(replace(plan, checkpoint=study.checkpoint(case)), tasks)
        except FloatingPointError as error:
            say(f"warning: {case.rule}, {case.steps} steps, seed {case.seed}: {error}")

    title = f"rules: {case.rule}, {case.steps} steps, seed {case.seed}"
    folder = RunFolder(plan.path(subject.label), settings, FIT)
    return subject.make_cell(title, folder, measure, case.steps)


def rows(subject: Subject) -> list[Row]:
    """A row for each rule and number of steps that has fits of all tasks, of all seeds that have."""
    study, all_rows = study_of(subject), []
    for steps in sorted(set(study.design.steps)):
        reference = [cell for _, cell in _complete(subject, QUICKFT, steps)]
        for rule in (QUICKFT, *study.rules):
            if done := _complete(subject, rule, steps):
                all_rows.append(_row(subject, rule, steps, done, reference if rule != QUICKFT else []))
    return all_rows


def _complete(subject: Subject, rule: str, steps: int) -> list[tuple[Cell, Cell]]:
    """Training and fits of the seeds of a rule of which both are all done."""
    cases = [case for case in study_of(subject).cases() if (case.rule, case.steps) == (rule, steps)]
    both = [(train_cell(subject, case), fit_cell(subject, case)) for case in cases]
    return [(training, fits) for training, fits in both if not fits.missing() and not training.missing()]


def _row(subject: Subject, rule: str, steps: int, done: list[tuple[Cell, Cell]], reference: list[Cell]) -> Row:
    trainings = [training.records()[0] for training, _ in done]
    of_quickft = rule == QUICKFT
    entries = {
        "rule": f"{QUICKFT} (tuned Adam)" if of_quickft else rule,
        "steps": steps,
        "seeds": len(done),
        "train_seconds": statistics.fmean(record["seconds"] for record in trainings),
        "validation": statistics.fmean(record["error"] for record in trainings),
        "start": study_of(subject).design.initialisation,
        "outer": None if of_quickft else study_of(subject).training(rule).steps,
    }
    cells, name = [fits for _, fits in done], QUICKFT if of_quickft else "meta"
    row = row_of(subject, name, cells, entries, against={QUICKFT: reference}, beside_paper=False)
    return row | {"apart": apart(paired_of(row, QUICKFT))}


def notes(subject: Subject, all_rows: list[Row]) -> list[str]:
    """The design, who wins at each number of steps, what seconds are, what was not run and what does not apply."""
    study = study_of(subject)
    design, usual = study.design, study.plan.job.recipe.training(study.plan.job.rule).steps
    return [
        f"each rule is trained for {design.train_steps:,} outer steps (the recipe: {usual:,}) at each number of steps, "
        f"from {INITIALISATIONS[design.initialisation]}; its best state on validation tasks is kept",
        *(f"{steps} steps: {_winners(all_rows, steps)}" for steps in sorted({row["steps"] for row in all_rows})),
        "seconds: median of a fit; training s: mean processor time of one training, General's not counted; of "
        f"{QUICKFT} the search of its Adam at that number of steps",
        "95 % intervals: bootstrap over tasks and over seeds",
        caption_of(subject.app),
        *paired_note(all_rows),
        *threads_note(all_rows),
        *_diverging(subject, all_rows),
        *(f"{rule}: does not apply, {reason}" for rule, reason in study.refused.items()),
    ]


def _winners(all_rows: list[Row], steps: int) -> str:
    """The rule of the lowest error, and how many rules are below, level with and above the tuned Adam."""
    rows_here = [row for row in all_rows if row["steps"] == steps]
    best = min(rows_here, key=lambda row: row["error"])
    compared = [(row, pair) for row in rows_here if (pair := paired_of(row, QUICKFT))]
    below = sum(bool(row["apart"]) and pair.value < pair.level for row, pair in compared)
    above = sum(bool(row["apart"]) and pair.value > pair.level for row, pair in compared)
    return (
        f"lowest {best['rule']} {number(best['error'], '.3f')}; of {len(compared)} rules {below} are below {QUICKFT}, "
        f"{above} above, {len(compared) - below - above} not told apart"
    )


def _diverging(subject: Subject, all_rows: list[Row]) -> list[str]:
    """The rules whose training diverged, by number of steps."""
    study, there = study_of(subject), {(row["rule"], row["steps"]) for row in all_rows}
    lines = []
    for steps in sorted(set(study.design.steps)):
        missing = [rule for rule in study.rules if (rule, steps) not in there]
        lines += [f"{steps} steps: training diverged: {', '.join(missing)}"] if missing else []
    return lines


COLUMNS = columns(
    *("rule", "steps", "error", "vs quickft", "seconds"),
    numbers("training s", "train_seconds", ".0f"),
    numbers("seeds", "seeds", "d"),
    "interval",
    numbers("validation", "validation", ".3f"),
    "worst",
)
RULES = Table("rules", "mean error{factor} of update rules after few outer steps", COLUMNS, rows, notes, cells)
