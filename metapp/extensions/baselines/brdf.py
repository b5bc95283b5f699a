"""Baselines of BRDF networks: components of training BRDFs, two GGX lobes, the nearest training material."""

from __future__ import annotations

import functools
import itertools

import torch
from torch import Generator, Tensor

from metapp.appearance.geometry import Cosines
from metapp.extensions.baselines import ggx_lobes
from metapp.extensions.baselines.baseline import (
    INDEX_NUMBERS_AND_BYTES,
    Baseline,
    BaselineFit,
    CostLimits,
    TrainingTasks,
    judge_answer,
    tensor_bytes,
)
from metapp.extensions.baselines.components import REFLECTANCE_EPSILON, Components, principal_components
from metapp.learning.app import App
from metapp.learning.task import Tasks
from metapp.paradigms.phi_training import split_validation

COMPONENT_COUNTS = (20, 66, 150)  # components; 66 take 198 numbers
CANDIDATE_PENALTIES = (1e-12, 1e-10, 1e-9, 1e-8, 1e-7, 1e-6, 1e-4)  # times the number of samples
CANDIDATE_SOLVES = (1, 2)
MIN_TRAINING_GROUPS = 4  # groups of training materials: of fewer none is kept for validation


def baselines(app: App) -> tuple[Baseline, ...]:
    """Of BRDFs."""
    return (*(Pca(app, count) for count in COMPONENT_COUNTS), TwoLobes(app), NearestMaterial(app))


def task_places(tasks: Tasks) -> Tensor:
    """Places [N, 7] of the one task: half vector, difference vector, cos theta_i."""
    return tasks.data["where"][tasks.rows][0]


