"""Fit baselines to tasks, on the same clock and judged by the same errors as paradigms."""

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

from metapp.apps import protocol_entry
from metapp.apps.brdf.brdf_network import BrdfNetwork
from metapp.extensions.baselines.baseline import Baseline, CostLimits, TrainingTasks, judge_answer, tensor_bytes
from metapp.learning.app import App, stack_tasks
from metapp.learning.task import Params, Task
from metapp.names import embedded_apps
from metapp.runs.environment import software_versions
from metapp.runs.fitting import rng_of
from metapp.runs.inputs.embedded import has_embedded_training, make_embedded_set
from metapp.runs.inputs.run_inputs import data_label
from metapp.runs.outputs.contact_sheet import PICTURE_KEY
from metapp.runs.run import Run
from metapp.storage.fit_folders import Record
from metapp.storage.shards import read_data_set, read_manifest

BASELINE_RECORD_KEYS = ("error", "numbers", "kept_bytes", "shared")  # of a record


# the record, the picture, and a function of the size of files that makes what `Presenter.answer_pictures` takes
JudgedFit = tuple[Record, Params | None, Callable[[tuple[int, int] | None], object]]


def find_training_folder(run: Run, baseline: Baseline, *, make: bool = False) -> Path | None:
    """Return the data set whose training tasks a baseline learns from: the one that is fitted, else the embedded one.

    Args:
        run: of the evaluation.
        baseline: which may learn nothing.
        make: whether the embedded set is made with its training tasks if it is not there; only where its own test
            tasks are fitted.

    Returns:
        The folder; None if the baseline learns nothing or there are no training tasks.
    """
    if not baseline.learns:
        return None
    app, data, quiet = run.app.name, run.options.data, run.options.quiet
    fits_embedded = not (data or run.options.paths or run.options.objects) and app in embedded_apps()
    folders = [data] if data else []
    if has_embedded_training(app) or (make and fits_embedded):
        folders.append(make_embedded_set(app, quiet=quiet))
    return next((path for path in folders if any(task.split == "train" for task in read_manifest(path).tasks)), None)


@functools.lru_cache(maxsize=1)
def read_training_tasks(app: App, folder: Path | None) -> TrainingTasks:
    """The training tasks of a data set; no tasks if there is no folder."""
    return TrainingTasks(app, read_data_set(folder, "train", app.name, app.tensors) if folder else [])


def cost_limits_of_run(run: Run) -> CostLimits:
    """As many samples as Meta's steps draw, and as many bytes as a task's own parameters have."""
    recipe = run.recipe
    return CostLimits(recipe.steps * recipe.batch, tensor_bytes(*parameters_per_task(run.app).values()))


def baseline_settings(run: Run, baseline: Baseline, label: str) -> Record:
    """Everything that figures of a baseline on data of this name depend on."""
    app, options = run.app, run.options
    own, source = options.app_options.recorded_values(), find_training_folder(run, baseline)
    return {
        "app": app.name,
        **protocol_entry(app),
        "method": baseline.name,
        "data": label,
        "training": source and data_label(source),
        "allowed": cost_limits_of_run(run)._asdict(),
        "recipe": options.recipe,
        **({"options": own} if own else {}),
        "seed": options.seed,
        "versions": software_versions() | {"scipy": metadata.version("scipy")},
        **app.conditions(),
    }


def parameters_per_task(app: App) -> Params:
    """Parameters [1, ...] that a task does not share with others."""
    theta = app.init(Generator().manual_seed(0), 1)
    own = app.network.unshared_parameters if isinstance(app.network, BrdfNetwork) else ()
    return {key: value for key, value in theta.items() if not own or key in own}


def fit_baselines(run: Run, baseline: Baseline, tasks: Sequence[Task], *, warm: bool = True) -> Iterator[JudgedFit]:
    """Fit a baseline to tasks, each alone; the time is from the task's samples to the fit.

    Args:
        run: of the evaluation.
        baseline: to fit.
        tasks: to be fitted.
        warm: fit the first task twice, so that its time is none of a first call, as paradigms' are not.

    Yields:
        Of each task. A baseline that is stored has no time.

    Raises:
        ValueError: it cannot be fitted to these tasks.
    """
    app, allowed = run.app, cost_limits_of_run(run)
    with threadpool_limits(torch.get_num_threads(), user_api="blas"), torch.no_grad():
        if baseline.learns:
            baseline.prepare(read_training_tasks(app, find_training_folder(run, baseline)), allowed)
        for task in tasks[:1] if warm and not baseline.stored else ():
            baseline.fit(stack_tasks(app, [task]), rng_of(run, task), allowed)
        for task in tasks:
            rng, begin = rng_of(run, task), time.perf_counter()
            stacked = stack_tasks(app, [task])
            fitted = baseline.fit(stacked, rng, allowed)
            seconds = time.perf_counter() - begin
            answer = fitted.answer()
            errors = {key: float(value[0]) for key, value in judge_answer(app, answer, stacked).items()}
            if errors and not math.isfinite(errors["error"]):
                raise ValueError(f"{task.name}: the error is not finite.")
            scale = {"error": app.error_measure.scale}
            record = {
                "name": task.name,
                "error": None,
                **{key: scale.get(key, 1.0) * value for key, value in errors.items() if math.isfinite(value)},
                **({} if baseline.stored else {"seconds": seconds, "threads": torch.get_num_threads()}),
                "numbers": fitted.numbers,
                "kept_bytes": fitted.kept_bytes,
                "shared": baseline.shared,
                "chosen": baseline.chosen,
            }
            written = fitted.written or functools.partial(_as_it_is, answer)
            yield record, None if fitted.picture is None else {PICTURE_KEY: fitted.picture}, written


def _as_it_is(answer: object, size: tuple[int, int] | None) -> object:
    """Return what was judged, of methods whose files show it and have no other size."""
    return answer
