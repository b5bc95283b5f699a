"""Fits of baselines to tasks, timed by the same clock and judged by the same errors as fits of paradigms.

A method is known here by the contract :class:`metapp.extensions.baselines.baseline.Baseline` alone. The command and the
table both make their fits here, so that their figures agree.
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import torch
from threadpoolctl import threadpool_limits
from torch import Generator

from metapp.apps.brdf.app import Brdf
from metapp.extensions.baselines.baseline import (
    Baseline,
    BaselineFit,
    CostLimits,
    TrainingTasks,
    tensor_bytes,
)
from metapp.learning.app import App, stack_tasks
from metapp.learning.task import Params, Task
from metapp.runs.data_sets.embedded import has_embedded_training, make_embedded_set
from metapp.runs.fit import Fit
from metapp.runs.fit_pictures import PICTURE_KEY
from metapp.runs.fitting import rng_of
from metapp.runs.inputs.finding import data_label
from metapp.runs.resolve import app_of, recipe_of
from metapp.runs.spec import Spec
from metapp.storage.shards import read_data_set, read_manifest


def find_training_folder(spec: Spec, baseline: Baseline, data: Path | None, *, make: bool = False) -> Path | None:
    """Return the data set whose training tasks a baseline learns from: the one that is fitted, else the embedded one.

    Args:
        spec: the specification of what is evaluated.
        baseline: the method, which may learn nothing.
        data: the data set that the user names; None for none.
        make: whether the embedded set is made with its training tasks where it is missing.

    Returns:
        The folder; None if the baseline learns nothing or there are no training tasks.
    """
    if not baseline.learns:
        return None
    folders = [data] if data else []
    if has_embedded_training(spec.application) or (make and spec.application.synthetic is not None):
        folders.append(make_embedded_set(spec.application, quiet=True))
    return next((path for path in folders if any(task.split == "train" for task in read_manifest(path).tasks)), None)


@functools.lru_cache(maxsize=1)
def read_training_tasks(app: App, folder: Path | None) -> TrainingTasks:
    """Read the training tasks of a data set; without a folder there are no tasks."""
    return TrainingTasks(app, read_data_set(folder, "train", app.name, app.tensors) if folder else [])


def cost_limits_of(spec: Spec) -> CostLimits:
    """Return the cost limits of baselines: the samples that Meta's steps draw, the bytes of a task's parameters."""
    recipe = recipe_of(spec)
    return CostLimits(recipe.steps * recipe.samples, tensor_bytes(*parameters_per_task(app_of(spec)).values()))


def baseline_spec(spec: Spec, baseline: Baseline, training_folder: Path | None) -> Spec:
    """Return the specification of a baseline's fits: everything that their figures depend on.

    Args:
        spec: the complete specification of what is evaluated.
        baseline: the method.
        training_folder: the data set that the method learns from; None if it learns nothing.
    """
    conditions = {
        "method": baseline.name,
        "training": data_label(training_folder) if training_folder else None,
        "allowed": cost_limits_of(spec)._asdict(),
        **app_of(spec).recorded_conditions(),
    }
    versions = spec.versions | {"scipy": metadata.version("scipy")}
    return replace(spec, paradigm="", rule="", steps=None, digest="", conditions=conditions, versions=versions)


def parameters_per_task(app: App) -> Params:
    """Return the parameters [1, ...], as initialised, that a task does not share with others."""
    theta = app.init(Generator().manual_seed(0), 1)
    unshared_names = app.network.unshared_parameters if isinstance(app, Brdf) else ()
    return {key: value for key, value in theta.items() if not unshared_names or key in unshared_names}


def fit_baselines(
    spec: Spec, baseline: Baseline, tasks: Sequence[Task], training_folder: Path | None
) -> Iterator[tuple[Fit, BaselineFit]]:
    """Fit a baseline to tasks, one after the other, timed from the task's samples to the fit.

    Args:
        spec: the complete specification of what is evaluated.
        baseline: the method to fit.
        tasks: the tasks to fit.
        training_folder: the data set that the method learns from; None if it learns nothing.

    Yields:
        For each task the fit, whose parameters are its picture, if it has one, and what the method answered. A fit has
        no time if the method was run elsewhere.

    Raises:
        ValueError: the baseline cannot be fitted to these tasks.
    """
    app, allowed = app_of(spec), cost_limits_of(spec)
    with threadpool_limits(torch.get_num_threads(), user_api="blas"), torch.no_grad():
        if baseline.learns:
            baseline.prepare(read_training_tasks(baseline.app, training_folder), allowed)
        for task in tasks:
            rng, start = rng_of(spec, task), time.perf_counter()
            prepared_task = stack_tasks(baseline.app, [task])
            answer = baseline.fit(prepared_task, rng, allowed)
            seconds = time.perf_counter() - start
            prediction = answer.prediction()
            errors = {key: float(value[0]) for key, value in app.errors_of(prediction, prepared_task).items()}
            if errors and not math.isfinite(errors["error"]):
                raise ValueError(f"{task.name}: the error is not finite.")
            scale, error = app.error_measure.scale, errors.pop("error", None)
            fit = Fit(
                name=task.name,
                spec=baseline_spec(spec, baseline, training_folder),
                error=None if error is None else scale * error,
                scale=scale,
                further_errors={key: value for key, value in errors.items() if math.isfinite(value)},
                seconds=None if baseline.stored_tensor else seconds,
                threads=None if baseline.stored_tensor else torch.get_num_threads(),
                figures={
                    "numbers": answer.kept_numbers,
                    "kept_bytes": answer.kept_bytes,
                    "shared": baseline.shared_bytes,
                    "chosen": baseline.chosen,
                },
                source=task.name,
            )
            if answer.picture is not None:
                fit.parameters = {PICTURE_KEY: answer.picture}
            yield fit, answer
