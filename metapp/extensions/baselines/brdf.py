"""Baselines of BRDFs: principal components of training BRDFs, two GGX lobes, the nearest training material.

The methods see the samples that fits see. Their mathematics is in `components` and `ggx_lobes`, which know no tasks.
"""

from __future__ import annotations

import functools
import itertools

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.geometry import Cosines, half_difference_and_cosine
from metapp.apps.brdf.reflectance import Reflectance
from metapp.extensions.baselines import ggx_lobes
from metapp.extensions.baselines.baseline import (
    INDEX_NUMBERS_AND_BYTES,
    Baseline,
    BaselineFit,
    CostLimits,
    TrainingTasks,
    tensor_bytes,
)
from metapp.extensions.baselines.components import REFLECTANCE_EPSILON, Components, principal_components
from metapp.learning.app import App
from metapp.learning.task import Tasks
from metapp.paradigms.training import split_validation

COMPONENT_COUNTS = (20, 66, 150)  # 66 components take 198 numbers, three channels each
# ridge penalties, which are multiplied by the number of samples
CANDIDATE_PENALTIES = (1e-12, 1e-10, 1e-9, 1e-8, 1e-7, 1e-6, 1e-4)
CANDIDATE_SOLVES = (1, 2)  # solves of iteratively reweighted least squares
MIN_TRAINING_GROUPS = 4  # with fewer groups of training materials, none is kept for validation alone


def baselines(app: App) -> tuple[Baseline, ...]:
    """Return the baselines of BRDFs: components in several numbers, two GGX lobes, the nearest training material."""
    return (*(Pca(app, count) for count in COMPONENT_COUNTS), TwoLobes(app), NearestMaterial(app))


def task_places(tasks: Tasks) -> Tensor:
    """Return the places [N, 7] of the one selected task: half vector, difference vector, cos theta_i."""
    return tasks.data["where"][tasks.rows][0]


