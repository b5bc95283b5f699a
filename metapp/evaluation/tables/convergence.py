"""The paper's convergence: traces of fits along their steps, and further steps that bring Meta within 1 % of Overfit.

The fits of rows are timed, so nothing is measured during them; here the same fits, of the same draws, are made again
for a few tasks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from metapp.apps import protocol_entry
from metapp.evaluation.rows import make_row, paper_figures
from metapp.evaluation.subject import EvaluationRun, select_evenly
from metapp.evaluation.table import Column, Row, Table, columns
from metapp.learning.app import stack_tasks
from metapp.learning.learn import learn, task_loss
from metapp.learning.rules import fixed_adam
from metapp.learning.task import Params, Task, Tasks
from metapp.runs.fitting import rng_of
from metapp.storage.fit_folders import Record

TRACED_TASKS = 5  # tasks
STEP_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
CURVE_PARADIGMS = ("overfit", "finetune", "quickft", "meta")
FURTHER_STEPS = (8, 16, 32, 65, 130)  # steps after Meta's
CONVERGENCE_COLUMNS = columns(
    "paradigm",
    *(Column("of its steps", "part"), Column("step", "step")),
    *("error", "interval", Column("paper further steps", "paper_further", "d"), "median", "worst"),
)


def convergence(subject: EvaluationRun) -> Table:
    """Meta's error after each part of its steps, then after further steps, and Overfit's on the same tasks."""
    records, known = trace_records(subject), paper_figures()["further_steps"]

    def row(paradigm: str, part: str, step: object, errors: Sequence[float | None]) -> Row:
        traced = [record | {"error": error} for record, error in zip(records, errors, strict=True)]
        entries = {"part": part, "step": step, "further": None, "near": None, "paper_further": None}
        return make_row(subject, paradigm, traced, entries)

    def after(paradigm: str, part: float) -> Row:
        step = step_at(part, subject.runs[paradigm].paradigm.steps)
        return row(paradigm, f"{part:.0%}", step, [dict(one["curves"][paradigm]).get(step) for one in records])

    last = row("meta", "further", None, [record["further"][-1][1] for record in records])
    last["paper_further"] = known["steps"]
    notes = [
        f"further steps: Finetune's Adam from Meta's result, {', '.join(map(str, FURTHER_STEPS))} of them; step: the median "
        f"over tasks of those after which Meta is within {known['within']:.0%} of Overfit",
    ]
    if needed := [further_steps_needed(record) for record in records]:
        middle = sorted(needed, key=lambda value: FURTHER_STEPS[-1] + 1 if value is None else value)[
            (len(needed) - 1) // 2
        ]
        last |= {"further": middle, "near": sum(value is not None for value in needed)}
        last["step"] = f"+{middle}" if middle is not None else f"> +{FURTHER_STEPS[-1]}"
        notes.append(f"{last['near']} of {len(records)} tasks come so near (paper: {known['steps']} further steps)")
    notes.append(f"traces of {len(_traced(subject))} of {len(subject.tasks)} tasks, evenly spaced")
    rows = [*(after("meta", part) for part in STEP_SHARES), last, after("overfit", 1.0)]
    title = f"error{subject.app.error_measure.factor} along Meta's steps"
    return Table(subject.title, title, CONVERGENCE_COLUMNS, rows, notes)


def further_steps_needed(record: Record) -> int | None:
    """Further steps after which Meta's error is within 1 % of Overfit's; None if FURTHER was not enough."""
    steps, error = record["further"][-1]
    return steps if is_near(error, record["curves"]["overfit"][-1][1]) else None


def is_near(error: float | None, wanted: float | None) -> bool:
    """True if an error is at most so much above another as the paper's are in the end."""
    if error is None or wanted is None:
        return False
    within: float = paper_figures()["further_steps"]["within"]
    return error - wanted <= within * abs(wanted)


# Traces


def _traced(subject: EvaluationRun) -> list[Task]:
    return select_evenly(subject.tasks, TRACED_TASKS if subject.whole else subject.few)


def trace_records(subject: EvaluationRun) -> list[Record]:
    """Traces of a few tasks: errors of each paradigm along its steps, and of further steps of Meta."""
    settings = {"app": subject.app.name, **protocol_entry(subject.app), "further": FURTHER_STEPS}
    kept = subject.kept("trace", settings, ("curves", "further"), CURVE_PARADIGMS)
    steps = sum(subject.runs[name].paradigm.steps for name in CURVE_PARADIGMS) + sum(FURTHER_STEPS)

    def measure(tasks: list[Task]) -> Iterator[tuple[Record, None]]:
        return ((_trace(subject, task), None) for task in tasks)

    return subject.measured("trace", kept, measure, _traced(subject), steps)


def step_at(part: float, steps: int) -> int:
    """The step at which so much of the steps is done."""
    return round(part * steps)


def curve_steps(steps: int) -> set[int]:
    """Steps of measured errors: at PARTS, and at a quarter of the rest of these, again and again."""
    return {step_at(part, steps) for part in STEP_SHARES} | {round(steps / 4**i) for i in range(2, 16) if steps >= 4**i}


def _trace(subject: EvaluationRun, task: Task) -> Record:
    """The record of one task."""
    stacked = stack_tasks(subject.app, [task], subject.run.device)
    curves: dict[str, list[tuple[int, float | None]]] = {}
    for name in CURVE_PARADIGMS:
        run = subject.runs[name]
        measured = curve_steps(run.paradigm.steps)
        descent = run.paradigm.descend(run.phi, stacked, rng_of(run, task))  # the fit of the row
        states = {now.step: now.theta for now in descent if now.step in measured}  # [1, ...] each
        curves[name] = [(step, _error_of(subject, states[step], stacked)) for step in sorted(measured)]
    meta = states[run.paradigm.steps]  # the last of CURVES
    further = _further(subject, task, stacked, meta, curves["overfit"][-1][1])
    return {"name": task.name, "error": curves["meta"][-1][1], "curves": curves, "further": further}


def _error_of(subject: EvaluationRun, theta: Params, stacked: Tasks) -> float | None:
    """The table's error; None if the task holds no reference."""
    errors = subject.app.errors(theta, stacked)
    return subject.app.error_measure.scale * float(errors["error"][0]) if errors else None


def _further(
    subject: EvaluationRun, task: Task, stacked: Tasks, theta: Params, wanted: float | None
) -> list[tuple[int, float | None]]:
    """Errors after further steps by Finetune's Adam from Meta's result, until one is within 1 % of Overfit's.

    Returns:
        (steps, error); each is a descent of its own, whose rate decays to the end.
    """
    recipe = subject.run.recipe
    errors = [(0, _error_of(subject, theta, stacked))]
    for steps in FURTHER_STEPS:
        if wanted is None or is_near(errors[-1][1], wanted):
            break
        rng = rng_of(subject.run, task)
        rule, loss = fixed_adam(recipe.finetune, theta, steps), task_loss(subject.app, recipe.batch)
        errors.append((steps, _error_of(subject, learn(theta, rule, stacked, loss, steps=steps, rng=rng), stacked)))
    return errors
