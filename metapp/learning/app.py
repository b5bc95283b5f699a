"""What an application is: a network, the samples it is fitted to, and the distance that says how well it fits."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import torch
from torch import Generator, Tensor

from metapp.learning.recipe import Recipe
from metapp.learning.task import Batch, Held, Params, Task, Tasks


class Visible(NamedTuple):
    """What a fit may see of a task.

    Attributes:
        samples: how many it draws from; 1 where each step sees all there is.
        size: bytes of one, as data sets keep it.
        encoder: samples that General's encoder reads of these.
    """

    samples: int
    size: int
    encoder: int


REFERENCE = "reference"  # among measures of pictures: what the references are off by themselves


class Fitted(NamedTuple):
    """A fit of one task: parameters without task axis, and the seconds of inference that it took."""

    theta: Params
    seconds: float


class App(ABC):
    """An application: a network, the samples it is fitted to, and the distance that says how well it fits.

    All methods are batched over tasks: parameters and batches have a leading task axis T.

    Attributes:
        name: as on the command line.
        title: as in tables.
        holds: what each task must hold, by the tensor's name.
        protocols: what a fit may see, the values of --observe, where there are several; the first is the default.
        protocol: the one of these that is in force; "" where there is none.
        measure: what the error is, in one line.
        scale: factor of a printed error; 100 where the paper prints x100.
        small_kernels: True where threads and GPUs only slow the network down, fitted to one task.
        wraps: True where the columns of parameters on a grid, those of three axes, go on at the grid's other edge.
        logarithmic: True where the error is a logarithm, of any sign: of two, the difference counts, not the ratio.
        random: False where nothing that a fit sees is drawn at random, so that one fit says what two would.
        recipes: "paper" and "quick".
        raw: names of those `files` that are linear data and no colours, such as normals; all others are sRGB.
        heights: names of those raw `files` that are heights in texels, of any range: kept stretched to [0, 1], with
            both ends as the text of the PNG.
        radiance: names of those `files` that are linear radiance of any range, kept as EXR.
        image_measure: what `image_errors` are of, in one line; "" where there are none.
        image_seconds: that they take a task, about, to tell the time left before any was measured.
    """

    name: str
    title: str
    holds: Mapping[str, Held] = MappingProxyType({})
    protocols: tuple[str, ...] = ()
    protocol: str = ""
    measure: str
    scale: float = 1.0
    small_kernels: bool = False
    wraps: bool = False
    logarithmic: bool = False
    random: bool = True
    recipes: dict[str, Recipe]
    raw: tuple[str, ...] = ()
    heights: tuple[str, ...] = ()
    radiance: tuple[str, ...] = ()
    image_measure: str = ""
    image_seconds: float = 0.1

    def at(self, recipe: Recipe, observe: str = "") -> App:
        """The application at a recipe's setup, under a protocol, its first one where none is named."""
        return self

    def conditions(self) -> dict[str, str]:
        """What else its errors depend on, by name: part of every record, and said wherever errors are printed."""
        return {}

    @abstractmethod
    def prepare(self, task: Task) -> dict[str, Tensor]:
        """What fitting needs of a task, computed once: tensors without a task axis."""

    @abstractmethod
    def init(self, rng: Generator, count: int) -> Params:
        """Random network parameters for `count` tasks, each tensor [count, ...]."""

    @abstractmethod
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """`count` random samples of each task, from the part a fit may see; tensors [T, ...]."""

    @abstractmethod
    def loss(self, theta: Params, batch: Batch, shape: Params) -> Tensor:
        """The loss of each task, [T]; `shape` holds learned quantities of the loss, {} for the plain one."""

    def goal(self, theta: Params, batch: Batch, shape: Params) -> Tensor:
        """What preparation wants of a fit, [T]: the loss itself, unless training tasks know more than a fit may see."""
        return self.loss(theta, batch, shape)

    def shape(self, steps: int) -> Params:
        """Initial values [steps, ...] of the quantities of the inner loss that a rule may learn."""
        return {}

    @abstractmethod
    def init_encoder(self, rng: Generator) -> Params:
        """Random parameters of General's encoder."""

    @abstractmethod
    def observe(self, tasks: Tasks, rng: Generator) -> Batch:
        """The condition I that General's encoder sees of each task."""

    @abstractmethod
    def encode(self, encoder: Params, observed: Batch) -> Params:
        """Network parameters from the condition, one forward pass; tensors [T, ...]."""

    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Made-up tasks related to these, as many, for training only."""
        return tasks

    @abstractmethod
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        """Error measures [T] on the part of each task that fits never see; "error" is the table's, unscaled.

        Empty where the tasks hold no reference.
        """

    @abstractmethod
    def outputs(self, theta: Params, task: Task) -> dict[str, Any]:
        """Linear RGB pictures [H, W, 3 or 4] of one fitted task and its reference, by name (no task axis in theta)."""

    def visible(self, task: Task) -> Visible | None:
        """How much a fit may see of a task; None where the application does not say."""
        return None

    def image_errors(self, fits: Mapping[str, Fitted], task: Task) -> dict[str, dict[str, float]]:
        """Measures of the pictures that fits of a task make, by the fit's name, then by the measure's, such as SSIM.

        There may be further names, of pictures that are made without any fit; REFERENCE is of the references' own
        error. Of measures whose name begins with SSIM
        more is better, of others less. Empty where there are none.
        """
        return {}

    def files(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """What a fit makes for its user, by file name: display values [H, W, 1 or 3] in [0, 1], kept as PNG.

        Those named in `raw` are linear data; of these, those in `heights` may have any range. Those named in `radiance`
        are linear, of any range, and kept as EXR.
        """
        return {}


def stack(app: App, tasks: Sequence[Task], device: torch.device | str = "cpu") -> Tasks:
    """Prepare tasks and put them side by side.

    Raises:
        ValueError: there is no task, or they differ in their tensors' shapes.
    """
    if not tasks:
        raise ValueError(f"{app.name}: 0 tasks, expected at least one; give input files or another data set.")
    prepared = [app.prepare(task) for task in tasks]
    for task, each in zip(tasks, prepared, strict=True):
        for key, value in prepared[0].items():
            if each[key].shape != value.shape:
                raise ValueError(
                    f"{task.name}: {key} {tuple(each[key].shape)}, expected {tuple(value.shape)} as of "
                    f"{tasks[0].name}; convert both with the same settings."
                )
    data = {key: _stack([each[key] for each in prepared], device) for key in prepared[0]}
    names, groups = (task.name for task in tasks), (task.group or task.name for task in tasks)
    return Tasks(tuple(names), data, torch.arange(len(tasks), device=device), tuple(groups))


def _stack(tensors: list[Tensor], device: torch.device | str) -> Tensor:
    """Stack, or share one copy where all are the same tensor, as sample positions of a data set often are."""
    first = tensors[0]
    if len(tensors) > 1 and all(torch.equal(first, other) for other in tensors[1:]):
        return first.to(device).expand(len(tensors), *first.shape)
    return torch.stack(tensors).to(device)
