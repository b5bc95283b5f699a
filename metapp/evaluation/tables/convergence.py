"""The paper's convergence: traces of fits along their steps, and further steps that bring Meta within 1 % of Overfit.

The fits of other cells are timed, so nothing is measured during them; here the same fits, of the same draws, are made
again for a few tasks.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping

import torch
from torch import Tensor

from metapp.evaluation.cell import Cell
from metapp.evaluation.rows import Row, Table, Take, columns, numbers, paper, row_of, words
from metapp.evaluation.subject import Subject, evenly
from metapp.learning.app import stack
from metapp.learning.learn import learn, task_loss
from metapp.learning.rules import fixed_adam
from metapp.learning.task import Params, Task, Tasks
from metapp.runs.fitting import rng_of
from metapp.runs.naming import observe_of
from metapp.runs.run import Run
from metapp.storage.checkpoints import digest
from metapp.storage.fits import Record, read_params

TRACED = 5  # tasks
PARTS = (0.0, 0.25, 0.5, 0.75, 1.0)
CURVES = ("overfit", "finetune", "quickft", "meta")
FURTHER = (8, 16, 32, 65, 130)  # steps after Meta's
WALKED = 32  # steps between the places on a path
ENTRIES = ("curves", "further", "paths", "explained")  # of a record


def trace_cell(subject: Subject) -> Cell:
    """Traces of a few tasks."""
    fits = {name: subject.fits[name] for name in CURVES}
    kept = None
    if all(fit.checkpoint for fit in fits.values()):
        keys = [digest(fit.settings(subject.label)) for fit in fits.values()]
        subject_settings = {"app": subject.app.name, **observe_of(subject.app), "fits": keys}
        settings = subject_settings | {"further": FURTHER, "walked": WALKED}
        kept = subject.kept("trace", settings, ENTRIES, of_fits=True)

    def measure(tasks: list[Task]) -> Iterator[tuple[Record, Params]]:
        return (trace(subject, fits, task) for task in tasks)

    steps = sum(fit.steps for fit in fits.values()) + sum(FURTHER)
    cell = subject.make_cell("trace", kept, measure, steps)
    return cell._replace(tasks=evenly(list(cell.tasks), TRACED))


def trace(subject: Subject, fits: Mapping[str, Run], task: Task) -> tuple[Record, Params]:
    """One task: errors of each paradigm along its steps, paths, and what further steps bring Meta.

    Returns:
        The record, and Meta's parameters at PARTS of its steps, as of `named`.
    """
    stacked = stack(subject.app, [task], subject.plan.device)
    curves: dict[str, list[tuple[int, float | None]]] = {}
    paths: dict[str, list[Params]] = {}
    for name, fit in fits.items():
        measured = curve_steps(fit.steps)
        walked = path_steps(fit.steps) if name in ("overfit", "meta") else set()
        states = states_of(fit, task, stacked, measured | walked)
        curves[name] = [(step, error_of(subject, states[step], stacked)) for step in sorted(measured)]
        paths[name] = [states[step] for step in sorted(walked)]
        if name == "meta":
            parts = {part: states[step_at(part, fit.steps)] for part in PARTS}
    places, explained = project_paths(paths["meta"], paths["overfit"])
    record = {
        "name": task.name,
        "error": curves["meta"][-1][1],
        "curves": curves,
        "further": further_errors(subject, task, stacked, parts[1.0], curves["overfit"][-1][1]),
        "paths": places,
        "explained": explained,
    }
    return record, named(parts)


def named(parts: dict[float, Params]) -> Params:
    """Parameters [1, ...] at PARTS of the steps as `<part>/<name>`, [...] each.

    Each has memory of its own, as files ask for; a rule that solves leaves most parameters as they are.
    """
    return {f"{part:g}/{key}": value[0].clone() for part, theta in parts.items() for key, value in theta.items()}


def step_at(part: float, steps: int) -> int:
    """The step at which so much of the steps is done."""
    return round(part * steps)


def curve_steps(steps: int) -> set[int]:
    """Where errors are measured: at PARTS, and at a quarter of what is left of these, again and again."""
    counts = {step_at(part, steps) for part in PARTS}
    early = steps / 16
    while early >= 1:
        counts.add(round(early))
        early /= 4
    return counts


def path_steps(steps: int) -> set[int]:
    """Where a path is marked: evenly in the square root of the step, as it moves fastest at first."""
    return {round(steps * (i / WALKED) ** 2) for i in range(WALKED + 1)}


def states_of(plan: Run, task: Task, stacked: Tasks, wanted: Collection[int]) -> dict[int, Params]:
    """The same fit as the row's: its parameters [1, ...] after the wanted numbers of steps."""
    descent = plan.paradigm.descend(plan.phi, stacked, rng_of(plan, task))
    return {now.step: now.theta for now in descent if now.step in wanted}


