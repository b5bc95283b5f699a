"""The one loop that fits inputs: for the command line, for Python programs and for tables.

Inputs are read when their turn comes, so that a large set need not fit into memory. Nothing is written here.
"""

from __future__ import annotations

import hashlib
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

import torch
from torch import Generator

from metapp.appearance.pictures import photo_error_percent
from metapp.appearance.presenter import Presenter
from metapp.learning.app import App, stack_tasks
from metapp.learning.learn import DescentState, MetaParameters, final_item
from metapp.learning.random_tensors import Rng, draw_per_task
from metapp.learning.recipe import Recipe
from metapp.learning.task import Params, Task, Tasks
from metapp.paradigms.methods import Method, descend_tasks, make_method
from metapp.runs.checkpoints import read_checkpoint
from metapp.runs.environment import torch_defaults
from metapp.runs.fit import Fit
from metapp.runs.inputs.finding import Input, content_of
from metapp.runs.memory_errors import describe_short_memory
from metapp.runs.reporter import Bar, say
from metapp.runs.resolve import app_of, presenter_of, recipe_of
from metapp.runs.spec import Spec
from metapp.storage.files import error_about_file

READ_TIME_SHARE = 0.2  # about the share of an input's time that has passed when it is read
MAX_NOTED_INPUTS = 3  # number of inputs for which a line says that they were cut or scaled
LOSS_ROSE_CLAUSE = "the visible loss rose"  # the beginning of a clause of warnings, which tables count by itself
# Errors that may happen without a mistake in the code. A RuntimeError of a fit may be a mistake: a run of one input
# raises it, while a run of several inputs reports it in a line and fits the others.
FORESEEN_ERRORS = (ValueError, OSError, FloatingPointError, MemoryError)
FIT_ERRORS = (*FORESEEN_ERRORS, RuntimeError)  # errors by which a fit may fail


class Failure(NamedTuple):
    """An input that was not fitted, or a fit that was not written.

    Attributes:
        place: the path of the input, or of the file that was not written.
        error: the error, whose message names the place.
        fails_run: whether the run counts as failed; a damaged file that was found in a folder does not count.
        is_fit_kept: whether the fit is kept, and only an export was not written.
    """

    place: str
    error: Exception
    fails_run: bool = True
    is_fit_kept: bool = False

    @property
    def reason(self) -> str:
        """The error message, in one line."""
        return str(self.error)

    @classmethod
    def of(
        cls, one: Input, error: Exception, *, is_bad_input: bool = False, size: tuple[int, int] | None = None
    ) -> Failure:
        """Return the failure of an input by an error; a bad input that was found in a folder fails no run.

        Args:
            one: the input.
            error: the error.
            is_bad_input: whether the input could not be read.
            size: height and width in px of the files that fits write, if a user has chosen them.
        """
        line = describe_short_memory(error, size)
        named = ValueError(line) if line else error_about_file(error, Path(one.place))
        named.__cause__ = error.with_traceback(None)  # the frames of a traceback would hold tensors
        is_foreseen = isinstance(error, FORESEEN_ERRORS) or bool(line)
        return cls(one.place, named if is_foreseen else error, one.is_named or not is_bad_input)


class Fitter(NamedTuple):
    """What the fits of one specification have in common, made once.

    Attributes:
        spec: the specification.
        app: the network, what fits see and how they are judged.
        recipe: the settings.
        phi: the meta-parameters of the checkpoint.
        method: initialisation, rule, steps, loss and guard.
        presenter: what people look at.
    """

    spec: Spec
    app: App
    recipe: Recipe
    phi: MetaParameters
    method: Method
    presenter: Presenter[Any]

    @classmethod
    def of(cls, spec: Spec) -> Fitter:
        """Make what the fits of a complete specification have in common, with its checkpoint.

        Raises:
            ValueError: there is no checkpoint, or it is for other fits.

        >>> from metapp.runs.resolve import complete
        >>> Fitter.of(complete(Spec(app="brdf", device="cpu"))).method.steps
        10
        """
        recipe, app = recipe_of(spec), app_of(spec)
        phi = read_checkpoint(spec, app, recipe)
        method = make_method(spec.paradigm, app, recipe, phi, rule=spec.rule, steps=spec.steps)
        return cls(spec, app, recipe, phi, method, presenter_of(spec, app))


def make_fitters(specs: Sequence[Spec]) -> list[Fitter]:
    """Return what fits each input, one object for all inputs of one specification.

    Raises:
        ValueError: a checkpoint is missing or damaged, or is for other fits.
    """
    different = {id(spec): spec for spec in specs}
    fitters = {key: Fitter.of(spec) for key, spec in different.items()}
    return [fitters[id(spec)] for spec in specs]


