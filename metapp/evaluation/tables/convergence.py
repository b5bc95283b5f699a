"""The paper's convergence: errors along Meta's steps, and how many further ones bring it within 1 % of Overfit."""

from __future__ import annotations

from collections.abc import Callable

from metapp.evaluation.tables.results import budget
from metapp.evaluation.tables.rows import Row, interval, numbers, paper, words
from metapp.evaluation.tables.subject import Cell, Record, Subject
from metapp.evaluation.tables.table import Table
from metapp.evaluation.tables.trace import FURTHER, PARTS, TRACED, at, near, trace_cell

Take = Callable[[Record], float | None]


def cells(subject: Subject) -> list[Cell]:
    """Traces of a few tasks."""
    return [trace_cell(subject)]


def rows(subject: Subject) -> list[Row]:
    """Meta's error after each part of its steps, then after further steps, and Overfit's on the same tasks."""
    cell, fits = trace_cell(subject), subject.fits
    steps = {name: fits[name].plan.steps for name in ("meta", "overfit")}
    made = [
        _row(subject, cell, "meta", after("meta", at(part, steps["meta"])), f"{part:.0%}", at(part, steps["meta"]))
        for part in PARTS
    ]
    last = _row(subject, cell, "meta", lambda record: record["further"][-1][1], "further", None)
    overfit = _row(subject, cell, "overfit", after("overfit", steps["overfit"]), "100%", steps["overfit"])
    needed = [steps_needed(record) for record in cell.records()]
    if needed:
        middle = sorted(needed, key=lambda value: FURTHER[-1] + 1 if value is None else value)[(len(needed) - 1) // 2]
        last |= {"further": middle, "near": sum(value is not None for value in needed)}
        last["step"] = f"+{middle}" if middle is not None else f"> +{FURTHER[-1]}"
    return [*made, last | {"paper_further": paper()["further_steps"]["steps"]}, overfit]


def _row(subject: Subject, cell: Cell, paradigm: str, take: Take, part: str, step: int | None) -> Row:
    more = {"part": part, "step": step, "further": None, "near": None, "paper_further": None}
    return subject.row(paradigm, cell, take, **more) | {"paper_error": None, "paper_seconds": None}


def after(paradigm: str, step: int) -> Take:
    """The error of a record's paradigm after so many steps."""
    return lambda record: next((error for at_step, error in record["curves"][paradigm] if at_step == step), None)


def steps_needed(record: Record) -> int | None:
    """Further steps after which Meta's error is within 1 % of Overfit's; None where FURTHER was not enough."""
    steps, error = record["further"][-1]
    overfit = record["curves"]["overfit"][-1][1]
    return steps if overfit is not None and near(error, overfit) else None


def notes(subject: Subject, found: list[Row]) -> list[str]:
    """What further steps are, how many they are, and in the paper."""
    told, last = paper()["further_steps"], found[-2]
    said = [
        f"further steps: Finetune's Adam from Meta's result, {', '.join(map(str, FURTHER))} of them; step: the median "
        f"over tasks of those after which Meta is within {told['within']:.0%} of Overfit",
    ]
    if last["near"] is not None:
        said.append(f"{last['near']} of {last['tasks']} tasks come so near (paper: {told['steps']} further steps)")
    return [*said, *budget(subject), f"traces of up to {TRACED} tasks, evenly spaced"]


TABLE = Table(
    "convergence",
    "error{factor} along Meta's steps",
    (
        words("paradigm", "paradigm"),
        words("of its steps", "part"),
        words("step", "step"),
        numbers("error", "error", ".3f"),
        interval(),
        numbers("paper further steps", "paper_further", "d"),
        numbers("median", "median", ".3f"),
        numbers("worst", "worst", ".3f"),
    ),
    cells,
    rows,
    notes,
)
