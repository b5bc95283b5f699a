"""Baselines of BRDF networks: components of training BRDFs, two GGX lobes, the nearest training material.

Components are of log-relative BRDFs (Nielsen et al. 2015, "On Optimal, Minimal BRDF Sampling ...").
"""

from __future__ import annotations

import functools
import itertools
from typing import NamedTuple

import torch
from torch import Generator, Tensor

from metapp.appearance.geometry import Cosines
from metapp.extensions.baselines import lobes
from metapp.extensions.baselines.baseline import (
    Allowed,
    Baseline,
    BaselineFit,
    FitTask,
    PreparedBaseline,
    Training,
    bytes_of,
    mean_error,
    nearest,
)
from metapp.extensions.baselines.components import EPSILON, Components, Relative, components, ridge
from metapp.learning.app import App
from metapp.learning.task import Tasks

COUNTS = (20, 66, 150)  # components; 66 take 198 numbers
PENALTIES = (1e-12, 1e-10, 1e-9, 1e-8, 1e-7, 1e-6, 1e-4)  # times the number of samples
SOLVES = (1, 2)
DELTA = 0.3  # of the mean error: smaller ones weigh no more


class Samples(NamedTuple):
    """The samples of a fit.

    Attributes:
        rows: which of the samples, [n], with repetition.
        where: half vector, difference vector, cos theta_i, [n, 7].
        target: log(1 + f cos theta_i), [n, 3].
    """

    rows: Tensor
    where: Tensor
    target: Tensor

    @property
    def cos(self) -> Tensor:
        """Of theta_i, [n, 1]."""
        return self.where[:, 6:]


class Space(NamedTuple):
    """The places and the mapping of components.

    Attributes:
        where: the samples' places that all training materials share, [N, 7].
        relative: the mapping at each.
        components: of all channels of the training materials.
    """

    where: Tensor
    relative: Relative
    components: Components

    def at(self, rows: Tensor) -> Space:
        """At some of the places."""
        relative = Relative(self.relative.weight[rows], self.relative.reference[rows])
        components = self.components._replace(mean=self.components.mean[rows], axes=self.components.axes[rows])
        return Space(self.where[rows], relative, components)

    def reflectance(self, coefficients: Tensor) -> Tensor:
        """Of coefficients [K, C], [N, C] in 1/sr."""
        return self.relative.reflectance(self.components.axes @ coefficients + self.components.mean)


def baselines(app: App) -> tuple[Baseline, ...]:
    """Of BRDFs."""
    cannot = "say anything between the angles of its table, which all training materials must share"
    published = (
        "ridge on components of log-relative training BRDFs (Nielsen et al. 2015), weighted for the table's error"
    )
    lobes_title = "a Lambertian body and two GGX lobes, by least squares on the table's error"
    title = "the training material with the least error on the samples"
    return (
        *(Baseline(f"pca_{count}", published, cannot, functools.partial(_components, count)) for count in COUNTS),
        Baseline(
            "ggx_2",
            lobes_title,
            "be more than a sum of such lobes",
            lambda *_: PreparedBaseline(_two_lobes),
            learns=False,
        ),
        Baseline("nearest", title, "be a material that is not in its set", _nearest),
    )