def draw_seen_rows(tasks: Tasks, rng: Generator, count: int) -> tuple[Tensor, Tensor]:
    """Rows [n] of random samples of one task's first half, as `Brdf.sample` draws them, and targets [n, 3]."""
    target = tasks.data["target"][tasks.rows][0]
    rows = torch.randint(len(target) // 2, (1, count), generator=rng)[0]
    return rows, target[rows]


def find_rows(where: Tensor, tasks: Tasks, rows: Tensor) -> Tensor:
    """Rows of a task's places among places [N, 7], of which the held-out ones are the same.

    Raises:
        ValueError: they are at others.
    """
    places, half = task_places(tasks), len(where) // 2
    if torch.equal(places, where):
        return rows
    index = {place.tobytes(): row for row, place in enumerate(where[:half].numpy())}
    found = [index.get(place.tobytes(), -1) for place in places[rows].numpy()]
    if min(found) < 0 or not torch.equal(places[half:], where[half:]):
        name = tasks.selected_names[0]
        raise ValueError(f"{name}: at other angles than the training materials; convert both alike.")
    return torch.tensor(found)


def cosines_at_places(where: Tensor) -> Cosines:
    """Of places [n, 7], in double precision."""
    half, difference, incident = (where[:, i].double() for i in (2, 5, 6))
    return Cosines(incident, 2 * half * difference - incident, half, difference)


def reflectance_at_places(where: Tensor, target: Tensor) -> Tensor:
    """Reflectance [..., n, 3] in 1/sr of targets [..., n, 3] at places [n, 7]."""
    return target.expm1() / where[:, 6:].clamp_min(1e-9)


def training_components(where: Tensor, target: Tensor) -> Components:
    """The components of training materials: places [N, 7] and targets [M, N, 3]."""
    columns = reflectance_at_places(where, target).movedim(0, 1).flatten(1)
    cosines = cosines_at_places(where)
    weight = (cosines.incident * cosines.outgoing).clamp_min(REFLECTANCE_EPSILON)[:, None].to(columns)
    none = columns[:, :1]
    of = Components(where[:, 6:], weight, columns.median(1, keepdim=True).values, none, none, none)
    return Components(*of[:3], *principal_components(of.mapped(columns), max(COMPONENT_COUNTS)))


@functools.lru_cache(maxsize=1)
def _learned(training: TrainingTasks) -> tuple[Tensor, Components, Components, Tasks]:
    """The common places, the components of all training materials and of those to learn from, those to choose on.

    Raises:
        ValueError: they are not at the same angles.
    """
    known = chosen_on = tasks = training.stacked
    if len({task.group or task.name for task in training.tasks}) >= MIN_TRAINING_GROUPS:
        known, chosen_on = split_validation(tasks)
    where = tasks.data["where"]
    if where.stride(0):
        raise ValueError("training materials at angles of their own, expected the same for all; use analytic ones.")
    whole, part = (training_components(where[0], each.data["target"][each.rows]) for each in (tasks, known))
    return where[0], whole, part, chosen_on


class Pca(Baseline):
    """Coefficients of so many components: penalty and solves are chosen on validation materials, then all are taken."""

    title = "ridge on components of log-relative training BRDFs (Nielsen et al. 2015), weighted for the table's error"
    cannot = "say anything between the angles of its table, which all training materials must share"
    learns = True

    def __init__(self, app: App, count: int) -> None:
        super().__init__(app)
        self.name, self.count = f"pca_{count}", count

    def prepare(self, training: TrainingTasks, allowed: CostLimits) -> None:
        """Learn components; ValueError if materials are not at the same angles."""
        self.where, whole, part, chosen_on = _learned(training)
        self.components = part.first(self.count)

        def error(setting: tuple[float, int]) -> float:
            self.penalty, self.solves = setting
            return mean_error(self, chosen_on, allowed)

        self.penalty, self.solves = min(itertools.product(CANDIDATE_PENALTIES, CANDIDATE_SOLVES), key=error)
        self.components = whole.first(self.count)
        self.shared = tensor_bytes(self.components.mean, self.components.axes, self.components.reference)
        self.chosen = {"penalty": self.penalty, "solves": self.solves}

    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        """The coefficients of a material's samples; ValueError if these are at other angles."""
        components, (rows, target) = self.components, draw_seen_rows(tasks, rng, allowed.samples)
        found = components.at(find_rows(self.where, tasks, rows)).coefficients(target, self.penalty, self.solves)
        held = slice(len(self.where) // 2, None)
        return BaselineFit(lambda: components.at(held).reflectance(found).T[None], found.numel(), tensor_bytes(found))


@torch.no_grad()
def mean_error(baseline: Baseline, tasks: Tasks, allowed: CostLimits) -> float:
    """Mean error of fits of all tasks with fixed seeds, as the application has it, unscaled."""
    total = 0.0
    for row in range(len(tasks)):
        one = tasks.select([row])
        fitted = baseline.fit(one, Generator().manual_seed(row), allowed)
        total += float(judge_answer(baseline.app, fitted.answer(), one)["error"])
    return total / len(tasks)


class TwoLobes(Baseline):
    """A body under two lobes."""

    name = "ggx_2"
    title = "a Lambertian body and two GGX lobes, by least squares on the table's error"
    cannot = "be more than a sum of such lobes"

    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        """The numbers of `lobes.fit_ggx_lobes`."""
        where, (rows, target) = task_places(tasks), draw_seen_rows(tasks, rng, allowed.samples)
        numbers = ggx_lobes.fit_ggx_lobes(cosines_at_places(where[rows]), target.double()).float()

        def answer() -> Tensor:
            return (
                ggx_lobes.lobes_reflectance(numbers.double(), cosines_at_places(where[len(where) // 2 :]))
                .float()
                .T[None]
            )

        return BaselineFit(answer, numbers.numel(), tensor_bytes(numbers))


class NearestMaterial(Baseline):
    """The nearest training material; the set itself is shared."""

    name = "nearest"
    title = "the training material with the least error on the samples"
    cannot = "be a material that is not in its set"
    learns = True

    def prepare(self, training: TrainingTasks, allowed: CostLimits) -> None:
        """Take the set."""
        self.targets, self.where = training.stacked.data["target"], training.stacked.data["where"]
        self.shared = tensor_bytes(self.where[0], self.targets)

    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        """The number of a material is kept; ValueError if samples are at other angles."""
        targets, where, half = self.targets, self.where, self.where.shape[1] // 2
        rows, target = draw_seen_rows(tasks, rng, allowed.samples)
        index = (targets[:, find_rows(where[0], tasks, rows)] - target).abs().mean((1, 2)).argmin()
        return BaselineFit(
            lambda: reflectance_at_places(where[index, half:], targets[index, half:]).T[None], *INDEX_NUMBERS_AND_BYTES
        )
