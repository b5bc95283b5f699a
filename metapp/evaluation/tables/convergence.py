"""The paper's convergence: errors along Meta's steps, and how many further ones bring it within 1 % of Overfit."""

from __future__ import annotations

from metapp.evaluation.cell import Cell, Record
from metapp.evaluation.notes import overfit_note
from metapp.evaluation.rows import Row, Table, Take, columns, numbers, paper, row_of, words
from metapp.evaluation.subject import Subject
from metapp.evaluation.trace import FURTHER, PARTS, TRACED, near, step_at, trace_cell


def cells(subject: Subject) -> list[Cell]:
    """Traces of a few tasks."""
    return [trace_cell(subject)]


def rows(subject: Subject) -> list[Row]:
    """Meta's error after each part of its steps, then after further steps, and Overfit's on the same tasks."""
    cell, nothing = trace_cell(subject), {"further": None, "near": None, "paper_further": None}

    def row(paradigm: str, part: str, step: int | None, take: Take) -> Row:
        entries = {"part": part, "step": step, **nothing}
        return row_of(subject, paradigm, [cell], entries, take=take, beside_paper=False)

    steps = {name: subject.fits[name].steps for name in ("meta", "overfit")}
    along = [(part, step_at(part, steps["meta"])) for part in PARTS]
    all_rows = [row("meta", f"{part:.0%}", step, after("meta", step)) for part, step in along]
    last = row("meta", "further", None, lambda record: record["further"][-1][1])
    if needed := [steps_needed(record) for record in cell.records()]:
        middle = sorted(needed, key=lambda value: FURTHER[-1] + 1 if value is None else value)[(len(needed) - 1) // 2]
        last |= {"further": middle, "near": sum(value is not None for value in needed)}
        last["step"] = f"+{middle}" if middle is not None else f"> +{FURTHER[-1]}"
    last["paper_further"] = paper()["further_steps"]["steps"]
    return [*all_rows, last, row("overfit", "100%", steps["overfit"], after("overfit", steps["overfit"]))]


def after(paradigm: str, step: int) -> Take:
    """The error of a record's paradigm after so many steps."""
    return lambda record: next((error for count, error in record["curves"][paradigm] if count == step), None)


def steps_needed(record: Record) -> int | None:
    """Further steps after which Meta's error is within 1 % of Overfit's; None where FURTHER was not enough."""
    steps, error = record["further"][-1]
    overfit = record["curves"]["overfit"][-1][1]
    return steps if overfit is not None and near(error, overfit) else None


def notes(subject: Subject, all_rows: list[Row]) -> list[str]:
    """What further steps are, how many they are, and in the paper."""
    known, last = paper()["further_steps"], all_rows[-2]
    lines = [
        f"further steps: Finetune's Adam from Meta's result, {', '.join(map(str, FURTHER))} of them; step: the median "
        f"over tasks of those after which Meta is within {known['within']:.0%} of Overfit",
    ]
    if last["near"] is not None:
        lines.append(f"{last['near']} of {last['tasks']} tasks come so near (paper: {known['steps']} further steps)")
    return [*lines, *overfit_note(subject), f"traces of up to {TRACED} tasks, evenly spaced"]


COLUMNS = columns(
    "paradigm",
    *(words("of its steps", "part"), words("step", "step")),
    *("error", "interval", numbers("paper further steps", "paper_further", "d"), "median", "worst"),
)
TABLE = Table("convergence", "error{factor} along Meta's steps", COLUMNS, rows, notes, cells)
