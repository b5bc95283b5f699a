"""Densities of light paths: the decoder, what a fit sees of a scene, and how it is judged.

Scenes are traced, and pictures rendered, by other modules: losses and errors here are likelihoods of samples.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.apps.transport.flow import Flow
from metapp.learning.components import Decoder, Judge, Sight, VisibleData
from metapp.learning.task import Params, Task, Tasks

OUTER_SAMPLES = 2048  # paths of a training scene that its outer loss sees, at most

# A function of points [T, 4, N] of primary sample space that returns log q(film) and log q(directions | film), [T, N]
PathDensity = Callable[[Tensor], tuple[Tensor, Tensor]]


class SeenPaths(NamedTuple):
    """A scene as fits see it.

    Attributes:
        samples: light paths in primary sample space, [T, N, 4] in [0, 1], in proportion to the luminance they carry.
        image: the linear picture of the scene, [T, 3, 32, 32], which General's encoder alone reads.
    """

    samples: Tensor
    image: Tensor


class HeldOutPaths(NamedTuple):
    """Light paths that no fit sees: `held_out` [T, M, 4], like those of :class:`SeenPaths`."""

    held_out: Tensor


@dataclass(frozen=True)
class FlowDensity(Decoder[PathDensity, SeenPaths]):
    """The decoder of densities that a flow has.

    Attributes:
        network: the flow.
    """

    network: Flow

    @override
    def init(self, rng: Generator, count: int) -> Params:
        return self.network.init(rng, count)

    @override
    def __call__(self, theta: Params, seen: Any = None) -> PathDensity:
        return functools.partial(self.network.log_density, theta)


@dataclass(frozen=True)
class PathSight(Sight[PathDensity, SeenPaths]):
    """The sight of light paths of a scene: random ones in each step."""

    seen_type = SeenPaths

    @override
    def describe_visible(self, task: Task) -> VisibleData:
        """Return how many light paths steps draw from; General's encoder reads the picture alone."""
        samples = task.data["samples"]
        return VisibleData(len(samples), samples[0].nbytes, 0)

    @override
    def prepare(self, task: Task, decoder: FlowDensity) -> SeenPaths:
        return SeenPaths(task.data["samples"].float(), task.data["image"].float())

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> SeenPaths:
        return draw_paths(tasks, rng, count)

    @override
    def loss(self, answer: PathDensity, seen: SeenPaths, loss_parameters: Params) -> Tensor:
        """Return the mean negative log-likelihood of the paths, [T]."""
        film, directions = answer(seen.samples.mT.contiguous())
        return -(film + directions).mean(1)


@dataclass(frozen=True)
class PathJudge(Judge[PathDensity, SeenPaths, HeldOutPaths]):
    """The judge of densities by the likelihood of light paths that are held out."""

    truth_type, sampled_type = HeldOutPaths, SeenPaths
    trains_by_sight = True

    @override
    def prepare(self, task: Task, decoder: FlowDensity) -> HeldOutPaths | None:
        return HeldOutPaths(task.data["held_out"].float()) if "held_out" in task.data else None

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> SeenPaths:
        """Draw at most OUTER_SAMPLES paths of those that fits see: scenes differ more than paths of one scene do."""
        return draw_paths(tasks, rng, min(count, OUTER_SAMPLES))

    @override
    def query(self, answer: PathDensity, truth: HeldOutPaths) -> tuple[Tensor, Tensor]:
        """Return log q(film) and log q(directions | film) of the held-out paths, [T, M] each."""
        return answer(truth.held_out.mT)

    @override
    def errors(self, prediction: tuple[Tensor, Tensor], seen: SeenPaths, truth: HeldOutPaths) -> dict[str, Tensor]:
        """Return the mean negative log-likelihood, `error` [T], and its parts `film` and `directions`."""
        film, directions = prediction
        return {"error": -(film + directions).mean(1), "film": -film.mean(1), "directions": -directions.mean(1)}


def draw_paths(tasks: Tasks, rng: Generator, count: int) -> SeenPaths:
    """Draw `count` of the paths of each task that fits see."""
    samples = tasks.data["samples"]
    rows = torch.randint(samples.shape[1], (len(tasks), count), generator=rng, device=rng.device)
    return SeenPaths(samples[tasks.rows[:, None], rows], tasks.data["image"][tasks.rows])
