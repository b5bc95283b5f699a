"""Fits of baselines to tasks, timed by the same clock and judged by the same errors as fits of paradigms.

A method is known here by the contract :class:`metapp.extensions.baselines.baseline.Baseline` alone. The command and the
table both make their fits here, so that their figures agree.
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Iterator, Sequence
from importlib import metadata
from pathlib import Path

import torch
from threadpoolctl import threadpool_limits
from torch import Generator

from metapp.apps.brdf.app import Brdf
from metapp.extensions.baselines.baseline import Baseline, CostLimits, TrainingTasks, judge_prediction, tensor_bytes
from metapp.learning.app import App, stack_tasks
from metapp.learning.task import Params, Task
from metapp.runs.choice import Choice
from metapp.runs.data_sets.embedded import has_embedded_training, make_embedded_set
from metapp.runs.environment import software_versions
from metapp.runs.fitter import rng_of
from metapp.runs.inputs.run_inputs import data_label
from metapp.runs.outputs.contact_sheet import PICTURE_KEY
from metapp.storage.fit_records import FitRecord, Settings
from metapp.storage.shards import read_data_set, read_manifest

BASELINE_FIGURES = ("numbers", "kept_bytes", "shared")  # figures that every record of a baseline has

# The record of a fit, its picture as parameters, and a function that makes the argument of `Presenter.answer_pictures`
# at a height and width in px.
JudgedFit = tuple[FitRecord, Params | None, Callable[[tuple[int, int] | None], object]]


def find_training_folder(choice: Choice, baseline: Baseline, *, make: bool = False) -> Path | None:
    """Return the data set whose training tasks a baseline learns from: the one that is fitted, else the embedded one.

    Args:
        choice: the choice of what is evaluated.
        baseline: the method, which may learn nothing.
        make: whether the embedded set is made with its training tasks where it is missing; it is so only where the test
            tasks of that set are fitted.

    Returns:
        The folder; None if the baseline learns nothing or there are no training tasks.
    """
    if not baseline.learns:
        return None
    application, data, quiet = choice.application, choice.options.data, choice.options.quiet
    fits_embedded = not (data or choice.options.paths or choice.options.objects) and application.synthetic is not None
    folders = [data] if data else []
    if has_embedded_training(application) or (make and fits_embedded):
        folders.append(make_embedded_set(application, quiet=quiet))
    return next((path for path in folders if any(task.split == "train" for task in read_manifest(path).tasks)), None)


@functools.lru_cache(maxsize=1)
def read_training_tasks(app: App, folder: Path | None) -> TrainingTasks:
    """Read the training tasks of a data set; without a folder there are no tasks."""
    return TrainingTasks(app, read_data_set(folder, "train", app.name, app.tensors) if folder else [])


def cost_limits_of(choice: Choice) -> CostLimits:
    """Return the cost limits of a choice: the samples that Meta's steps draw, the bytes of a task's parameters."""
    recipe = choice.recipe
    return CostLimits(recipe.steps * recipe.samples, tensor_bytes(*parameters_per_task(choice.app).values()))


def baseline_settings(choice: Choice, baseline: Baseline, label: str) -> Settings:
    """Return everything that figures of a baseline depend on, as a record keeps it.

    Args:
        choice: the choice of what is evaluated.
        baseline: the method.
        label: the name of the fitted data.
    """
    app, options = choice.app, choice.options
    own_options, training_folder = options.app_options.recorded_values(), find_training_folder(choice, baseline)
    return Settings(
        app=app.name,
        observe=app.observes,
        data=label,
        recipe=options.recipe,
        options=own_options,
        seed=options.seed,
        versions=software_versions() | {"scipy": metadata.version("scipy")},
        further={
            "method": baseline.name,
            "training": training_folder and data_label(training_folder),
            "allowed": cost_limits_of(choice)._asdict(),
            **app.recorded_conditions(),
        },
    )


def parameters_per_task(app: App) -> Params:
    """Return the parameters [1, ...], as initialised, that a task does not share with others."""
    theta = app.init(Generator().manual_seed(0), 1)
    unshared_names = app.network.unshared_parameters if isinstance(app, Brdf) else ()
    return {key: value for key, value in theta.items() if not unshared_names or key in unshared_names}


def fit_baselines(
    choice: Choice, baseline: Baseline, tasks: Sequence[Task], *, warm: bool = True
) -> Iterator[JudgedFit]:
    """Fit a baseline to tasks, one after the other, timed from the task's samples to the fit.

    Args:
        choice: the choice of what is evaluated.
        baseline: the method to fit.
        tasks: the tasks to fit.
        warm: whether the first task is fitted twice, so that its time is not the time of a first call, as with
            paradigms.

    Yields:
        For each task the record, the picture and the function of :data:`JudgedFit`. A record has no time if the method
        was run elsewhere.

    Raises:
        ValueError: the baseline cannot be fitted to these tasks.
    """
    app, allowed = choice.app, cost_limits_of(choice)
    with threadpool_limits(torch.get_num_threads(), user_api="blas"), torch.no_grad():
        if baseline.learns:
            baseline.prepare(read_training_tasks(baseline.app, find_training_folder(choice, baseline)), allowed)
        for task in tasks[:1] if warm and not baseline.stored_tensor else ():
            baseline.fit(stack_tasks(baseline.app, [task]), rng_of(choice, task), allowed)
        for task in tasks:
            rng, start = rng_of(choice, task), time.perf_counter()
            prepared_task = stack_tasks(baseline.app, [task])
            fit = baseline.fit(prepared_task, rng, allowed)
            seconds = time.perf_counter() - start
            prediction = fit.prediction()
            errors = {key: float(value[0]) for key, value in judge_prediction(app, prediction, prepared_task).items()}
            if errors and not math.isfinite(errors["error"]):
                raise ValueError(f"{task.name}: the error is not finite.")
            scale, error = app.error_measure.scale, errors.pop("error", None)
            record = FitRecord(
                name=task.name,
                error=None if error is None else scale * error,
                scale=scale,
                errors={key: value for key, value in errors.items() if math.isfinite(value)},
                seconds=None if baseline.stored_tensor else seconds,
                threads=None if baseline.stored_tensor else torch.get_num_threads(),
                figures={
                    "numbers": fit.kept_numbers,
                    "kept_bytes": fit.kept_bytes,
                    "shared": baseline.shared_bytes,
                    "chosen": baseline.chosen,
                },
            )
            prediction_at_size = fit.prediction_at_size or functools.partial(_return_judged_prediction, prediction)
            yield record, None if fit.picture is None else {PICTURE_KEY: fit.picture}, prediction_at_size


def _return_judged_prediction(prediction: object, size: tuple[int, int] | None) -> object:
    """Return the judged prediction, for methods whose files show it and have no other size."""
    return prediction
