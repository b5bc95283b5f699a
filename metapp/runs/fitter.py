"""Fits of tasks, one by one or side by side, with errors, times and warnings.

Inputs are read when their turn comes, so that a large set need not fit into memory. Nothing is written here: what is
kept of a fit is decided in `metapp.runs.execution`.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import chain
from pathlib import Path

import torch
from torch import Generator

from metapp.appearance.pictures import photo_error_percent
from metapp.learning.app import stack_tasks
from metapp.learning.learn import DescentState, final_item
from metapp.learning.random_tensors import Rng, draw_per_task
from metapp.learning.task import Params, Task, Tasks
from metapp.runs.checkpoint_selection import Checkpoint, find_checkpoint
from metapp.runs.choice import Choice
from metapp.runs.environment import software_versions
from metapp.runs.fit import Fit
from metapp.runs.inputs.run_inputs import Input, task_digest
from metapp.runs.reporter import Bar, say
from metapp.storage.files import error_about_file
from metapp.storage.fit_records import FitRecord, Settings
from metapp.storage.fit_store import FitStore

READ_TIME_SHARE, FITTED_TIME_SHARE = 0.2, 0.5  # about the shares of an input's time when it is read, and when fitted
# Gradient steps of the fit that loads kernels: a fit after it takes at most 2 % longer than after more steps
WARM_UP_STEPS = 1
MAX_NOTED_INPUTS = 3  # number of inputs for which a line says that they were cut or scaled
LOSS_ROSE_CLAUSE = "the visible loss rose"  # the beginning of a clause of warnings, which tables count by itself
FIT_ERRORS = (ValueError, OSError, FloatingPointError, MemoryError, RuntimeError)  # errors by which a fit may fail


class BadInput(ValueError):
    """An input that cannot be read; the message names its place."""


@dataclass(frozen=True)
class Fitter:
    """What fits tasks: a choice of recipe and paradigm, with the checkpoint that fits begin at.

    Attributes:
        choice: the recipe, the rule, the paradigm and the device.
        checkpoint: initialisation and rule of the fits.
        label: the label of the data that is fitted, which records state.

    >>> from metapp.runs.choice import choose
    >>> from metapp.runs.fit_options import fit_options
    >>> Fitter.of(choose(fit_options("brdf", "meta", device="cpu")), "files").settings.steps
    10
    """

    choice: Choice
    checkpoint: Checkpoint
    label: str

    @classmethod
    def of(cls, choice: Choice, label: str) -> Fitter:
        """Return the fitter of a choice, with the checkpoint that options name or that ships.

        Args:
            choice: the choice.
            label: the label of the data that is fitted.

        Raises:
            ValueError: there is no checkpoint, or it is for other fits.
        """
        return cls(choice, find_checkpoint(choice), label)

    @functools.cached_property
    def settings(self) -> Settings:
        """The settings that records of fits state: all that errors and seconds depend on."""
        choice, paradigm, app = self.choice, self.choice.paradigm, self.choice.app
        adam, guard = paradigm.adam(self.checkpoint.phi), paradigm.guard
        return Settings(
            app=app.name,
            observe=app.observes,
            paradigm=paradigm.name,
            rule=choice.options.rule if paradigm.has_learned_rule else ("adam" if adam else "none"),
            steps=paradigm.steps,
            batch=choice.recipe.samples,
            adam=asdict(adam) if adam else None,
            guard=asdict(guard) if guard else None,
            checkpoint=self.checkpoint.digest,
            data=self.label,
            recipe=choice.options.recipe,
            options=choice.options.app_options.recorded_values(),
            seed=choice.options.seed,
            device=str(choice.device),
            versions=software_versions(),
            further=app.recorded_conditions(choice.device if paradigm.steps else None),
        )

    @property
    def store(self) -> FitStore:
        """The folder of the fits, which compares records with the settings of this fitter."""
        path = self.choice.folder(self.label, checkpoint=self.checkpoint.digest)
        return FitStore(path, self.settings, timed=True)

    def fit_one_by_one(self, tasks: Sequence[Task]) -> Iterator[Fit]:
        """Fit tasks one after the other, so that each has its own time; warnings are recorded, not said.

        Yields:
            The fit of each task, in order.

        Raises:
            FloatingPointError: a fit is not finite.
            ValueError: a task lacks a tensor; this is found before the first fit.
        """
        for task in tasks:
            self.require_tensors(task)
        for number, task in enumerate(tasks):
            if number == 0:
                self.warm_up(task)
            yield from self.fit_side_by_side([task])

    def require_tensors(self, task: Task) -> None:
        """Refuse a task that lacks a tensor which a fit reads, rather than fail after hours of other fits.

        Raises:
            ValueError: a tensor is missing.
        """
        if self.choice.app.observes:
            self.choice.app.prepare(task)

    def warm_up(self, task: Task) -> None:
        """Take a gradient step before the first fit: first calls load kernels, which would count as time of the fit.

        The task is prepared by :meth:`App.warm_up_app`, which may take less time than a fit that is kept.
        """
        paradigm = self.choice.paradigm
        stacked = stack_tasks(self.choice.app.warm_up_app(), [task], self.choice.device)
        paradigm = replace(paradigm, steps=min(paradigm.steps, WARM_UP_STEPS))
        # without a guard, whose losses take longer than a step
        paradigm.fit(self.checkpoint.phi, stacked, rng_of(self.choice, task), guarded=False)

    def fit_side_by_side(self, tasks: Sequence[Task]) -> list[Fit]:
        """Fit tasks of equal sizes side by side, each as if it were fitted alone.

        The seconds of a fit are its share of the time that all fits took, from the tasks' samples to the final
        parameters, without the first loading of kernels. The error of a fit is None if its task holds no reference.

        Args:
            tasks: one or more tasks whose tensors have equal sizes.

        Raises:
            FloatingPointError: a fit is not finite.
            ValueError: tasks differ in their sizes.
        """
        choice, app, paradigm = self.choice, self.choice.app, self.choice.paradigm
        rngs = tuple(rng_of(choice, task) for task in tasks)
        rng: Rng = rngs if len(rngs) > 1 else rngs[0]
        begin_seconds, begin_cpu_seconds = _clock_seconds(choice.device), time.process_time()
        stacked = stack_tasks(app, tasks, choice.device)
        descent = paradigm.descend(self.checkpoint.phi, stacked, rng)
        first = next(descent)
        last = final_item(chain([first], descent))
        theta = app.postprocess(last.theta, stacked)
        seconds = (_clock_seconds(choice.device) - begin_seconds) / len(tasks)
        cpu_seconds = (time.process_time() - begin_cpu_seconds) / len(tasks)
        measures, warnings = app.errors(theta, stacked), _warnings_or_fault(choice, stacked, first, last)
        fits = []
        for i, (task, clauses) in enumerate(zip(tasks, warnings, strict=True)):
            errors = {key: float(value[i]) for key, value in measures.items()}
            parameters = {key: value[i].detach().cpu() for key, value in theta.items()}
            _require_finite(task, parameters, errors)
            scale = app.error_measure.scale
            remarks = dict(choice.presenter.remarks(parameters, task))
            record = FitRecord(
                name=task.name,
                error=errors.pop("error") * scale if "error" in errors else None,
                scale=scale,
                errors=dict(errors),
                seconds=seconds,
                # fewer than the seconds if other programs took the CPU; where a GPU computes, they would say nothing
                cpu_seconds=cpu_seconds if choice.device.type == "cpu" else None,
                # outside of the settings, since another number of threads is no reason to fit anew
                threads=torch.get_num_threads(),
                counts=remarks.pop("counts", {}),  # type: ignore[arg-type]  # Presenter.remarks says what it holds
                note=remarks.pop("note", ""),  # type: ignore[arg-type]
                figures=remarks,
                guarded=(last.guarded is not None and bool(last.guarded[i])) if paradigm.guard else None,
                warning="; ".join(clauses),
                batch=len(tasks),
                settings=self.settings,
            )
            if record.error is None and (comparison := choice.presenter.photo_comparison(parameters, task)):
                record.photo_error = photo_error_percent(comparison)
            fits.append(Fit(choice, task, record, parameters))
        return fits


def fit_inputs(
    fitter: Fitter, inputs: Sequence[Input], store: FitStore | None = None, bar: Bar | None = None
) -> Iterator[tuple[Input, Fit | Exception]]:
    """Read and fit inputs, `--batch` of them side by side, and say the warnings of each fit.

    Args:
        fitter: what fits the inputs.
        inputs: the inputs to fit; each is read when its turn comes.
        store: the folder of the fits; with --resume, a fit that it holds is read instead of made. None to keep none.
        bar: the progress, which shows the name of each task that was read.

    Yields:
        Each input with its fit, or with the error by which it has none. The record of a fit that the store holds names
        its `folder`.
    """
    is_warm = False
    pending: list[tuple[Input, Task]] = []

    def fit_pending() -> Iterator[tuple[Input, Fit | Exception]]:
        nonlocal is_warm
        for group in group_by_tensor_sizes(pending):
            if not is_warm:
                with contextlib.suppress(*FIT_ERRORS):  # the fit itself fails of the same, and says so of its input
                    fitter.warm_up(group[0][1])
                is_warm = True
            for run_input, fit in _fit_group(fitter, group):
                if isinstance(fit, Fit):
                    _name_input(fit, run_input)
                    _say_warnings(fit)
                yield run_input, fit

    for run_input, result in _read_tasks(fitter, inputs, store, bar or Bar()):
        if isinstance(result, Task):
            pending.append((run_input, result))
        else:
            yield run_input, result
        if len(pending) == (fitter.choice.options.batch or 1):
            yield from fit_pending()
            pending.clear()
    yield from fit_pending()


def _read_tasks(
    fitter: Fitter, inputs: Iterable[Input], store: FitStore | None, bar: Bar
) -> Iterator[tuple[Input, Task | Fit | Exception]]:
    """Read inputs one after the other, and say what was cut or scaled.

    Yields:
        Each input with its task, with an earlier fit that --resume keeps, or with the error of a bad input.
    """
    note_count, choice = 0, fitter.choice
    for run_input in inputs:
        try:
            task = run_input.read_task()
            if (
                store
                and choice.options.resume
                and (record := store.find(task.name, run_input.place, task_digest(task)))
            ):
                yield run_input, Fit(choice, task, record)
                continue
            bar.set_label(f"{task.name}: fitting", READ_TIME_SHARE)
            fitter.require_tensors(task)
            note_count += bool(task.note)
            if task.note and note_count <= MAX_NOTED_INPUTS:
                say(f"{Path(run_input.place).name}: {task.note}")
            elif task.note and note_count == MAX_NOTED_INPUTS + 1:
                say("further inputs are cut and scaled likewise")
            yield run_input, task
        except (ValueError, OSError) as error:
            yield run_input, BadInput(str(error_about_file(error, Path(run_input.place))))


def _fit_group(fitter: Fitter, pairs: Sequence[tuple[Input, Task]]) -> Iterator[tuple[Input, Fit | Exception]]:
    """Fit tasks side by side, or one by one if a fit side by side fails.

    Yields:
        Each input with its fit, or with the error of its fit.
    """
    failure: Exception | None = None
    try:
        fits = fitter.fit_side_by_side([task for _, task in pairs])
    except FIT_ERRORS as error:
        failure = error.with_traceback(None)  # the frames of a traceback would hold the tensors of the batch
    if failure is None:
        yield from zip([run_input for run_input, _ in pairs], fits, strict=True)
    elif len(pairs) == 1:
        yield pairs[0][0], failure
    else:
        for pair in pairs:
            yield from _fit_group(fitter, [pair])


def _name_input(fit: Fit, run_input: Input) -> None:
    """Add to the record of a fit the place of its input, a digest of the task's values, and the paths as given.

    Objects in memory have no place by which a later command could find them.
    """
    if not fit.choice.options.objects:
        fit.record.source, fit.record.content = run_input.place, task_digest(fit.task)
        fit.record.origin = fit.choice.origin(run_input.given_paths)


def _say_warnings(fit: Fit) -> None:
    if fit.record.note:
        say(f"{fit.name}: {fit.record.note}")
    for clause in filter(None, fit.warning.split("; ")):
        remedy = "; try another rule, more steps or another paradigm." if clause.startswith(LOSS_ROSE_CLAUSE) else ""
        say(f"warning: {fit.name}: {clause}{remedy}")


def group_by_tensor_sizes(pairs: Iterable[tuple[Input, Task]]) -> list[list[tuple[Input, Task]]]:
    """Group tasks whose tensors have equal sizes, so that they can be fitted side by side."""
    groups: dict[tuple[tuple[str, torch.Size], ...], list[tuple[Input, Task]]] = {}
    for run_input, task in pairs:
        sizes = tuple((key, task.data[key].shape) for key in sorted(task.data))
        groups.setdefault(sizes, []).append((run_input, task))
    return list(groups.values())


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


def _warnings_or_fault(choice: Choice, stacked: Tasks, first: DescentState, last: DescentState) -> list[list[str]]:
    """Return :func:`warnings_of` the fits, or a clause for each that they could not be found: no doubt ends a fit."""
    try:
        return warnings_of(choice, stacked, first, last)
    except FIT_ERRORS as error:
        reason = (str(error) or type(error).__name__).splitlines()[0]
        return [[f"the fit could not be examined for doubts ({reason})"] for _ in stacked.names]


def warnings_of(choice: Choice, stacked: Tasks, first: DescentState, last: DescentState) -> list[list[str]]:
    """Return clauses of warnings for each fit, [] for a fit without doubt.

    A fit is doubtful where the application's presenter says so, and where its loss on visible samples rose: learned
    rules can fail. The loss is not compared where a guard has already compared each fit with its beginning.

    Args:
        choice: the choice of the fits.
        stacked: the fitted tasks.
        first: the first state of their descent.
        last: the last state of their descent.
    """
    clauses_by_task = choice.presenter.quality_warnings(last.theta, stacked)
    if last.guarded is not None or not choice.paradigm.steps:
        return clauses_by_task
    generators = tuple(Generator(stacked.rows.device).manual_seed(0) for _ in stacked.names)
    with torch.no_grad():
        app, samples = choice.app, choice.recipe.samples
        batch = draw_per_task(lambda tasks, rng: app.sample(tasks, rng, samples), stacked, generators)
        losses_before, losses_after = (app.loss(state.theta, batch, {}).tolist() for state in (first, last))
    return [
        [*([] if after <= before else [f"{LOSS_ROSE_CLAUSE} from {before:.4g} to {after:.4g}"]), *clauses]
        for before, after, clauses in zip(losses_before, losses_after, clauses_by_task, strict=True)
    ]


def rng_of(choice: Choice, task: Task) -> Generator:
    """Return the generator of a fit's random draws, which depends on the seed and the task's name alone.

    A fit is therefore the same whatever is fitted beside it.
    """
    text = f"{choice.options.seed} {task.name}"
    seed = int.from_bytes(hashlib.sha256(text.encode(errors="surrogatepass")).digest()[:6], "big")
    return Generator(choice.device).manual_seed(seed)
