"""The paper's convergence: traces of fits along their steps, and further steps that bring Meta within 1 % of Overfit.

The fits of table rows are timed, so no error is measured during them. Here equal fits, with equal random draws, are
made again for a few tasks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from msgspec.structs import replace

from metapp.evaluation.evaluation_run import EvaluationRun, select_evenly
from metapp.evaluation.rows import make_row, paper_figure, paper_figures
from metapp.evaluation.table import Column, Row, Table, columns
from metapp.learning.app import stack_tasks
from metapp.learning.learn import learn, task_loss
from metapp.learning.rules import fixed_adam
from metapp.learning.task import Params, Task, Tasks
from metapp.paradigms.methods import descend_tasks
from metapp.runs.fit import Fit
from metapp.runs.fitting import rng_of
from metapp.runs.resolve import recipe_of

TRACED_TASKS = 5  # test tasks whose fits are traced along their steps
STEP_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)  # of a fit's steps, after which errors are measured
CURVE_PARADIGMS = ("overfit", "finetune", "quickft", "meta")
FURTHER_STEPS = (8, 16, 32, 65, 130)  # gradient steps by Adam after Meta's own
CONVERGENCE_COLUMNS = columns(
    "paradigm",
    *(Column("of its steps", "part"), Column("step", "step")),
    *("error", "interval", Column("paper further steps", "paper_further", "d", is_optional=True), "median", "worst"),
)


def convergence(evaluation: EvaluationRun) -> Table:
    """Make the table of Meta's errors after shares of its steps and after further steps, beside Overfit's error."""
    fits, within = traced_fits(evaluation), paper_figures()["further_steps"]["within"]
    paper_steps = paper_figure(evaluation, "further_steps", "steps")

    def step_row(paradigm: str, part: str, step: object, errors: Sequence[float | None]) -> Row:
        traced = [replace(fit, error=error) for fit, error in zip(fits, errors, strict=True)]
        entries = {"part": part, "step": step, "further": None, "near": None, "paper_further": None}
        return make_row(evaluation, paradigm, traced, entries)

    def row_at_share(paradigm: str, share: float) -> Row:
        step = step_at(share, evaluation.steps(paradigm))
        errors = [dict(fit.figures["curves"][paradigm]).get(step) for fit in fits]
        return step_row(paradigm, f"{share:.0%}", step, errors)

    further_row = step_row("meta", "further", None, [fit.figures["further"][-1][1] for fit in fits])
    further_row["paper_further"] = paper_steps
    notes = [
        f"further steps: Finetune's Adam from Meta's result, {', '.join(map(str, FURTHER_STEPS))} steps; step: the "
        f"median over tasks of the further steps after which Meta is within {within:.0%} of Overfit",
    ]
    if needed_steps := [further_steps_needed(fit) for fit in fits]:
        median = sorted(needed_steps, key=lambda value: FURTHER_STEPS[-1] + 1 if value is None else value)[
            (len(needed_steps) - 1) // 2
        ]
        further_row |= {"further": median, "near": sum(value is not None for value in needed_steps)}
        further_row["step"] = f"+{median}" if median is not None else f"> +{FURTHER_STEPS[-1]}"
        notes.append(
            f"{further_row['near']} of {len(fits)} tasks come within {within:.0%} of Overfit"
            + (f" (paper: after {paper_steps} further steps)" if paper_steps else "")
        )
    notes.append(f"traces of {len(_select_traced(evaluation))} of {len(evaluation.tasks)} tasks, evenly spaced")
    rows = [*(row_at_share("meta", share) for share in STEP_SHARES), further_row, row_at_share("overfit", 1.0)]
    title = f"error{evaluation.app.error_measure.factor} along Meta's steps"
    return Table(evaluation.title, title, CONVERGENCE_COLUMNS, rows, notes)


def further_steps_needed(fit: Fit) -> int | None:
    """Return the further steps after which Meta's error is within 1 % of Overfit's; None if none suffice."""
    steps, error = fit.figures["further"][-1]
    return steps if is_near(error, fit.figures["curves"]["overfit"][-1][1]) else None


def is_near(error: float | None, other_error: float | None) -> bool:
    """Return whether an error exceeds another error by no more than the paper's does after its further steps, 1 %."""
    if error is None or other_error is None:
        return False
    within: float = paper_figures()["further_steps"]["within"]
    return error - other_error <= within * abs(other_error)


