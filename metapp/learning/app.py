"""What an application is: a network, the samples it is fitted to, and the distance that says how well it fits."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import torch
from torch import Generator, Tensor

from metapp.learning.recipe import Recipe
from metapp.learning.task import Batch, Held, Linear, Params, Task, Tasks


class App(ABC):
    """An application: a network, the samples it is fitted to, and the distance that says how well it fits.

    All methods are batched over tasks: parameters and batches have a leading task axis T. What fits look like, and what
    tables say about errors, is the business of its `metapp.appearance.presentation.Presentation`.

    Attributes:
        name: as on the command line.
        holds: what each task must hold, by the tensor's name.
        protocols: what a fit may see, the values of --observe, where there are several; the first is the default.
        protocol: the one of these that is in force; "" where there is none.
        scale: factor of errors in records and tables; 100 where the paper prints x100.
        single_threaded: True where threads and GPUs only slow down the fit of one task.
        compiles: True where compiling the inner step pays in training.
        cheap_fits: True where a search can afford to fit all validation tasks.
        periodic: True where the columns of parameters on a grid, those of three axes, go on at the grid's other edge.
        deterministic: True where nothing that a fit sees is drawn at random, so that one fit says what two would.
        reads: px a side, or rows of a map, that a user's files are read at; 0: as their readers do.
        solves: the parameter [C, F] that the network is linear in, where `linear` says how; "" where there is none.
        own: the parameters that a task does not share with others after General's encoder; () for all.
        recipes: "paper", "quick", and "full", of the size that people use.
    """

    name: str
    holds: Mapping[str, Held] = MappingProxyType({})
    protocols: tuple[str, ...] = ()
    protocol: str = ""
    scale: float = 1.0
    single_threaded: bool = False
    compiles: bool = False
    cheap_fits: bool = False
    periodic: bool = False
    deterministic: bool = False
    reads: int = 0
    solves: str = ""
    own: tuple[str, ...] = ()
    recipes: dict[str, Recipe]

    def at(self, recipe: Recipe, protocol: str = "") -> App:
        """The application at a recipe's setup, under a protocol, its first one where none is named."""
        return self

    def conditions(self) -> dict[str, str]:
        """What else its errors depend on, by name: part of every record, and said wherever errors are printed."""
        return {}

    def precision(self, device: torch.device) -> str:
        """What fits on a device compute in other than float32, in words: part of every record; "" where nothing."""
        return ""

    @abstractmethod
    def prepare(self, task: Task) -> dict[str, Tensor]:
        """What fitting needs of a task, computed once: tensors without a task axis."""

    @abstractmethod
    def init(self, rng: Generator, count: int) -> Params:
        """Random network parameters for `count` tasks, each tensor [count, ...]."""

    def stage(self, tasks: Tasks, done: float) -> Tasks:
        """What a descent sees of tasks after this share of its steps, in [0, 1); here all of them."""
        return tasks

    @abstractmethod
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """`count` random samples of each task, from the part a fit may see; tensors [T, ...]."""

    @abstractmethod
    def loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """The inner loss of each task, [T]; `learned` are its learned parameters, {} for the plain loss."""

    def outer_loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """The outer loss of each fit, [T]: the inner one, unless training tasks know more than a fit may see."""
        return self.loss(theta, batch, learned)

    def outer_sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """`count` samples for the outer loss: drawn as a fit's, unless training tasks know more than a fit may see."""
        return self.sample(tasks, rng, count)

    def linear(self, theta: Params, batch: Batch, learned: Params) -> Linear:
        """Least squares near the inner loss, where the network is linear in the parameter `solves`."""
        raise NotImplementedError

    def loss_parameters(self, steps: int) -> Params:
        """Initial values [steps, ...] of the parameters of the inner loss that a rule may learn."""
        return {}

    @abstractmethod
    def init_encoder(self, rng: Generator) -> Params:
        """Random parameters of General's encoder."""

    @abstractmethod
    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        """The condition I that General's encoder reads of each task."""

    @abstractmethod
    def encode(self, encoder: Params, condition: Batch) -> Params:
        """Network parameters from the condition, one forward pass; tensors [T, ...]."""

    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Data augmentation: as many other tasks, each changed at random, for training only."""
        return tasks

    def evaluated(self, theta: Params, task: Task) -> Task:
        """The task that one fit reproduces without error, for a network that is to learn from another."""
        raise NotImplementedError

    @abstractmethod
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        """Error measures [T] on the part of each task that fits never see; "error" is the table's, unscaled.

        Empty where the tasks hold no reference.
        """

    def errors_of(self, answer: Any, tasks: Tasks) -> dict[str, Tensor]:
        """The same measures of an answer that need not come from the network, as those of `metapp.baselines` do not.

        Args:
            answer: what `errors` makes of parameters before it measures; the application says what that is.
            tasks: as of `errors`.
        """
        raise NotImplementedError


def stack(app: App, tasks: Sequence[Task], device: torch.device | str = "cpu") -> Tasks:
    """Prepare tasks and put them side by side.

    Raises:
        ValueError: there is no task, or they differ in their tensors' shapes.
    """
    if not tasks:
        raise ValueError(f"{app.name}: 0 tasks, expected at least one; give input files or another data set.")
    prepared = [app.prepare(task) for task in tasks]
    common = [key for key in prepared[0] if all(key in each for each in prepared)]  # a task may lack what is optional
    for task, each in zip(tasks, prepared, strict=True):
        for key in common:
            if each[key].shape != prepared[0][key].shape:
                raise ValueError(
                    f"{task.name}: {key} {tuple(each[key].shape)}, expected {tuple(prepared[0][key].shape)} as of "
                    f"{tasks[0].name}; convert both with the same settings."
                )
    data = {key: _stack([each[key] for each in prepared], device) for key in common}
    names, groups = (task.name for task in tasks), (task.group or task.name for task in tasks)
    return Tasks(tuple(names), data, torch.arange(len(tasks), device=device), tuple(groups))


def _stack(tensors: list[Tensor], device: torch.device | str) -> Tensor:
    """Stack, or share one copy where all are the same tensor, as sample positions of a data set often are."""
    first = tensors[0]
    if all(torch.equal(first, other) for other in tensors[1:]):
        return first.to(device).expand(len(tensors), *first.shape)
    return torch.stack(tensors).to(device)