def fit_each(
    fitters: Sequence[Fitter],
    inputs: Sequence[Input],
    *,
    batch: int = 1,
    find_earlier: Callable[[Input, Spec], Fit | None] = lambda one, spec: None,
    bar: Bar | None = None,
) -> Iterator[tuple[Input, Fit | Failure]]:
    """Fit inputs one after the other, or side by side. No bad input stops the others.

    Args:
        fitters: what fits each input.
        inputs: the inputs, each of which is read when its turn comes.
        batch: how many inputs are fitted side by side, each as if it were alone but for rounding.
        find_earlier: returns a fit of an input that was made before by this specification, None if there is none. It is
            taken if the files of the input have not changed since, else if the values of the task have not.
        bar: shows the name of each input.

    Yields:
        Each input with its fit or failure. A fit that was made before says so by `is_earlier`.
    """
    bar = bar or Bar()
    waiting: list[tuple[Fitter, Input, Task]] = []
    note_count = 0
    for fitter, one in zip(fitters, inputs, strict=True):
        before = find_earlier(one, fitter.spec)
        if before and before.stamp and before.stamp == one.stamp():
            before.is_earlier = True
            yield one, before
            continue
        try:
            task = one.read_task(fitter.spec, fitter.app)
            if before and before.content == content_of(task):
                before.is_earlier = True
                yield one, before
                continue
            if fitter.app.observes:
                fitter.app.prepare(task)  # a task that lacks what fits see is refused before others are fitted
        except (ValueError, OSError) as error:
            yield one, Failure.of(one, error, is_bad_input=True)
            continue
        note_count += bool(task.note)
        if task.note and note_count <= MAX_NOTED_INPUTS:
            say(f"{Path(one.place).name}: {task.note}")
        elif task.note and note_count == MAX_NOTED_INPUTS + 1:
            say("further inputs are cut and scaled likewise")
        bar.set_label(f"{one.name}: fitting", READ_TIME_SHARE)
        waiting.append((fitter, one, task))
        if len(waiting) >= batch:
            yield from _fit_waiting(waiting)
            waiting.clear()
    yield from _fit_waiting(waiting)


def _fit_waiting(waiting: Sequence[tuple[Fitter, Input, Task]]) -> Iterator[tuple[Input, Fit | Failure]]:
    """Fit tasks that were read, side by side where their specifications and sizes are equal."""
    groups: dict[object, tuple[Fitter, list[tuple[Input, Task]]]] = {}
    for fitter, one, task in waiting:
        sizes = tuple((key, task.data[key].shape) for key in sorted(task.data))
        groups.setdefault((id(fitter), sizes), (fitter, []))[1].append((one, task))
    for fitter, group in groups.values():
        yield from _fit_group(fitter, group)


def _fit_group(fitter: Fitter, group: Sequence[tuple[Input, Task]]) -> Iterator[tuple[Input, Fit | Failure]]:
    """Fit tasks side by side, or one by one if a fit side by side fails."""
    failure: Exception | None = None
    try:
        fits = fit_tasks_of(fitter, [task for _, task in group])
    except FIT_ERRORS as error:
        failure = error.with_traceback(None)  # the frames of a traceback would hold the tensors of the batch
    if failure is None:
        for (one, task), fit in zip(group, fits, strict=True):
            fit.name, fit.format, fit.inputs = one.name, one.format, list(one.given)
            if one.path:
                fit.source, fit.content, fit.stamp = one.place, content_of(task), one.stamp()
            yield one, fit
    elif len(group) == 1:
        yield group[0][0], Failure.of(group[0][0], failure, size=fitter.presenter.size)
    else:
        for pair in group:
            yield from _fit_group(fitter, [pair])


def fit_tasks_of(fitter: Fitter, tasks: Sequence[Task]) -> list[Fit]:
    """Fit tasks of equal sizes side by side, each as if it were fitted alone.

    The seconds of a fit are its share of the time that all fits took, from the tasks' samples to the final parameters.
    The error of a fit is None if its task holds no reference.

    Args:
        fitter: what the fits have in common.
        tasks: one or more tasks whose tensors have equal sizes.

    Raises:
        FloatingPointError: a fit is not finite.
        ValueError: tasks differ in their sizes.
    """
    spec, app, device = fitter.spec, fitter.app, torch.device(fitter.spec.device)
    rngs = tuple(rng_of(spec, task) for task in tasks)
    rng: Rng = rngs if len(rngs) > 1 else rngs[0]
    with torch_defaults(single=app.small_tensors):
        begin_seconds, begin_cpu_seconds = _clock_seconds(device), time.process_time()
        stacked = stack_tasks(app, tasks, device)
        descent = descend_tasks(fitter.method, stacked, rng)
        first = next(descent)
        last = final_item(chain([first], descent))
        theta = app.postprocess(last.theta, stacked)
        seconds = (_clock_seconds(device) - begin_seconds) / len(tasks)
        cpu_seconds = (time.process_time() - begin_cpu_seconds) / len(tasks)
        measures, warnings = app.errors(theta, stacked), _warnings_or_fault(fitter, stacked, first, last)
        fits = []
        for row, (task, clauses) in enumerate(zip(tasks, warnings, strict=True)):
            errors = {key: float(value[row]) for key, value in measures.items()}
            parameters = {key: value[row].detach().cpu() for key, value in theta.items()}
            _require_finite(task, parameters, errors)
            remarks = dict(fitter.presenter.remarks(parameters, task))
            error, scale = errors.pop("error", None), app.error_measure.scale
            fit = Fit(
                name=task.name,
                spec=spec,
                error=None if error is None else error * scale,
                scale=scale,
                further_errors=dict(errors),
                seconds=seconds,
                # fewer than the seconds if other programs took the CPU; where a GPU computes, they would say nothing
                cpu_seconds=cpu_seconds if device.type == "cpu" else None,
                threads=torch.get_num_threads(),
                counts=remarks.pop("counts", {}),  # type: ignore[arg-type]  # Presenter.remarks says what it holds
                note=remarks.pop("note", ""),  # type: ignore[arg-type]
                figures=remarks,
                guarded=(last.guarded is not None and bool(last.guarded[row])) if fitter.method.guard else None,
                warning="; ".join(clauses),
                batch=len(tasks),
                group=task.group,
                source=task.name,
            )
            fit.parameters, fit.task, fit.app, fit.presenter = parameters, task, app, fitter.presenter
            if fit.error is None and (comparison := fitter.presenter.photo_comparison(parameters, task)):
                fit.photo_error = photo_error_percent(comparison)
            fits.append(fit)
    return fits