def error_of(subject: Subject, theta: Params, stacked: Tasks) -> float | None:
    """The table's error; None where the task holds no reference."""
    errors = subject.app.errors(theta, stacked)
    return subject.app.scale * float(errors["error"][0]) if errors else None


def further_errors(
    subject: Subject, task: Task, stacked: Tasks, theta: Params, wanted: float | None
) -> list[tuple[int, float | None]]:
    """Errors after further steps by Finetune's Adam from Meta's result, until one is within 1 % of Overfit's.

    Returns:
        (steps, error); each is a descent of its own, whose rate decays to the end.
    """
    recipe = subject.plan.recipe
    errors: list[tuple[int, float | None]] = [(0, error_of(subject, theta, stacked))]
    for steps in FURTHER:
        if wanted is None or near(errors[-1][1], wanted):
            break
        rng = rng_of(subject.plan, task)
        rule, loss = fixed_adam(recipe.finetune, theta, steps), task_loss(subject.app, recipe.batch)
        errors.append((steps, error_of(subject, learn(theta, rule, stacked, loss, steps=steps, rng=rng), stacked)))
    return errors


def near(error: float | None, wanted: float) -> bool:
    """True if an error is at most so much above another as the paper's are in the end."""
    return error is not None and error - wanted <= paper()["further_steps"]["within"] * abs(wanted)


def project_paths(meta: list[Params], overfit: list[Params]) -> tuple[dict[str, list[list[float]]], float]:
    """Both paths in the plane of most variance, and its share; no places where Meta's rule has another network."""
    both = [torch.stack([vector(theta) for theta in path]) for path in (meta, overfit)]
    if both[0].shape[1] != both[1].shape[1]:
        return {"meta": [], "overfit": []}, 0.0
    places, explained = project(torch.cat(both))
    return {"meta": places[: len(meta)].tolist(), "overfit": places[len(meta) :].tolist()}, explained


def vector(theta: Params) -> Tensor:
    """Parameters [1, ...] of one task as one vector."""
    return torch.cat([theta[key].detach().flatten().cpu() for key in sorted(theta)])


def project(states: Tensor) -> tuple[Tensor, float]:
    """States [S, D] in the plane of most variance: places [S, 2], and the share of variance in it."""
    centred = (states - states.mean(0)).double()
    values, vectors = torch.linalg.eigh(centred @ centred.T)  # S is far less than D
    places_of = vectors[:, -2:].flip(1) * values[-2:].flip(0).clamp_min(0).sqrt()
    return places_of, float(values[-2:].sum() / values.sum().clamp_min(1e-30))


def parts_of(cell: Cell, task: Task) -> dict[float, Params]:
    """Meta's parameters at PARTS of its steps, without task axis, from a trace."""
    states: dict[float, Params] = {part: {} for part in PARTS}
    (folder,) = (record["folder"] for record in cell.records() if record["name"] == task.name)
    for name, value in read_params(folder).items():
        part, key = name.split("/", 1)
        states[float(part)][key] = value
    return states


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
    """Notes on further steps and their number, here and in the paper."""
    further, last = paper()["further_steps"], all_rows[-2]
    lines = [
        f"further steps: Finetune's Adam from Meta's result, {', '.join(map(str, FURTHER))} of them; step: the median "
        f"over tasks of those after which Meta is within {further['within']:.0%} of Overfit",
    ]
    if last["near"] is not None:
        lines.append(f"{last['near']} of {last['tasks']} tasks come so near (paper: {further['steps']} further steps)")
    return [*lines, f"traces of {len(trace_cell(subject).tasks)} of {len(subject.tasks)} tasks, evenly spaced"]


COLUMNS = columns(
    "paradigm",
    *(words("of its steps", "part"), words("step", "step")),
    *("error", "interval", numbers("paper further steps", "paper_further", "d"), "median", "worst"),
)
CONVERGENCE = Table("convergence", "error{factor} along Meta's steps", COLUMNS, rows, notes, cells, "Convergence")