def draw_seen_rows(tasks: Tasks, rng: Generator, count: int) -> tuple[Tensor, Tensor]:
    """Draw random samples of the selected task from the half that fits see, as `SampleSight.sample` does.

    Returns:
        Rows [n] of the samples, and their targets [n, 3], log(1 + f cos theta_i).
    """
    target = tasks.data["target"][tasks.rows][0]
    rows = torch.randint(len(target) // 2, (1, count), generator=rng)[0]
    return rows, target[rows]


def find_rows(where: Tensor, tasks: Tasks, rows: Tensor) -> Tensor:
    """Find the samples of a task in the common table of places of the training materials.

    Args:
        where: the common places, [N, 7].
        tasks: the tasks, of which one is selected; its held-out places must be the common ones.
        rows: rows of the task's own places, [n].

    Returns:
        The rows [n] of the same places in the common table.

    Raises:
        ValueError: the task's places are others.
    """
    places, half = task_places(tasks), len(where) // 2
    if torch.equal(places, where):
        return rows
    index = {place.tobytes(): row for row, place in enumerate(where[:half].numpy())}
    common_rows = [index.get(place.tobytes(), -1) for place in places[rows].numpy()]
    if min(common_rows) < 0 or not torch.equal(places[half:], where[half:]):
        name = tasks.selected_names[0]
        raise ValueError(f"{name}: at other angles than the training materials; convert both alike.")
    return torch.tensor(common_rows)


def cosines_at_places(where: Tensor) -> Cosines:
    """Return the cosines at places [n, 7], in double precision."""
    half, difference, incident = (where[:, i].double() for i in (2, 5, 6))
    return Cosines(incident, 2 * half * difference - incident, half, difference)


def reflectance_at_places(where: Tensor, target: Tensor) -> Tensor:
    """Return the reflectance [..., n, 3] in 1/sr of targets [..., n, 3], log(1 + f cos theta_i), at places [n, 7]."""
    return target.expm1() / where[:, 6:].clamp_min(1e-9)


def training_components(where: Tensor, target: Tensor) -> Components:
    """Return the principal components of training materials.

    Args:
        where: the places of all materials, [N, 7].
        target: log(1 + f cos theta_i) of each material, [M, N, 3].
    """
    columns = reflectance_at_places(where, target).movedim(0, 1).flatten(1)
    cosines = cosines_at_places(where)
    weight = (cosines.incident * cosines.outgoing).clamp_min(REFLECTANCE_EPSILON)[:, None].to(columns)
    placeholder = columns[:, :1]
    scaling = Components(
        where[:, 6:], weight, columns.median(1, keepdim=True).values, placeholder, placeholder, placeholder
    )
    return Components(
        *scaling[:3], *principal_components(scaling.log_relative_reflectance(columns), max(COMPONENT_COUNTS))
    )


@functools.lru_cache(maxsize=1)
def _learn_components(training: TrainingTasks) -> tuple[Tensor, Components, Components, Tasks]:
    """Learn the components of training materials, once for all numbers of components.

    Returns:
        The common places [N, 7]; the components of all training materials; the components of those to learn from, while
        settings are chosen; the tasks to choose settings on.

    Raises:
        ValueError: the training materials are not measured at the same angles.
    """
    learning_tasks = validation_tasks = tasks = training.prepared_tasks
    if len({task.group or task.name for task in training.tasks}) >= MIN_TRAINING_GROUPS:
        learning_tasks, validation_tasks = split_validation(tasks)
    where = tasks.data["where"]
    if where.stride(0):
        raise ValueError("training materials at angles of their own, expected the same for all; use analytic ones.")
    all_components, learning_components = (
        training_components(where[0], subset.data["target"][subset.rows]) for subset in (tasks, learning_tasks)
    )
    return where[0], all_components, learning_components, validation_tasks


class Pca(Baseline):
    """Coefficients of a number of principal components, by ridge regression.

    The penalty and the number of solves are chosen on validation materials, by components of the others; then the
    components of all training materials are taken.

    Attributes:
        count: the number of components.
    """

    title = "ridge on components of log-relative training BRDFs (Nielsen et al. 2015), weighted for the table's error"
    cannot = "say anything between the angles of its table, which all training materials must share"
    learns = True

    def __init__(self, app: App, count: int) -> None:
        super().__init__(app)
        self.name, self.count = f"pca_{count}", count

    @override
    def prepare(self, training: TrainingTasks, allowed: CostLimits) -> None:
        """Raise ValueError if training materials are not measured at the same angles."""
        self.where, all_components, learning_components, validation_tasks = _learn_components(training)
        self.components = learning_components.select_components(self.count)

        def validation_error(setting: tuple[float, int]) -> float:
            self.penalty, self.solves = setting
            return mean_error(self, validation_tasks, allowed)

        self.penalty, self.solves = min(itertools.product(CANDIDATE_PENALTIES, CANDIDATE_SOLVES), key=validation_error)
        self.components = all_components.select_components(self.count)
        self.shared_bytes = tensor_bytes(self.components.mean, self.components.axes, self.components.reference)
        self.chosen = {"penalty": self.penalty, "solves": self.solves}

    @override
    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        """Raise ValueError if the samples are at other angles than the training materials."""
        components, (rows, target) = self.components, draw_seen_rows(tasks, rng, allowed.samples)
        coefficients = components.select_places(find_rows(self.where, tasks, rows)).solve_coefficients(
            target, self.penalty, self.solves
        )
        held_out_rows = slice(len(self.where) // 2, None)
        return BaselineFit(
            lambda: components.select_places(held_out_rows).reflectance(coefficients).T[None],
            coefficients.numel(),
            tensor_bytes(coefficients),
        )


@torch.no_grad()
def mean_error(baseline: Baseline, tasks: Tasks, allowed: CostLimits) -> float:
    """Return the mean error of fits of all tasks, with fixed seeds, in the application's unscaled measure."""
    total = 0.0
    for row in range(len(tasks)):
        task = tasks.select([row])
        fit = baseline.fit(task, Generator().manual_seed(row), allowed)
        total += float(baseline.app.errors_of(fit.prediction(), task)["error"])
    return total / len(tasks)


class TwoLobes(Baseline):
    """A Lambertian body under two GGX lobes, fitted by :func:`ggx_lobes.fit_ggx_lobes`."""

    name = "ggx_2"
    title = "a Lambertian body and two GGX lobes, by least squares on the table's error"
    cannot = "be more than a sum of such lobes"

    @override
    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        where, (rows, target) = task_places(tasks), draw_seen_rows(tasks, rng, allowed.samples)
        numbers = ggx_lobes.fit_ggx_lobes(cosines_at_places(where[rows]), target.double()).float()

        def evaluate_at_places(places: Tensor) -> Tensor:
            """Evaluate the lobes at places [n, 7]: linear RGB [n, 3]."""
            return ggx_lobes.lobes_reflectance(numbers.double(), cosines_at_places(places)).float()

        def evaluate(angles: Tensor) -> Tensor:
            places = half_difference_and_cosine(angles.reshape(-1, angles.shape[-1])[:, :3])
            return evaluate_at_places(places).clamp_min(0).reshape(*angles.shape[:-1], 3)

        held_out = where[len(where) // 2 :]
        return BaselineFit(
            lambda: evaluate_at_places(held_out).T[None],
            numbers.numel(),
            tensor_bytes(numbers),
            lambda task, size: Reflectance(evaluate),
        )


class NearestMaterial(Baseline):
    """The training material with the least error; all training materials are shared, and a fit is the index of one."""

    name = "nearest"
    title = "the training material with the least error on the samples"
    cannot = "be a material that is not in its set"
    learns = True

    @override
    def prepare(self, training: TrainingTasks, allowed: CostLimits) -> None:
        self.targets, self.where = training.prepared_tasks.data["target"], training.prepared_tasks.data["where"]
        self.shared_bytes = tensor_bytes(self.where[0], self.targets)

    @override
    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        """Raise ValueError if the samples are at other angles than the training materials."""
        targets, where, held_out_start = self.targets, self.where, self.where.shape[1] // 2
        rows, target = draw_seen_rows(tasks, rng, allowed.samples)
        nearest = (targets[:, find_rows(where[0], tasks, rows)] - target).abs().mean((1, 2)).argmin()
        return BaselineFit(
            lambda: reflectance_at_places(where[nearest, held_out_start:], targets[nearest, held_out_start:]).T[None],
            *INDEX_NUMBERS_AND_BYTES,
        )