def drawn(tasks: Tasks, rng: Generator, count: int) -> Samples:
    """Random samples of one task's first half, as `Brdf.sample` draws them."""
    where, target = _of_one(tasks)
    rows = torch.randint(len(where) // 2, (1, count), generator=rng)[0]
    return Samples(rows, where[rows], target[rows])


def _of_one(tasks: Tasks) -> tuple[Tensor, Tensor]:
    """Places [N, 7] and targets [N, 3] of the one task."""
    (row,) = tasks.rows.tolist()
    return tasks.data["where"][row], tasks.data["target"][row]


def cosines_of(where: Tensor) -> Cosines:
    """Of places [n, 7], in double precision: half vector, difference vector, cos theta_i."""
    half, difference, incident = (where[:, i].double() for i in (2, 5, 6))
    return Cosines(incident, 2 * half * difference - incident, half, difference)


def space_of(where: Tensor, target: Tensor) -> Space:
    """The components of training materials: places [N, 7] and targets [M, N, 3]."""
    columns = (target.expm1() / where[:, 6:].clamp_min(1e-9)).movedim(0, 1).flatten(1)
    cosines = cosines_of(where)
    weight = (cosines.incident * cosines.outgoing).clamp_min(EPSILON)[:, None].to(columns)
    relative = Relative(weight, columns.median(1, keepdim=True).values)
    return Space(where, relative, components(relative.mapped(columns), max(COUNTS)))


@functools.lru_cache(maxsize=2)
def _space(training: Training, *, whole: bool) -> Space:
    """The components of all training materials, or of those that do not validate.

    Raises:
        ValueError: they are not at the same angles.
    """
    tasks = training.stacked if whole else training.split[0]
    where = tasks.data["where"]
    if where.stride(0):
        raise ValueError("training materials at angles of their own, expected the same for all; use analytic ones.")
    return space_of(where[0], tasks.data["target"][tasks.rows])


def _components(kept: int, training: Training, allowed: Allowed) -> PreparedBaseline:
    """So many components: penalty and solves are chosen on validation materials, then all are taken."""

    def error(setting: tuple[float, int]) -> float:
        fit = ridge_in(_space(training, whole=False), kept, *setting)
        return mean_error(training.app, fit, training.split[1], allowed)

    penalty, solves = min(itertools.product(PENALTIES, SOLVES), key=error)
    space = _space(training, whole=True)
    used = space.components.first(kept)
    shared = bytes_of(used.mean, used.axes, space.relative.reference)
    return PreparedBaseline(ridge_in(space, kept, penalty, solves), shared, {"penalty": penalty, "solves": solves})


def ridge_in(space: Space, kept: int, penalty: float, solves: int) -> FitTask:
    """Fits of coefficients to a material's samples."""
    space = space._replace(components=space.components.first(kept))

    def fit(tasks: Tasks, rng: Generator, allowed: Allowed) -> BaselineFit:
        samples = _at(space.where, tasks, drawn(tasks, rng, allowed.samples))
        found = coefficients(space.at(samples.rows), samples, penalty, solves)
        held = torch.arange(len(space.where) // 2, len(space.where))
        return BaselineFit(lambda: space.at(held).reflectance(found).T[None], found.numel(), bytes_of(found))

    return fit


def _at(where: Tensor, tasks: Tasks, samples: Samples) -> Samples:
    """The samples with their rows among places [N, 7], of which the held-out ones are the same.

    Raises:
        ValueError: they are at others.
    """
    places, half = _of_one(tasks)[0], len(where) // 2
    if torch.equal(places, where):
        return samples
    index = {place.tobytes(): row for row, place in enumerate(where[:half].numpy())}
    rows = [index.get(place.tobytes(), -1) for place in samples.where.numpy()]
    if min(rows) < 0 or not torch.equal(places[half:], where[half:]):
        name = tasks.picked_names[0]
        raise ValueError(f"{name}: at other angles than the training materials; convert both alike.")
    return samples._replace(rows=torch.tensor(rows))


def coefficients(space: Space, samples: Samples, penalty: float, solves: int) -> Tensor:
    """The coefficients [K, 3] of components, of a space at samples, for absolute errors of the table's measure.

    Iteratively reweighted least squares: weights, of mean 1, are slope^2 / |error|, the slope that of the error over
    the residual; at first just the slope, as if residuals were all alike.
    """
    reflectance, used = samples.target.expm1() / samples.cos, space.components
    mapped = space.relative.mapped(reflectance) - used.mean
    slope = samples.cos * (reflectance + EPSILON / space.relative.weight) / samples.target.exp()
    weights, found = slope, mapped
    for solve in range(solves):
        if solve:
            error = (torch.log1p(space.reflectance(found) * samples.cos) - samples.target).abs()
            weights = slope * slope / (error + DELTA * error.mean(0)).clamp_min(1e-12)
        found = ridge(used.axes, mapped, weights / weights.mean(0), used.deviation, penalty * len(mapped))
    return found


def _two_lobes(tasks: Tasks, rng: Generator, allowed: Allowed) -> BaselineFit:
    samples, (where, _) = drawn(tasks, rng, allowed.samples), _of_one(tasks)
    numbers = lobes.fit(cosines_of(samples.where), samples.target.double(), 2).float()

    def answer() -> Tensor:
        return lobes.reflectance(numbers.double(), cosines_of(where[len(where) // 2 :])).float().T[None]

    return BaselineFit(answer, numbers.numel(), bytes_of(numbers))


def _nearest(training: Training, allowed: Allowed) -> PreparedBaseline:
    """The set itself is shared."""
    materials = training.stacked
    targets, where = materials.data["target"], materials.data["where"]

    def distances(tasks: Tasks, rng: Generator, allowed: Allowed) -> Tensor:
        samples = _at(where[0], tasks, drawn(tasks, rng, allowed.samples))
        return (targets[:, samples.rows] - samples.target).abs().mean((1, 2))

    def answer(index: int) -> Tensor:
        half = where.shape[1] // 2
        return (targets[index, half:].expm1() / where[index, half:, 6:].clamp_min(1e-9)).T[None]

    return PreparedBaseline(nearest(distances, answer), bytes_of(where[0], targets))