# Traces of fits along their steps


def _select_traced(evaluation: EvaluationRun) -> list[Task]:
    """Return the test tasks whose fits are traced."""
    return select_evenly(evaluation.tasks, TRACED_TASKS if evaluation.whole else evaluation.long_fit_tasks)


def traced_fits(evaluation: EvaluationRun) -> list[Fit]:
    """Return traces of a few tasks: errors of each paradigm along its steps, and after further steps of Meta."""
    spec = evaluation.spec_of_kind("trace", {"further": list(FURTHER_STEPS)}, CURVE_PARADIGMS)
    steps = sum(evaluation.steps(name) for name in CURVE_PARADIGMS) + sum(FURTHER_STEPS)

    def measure(tasks: list[Task]) -> Iterator[Fit]:
        return (_trace(evaluation, task) for task in tasks)

    return evaluation.measure("trace", evaluation.folder("trace"), spec, measure, _select_traced(evaluation), steps)


def step_at(share: float, steps: int) -> int:
    """Return the step at which this share of all steps is done."""
    return round(share * steps)


def curve_steps(steps: int) -> set[int]:
    """Return the steps after which errors are measured: at STEP_SHARES, and ever closer to the first step."""
    return {step_at(share, steps) for share in STEP_SHARES} | {
        round(steps / 4**power) for power in range(2, 16) if steps >= 4**power
    }


def _trace(evaluation: EvaluationRun, task: Task) -> Fit:
    """Trace the fits of one task."""
    stacked = stack_tasks(evaluation.app, [task], evaluation.specs["meta"].device)
    curves: dict[str, list[tuple[int, float | None]]] = {}
    for name in CURVE_PARADIGMS:
        spec, method = evaluation.specs[name], evaluation.fitters[name].method
        measured_steps = curve_steps(method.steps)
        descent = descend_tasks(method, stacked, rng_of(spec, task))  # equals the row's fit: of equal draws
        states = {state.step: state.theta for state in descent if state.step in measured_steps}  # [1, ...] each
        curves[name] = [(step, _error_of(evaluation, states[step], stacked)) for step in sorted(measured_steps)]
    meta = states[method.steps]  # `method` and `states` are still Meta's, the last of CURVE_PARADIGMS
    further = _continue_meta(evaluation, task, stacked, meta, curves["overfit"][-1][1])
    error, scale = curves["meta"][-1][1], evaluation.app.error_measure.scale
    return Fit(
        name=task.name,
        spec=evaluation.specs["meta"],
        error=error,
        source=task.name,
        scale=scale,
        figures={"curves": curves, "further": further},
    )


def _error_of(evaluation: EvaluationRun, theta: Params, stacked: Tasks) -> float | None:
    """Return the error as the table prints it; None if the task holds no reference."""
    errors = evaluation.app.errors(theta, stacked)
    return evaluation.app.error_measure.scale * float(errors["error"][0]) if errors else None


def _continue_meta(
    evaluation: EvaluationRun, task: Task, stacked: Tasks, theta: Params, overfit_error: float | None
) -> list[tuple[int, float | None]]:
    """Fit on from Meta's result by Finetune's Adam, until the error is within 1 % of Overfit's.

    Args:
        evaluation: the application, with its runs.
        task: the task.
        stacked: the task as a stack of one.
        theta: Meta's result, [1, ...].
        overfit_error: Overfit's error on the task; None if it is not known.

    Returns:
        (further steps, error) of descents, each of which begins at Meta's result and has a rate that decays to its end.
    """
    recipe = recipe_of(evaluation.specs["meta"])
    errors = [(0, _error_of(evaluation, theta, stacked))]
    for steps in FURTHER_STEPS:
        if overfit_error is None or is_near(errors[-1][1], overfit_error):
            break
        rng = rng_of(evaluation.specs["meta"], task)
        rule, loss = fixed_adam(recipe.finetune, theta, steps), task_loss(evaluation.app, recipe.samples)
        errors.append((steps, _error_of(evaluation, learn(theta, rule, stacked, loss, steps=steps, rng=rng), stacked)))
    return errors