def rng_of(spec: Spec, task: Task) -> Generator:
    """Return the generator of a fit's random draws, which depends on the seed and the task's name alone.

    A fit is therefore the same whatever is fitted beside it.
    """
    text = f"{spec.seed} {task.name}"
    seed = int.from_bytes(hashlib.sha256(text.encode(errors="surrogatepass")).digest()[:6], "big")
    return Generator(spec.device).manual_seed(seed)


def say_doubts(fit: Fit) -> None:
    """Say what the application notes of a fit, and each clause that doubts it."""
    if fit.note:
        say(f"{fit.name}: {fit.note}")
    for clause in filter(None, fit.warning.split("; ")):
        remedy = "; try another rule, more steps or another paradigm." if clause.startswith(LOSS_ROSE_CLAUSE) else ""
        say(f"warning: {fit.name}: {clause}{remedy}")


def _clock_seconds(device: torch.device) -> float:
    """Wait until the device is idle, and return the seconds on a clock."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)
    return time.perf_counter()


def _require_finite(task: Task, theta: Params, errors: Mapping[str, float]) -> None:
    """Refuse a fit whose parameters or error are NaN or infinite.

    Args:
        task: the task that was fitted, which the message names.
        theta: the parameters of the fit, without a task axis.
        errors: the errors of the fit, by name.

    Raises:
        FloatingPointError: a parameter or the error is not finite.
    """
    are_params_finite = all(bool(torch.isfinite(value).all()) for value in theta.values())
    if not are_params_finite or not math.isfinite(errors.get("error", 0.0)):
        subject = "error is" if are_params_finite else "parameters are"
        raise FloatingPointError(
            f"{task.name}: the fit's {subject} not finite; use another checkpoint or paradigm, or fewer steps."
        )


def _warnings_or_fault(fitter: Fitter, stacked: Tasks, first: DescentState, last: DescentState) -> list[list[str]]:
    """Return :func:`warnings_of` the fits, or a clause for each that they could not be found: no doubt ends a fit."""
    try:
        return warnings_of(fitter, stacked, first, last)
    except FIT_ERRORS as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        return [[f"the fit could not be examined for doubts ({reason})"] for _ in stacked.names]


def warnings_of(fitter: Fitter, stacked: Tasks, first: DescentState, last: DescentState) -> list[list[str]]:
    """Return clauses of warnings for each fit, [] for a fit without doubt.

    A fit is doubtful where the application's presenter says so, and where its loss on visible samples rose: learned
    rules can fail. The loss is not compared where a guard has already compared each fit with its beginning.

    Args:
        fitter: what the fits have in common.
        stacked: the fitted tasks.
        first: the first state of their descent.
        last: the last state of their descent.
    """
    clauses_by_task = fitter.presenter.quality_warnings(last.theta, stacked)
    if last.guarded is not None or not fitter.method.steps:
        return clauses_by_task
    generators = tuple(Generator(stacked.rows.device).manual_seed(0) for _ in stacked.names)
    with torch.no_grad():
        app, samples = fitter.app, fitter.recipe.samples
        batch = draw_per_task(lambda tasks, rng: app.sample(tasks, rng, samples), stacked, generators)
        losses_before, losses_after = (app.loss(state.theta, batch, {}).tolist() for state in (first, last))
    return [
        [*([] if after <= before else [f"{LOSS_ROSE_CLAUSE} from {before:.4g} to {after:.4g}"]), *clauses]
        for before, after, clauses in zip(losses_before, losses_after, clauses_by_task, strict=True)
    ]
