"""Applications: a network, the samples it is fitted to, and the distance that says how well it fits."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, ClassVar

import torch
from torch import Generator, Tensor

from metapp.learning.task import RESERVED_TENSORS, Batch, LeastSquares, Params, Task, Tasks, TensorSpec


@dataclass(frozen=True)
class ErrorMeasure:
    """How an application measures the errors of fits.

    Attributes:
        text: the error, in one line.
        scale: factor of errors in records and tables; 100 if the paper prints x100.
        logarithmic: True if the error is a logarithm, of any sign: of two, the difference counts, not the ratio.
        further: other errors whose means tables state, each in one line, by their names in records.

    >>> ErrorMeasure("mean absolute error", scale=100).factor
    ' x100'
    """

    text: str
    scale: float = 1.0
    logarithmic: bool = False
    further: Mapping[str, str] = field(default_factory=dict)

    @property
    def factor(self) -> str:
        """The factor that errors are printed with: " x100"; "" if it is 1."""
        return f" x{self.scale:g}" if self.scale != 1 else ""


@dataclass(frozen=True)
class App(ABC):
    """An application: a network, the samples it is fitted to, and the distance that says how well it fits.

    All methods are batched over tasks: parameters and batches have a leading task axis T. Every application has the
    abstract methods; the others have defaults that do nothing, or leave it to the network. What people look at is made
    by its `metapp.appearance.presenter.Presenter`, which learning does not need. A recipe holds an application, with
    all sizes as its fields; two with the same fields are equal.

    Attributes:
        network: the network of one task, which has `init`; None if the application has that itself. Rules also read its
            `periodic`, whether parameters on a grid go on at the other edge, and its `linear_parameter`, the name of a
            parameter [C, F] in which it is linear, where a network has these.
        protocol: the part of a task that a fit may see, a value of --observe; "" if there is but one.
        name: as on the command line.
        error_measure: how `errors` measures.
        tensors: of each task, by the tensor's name.
        single_threaded: True if tensors of one task are so small that threads and GPUs only slow down its fit, and that
            compiling the inner step pays in training.
        deterministic: True if nothing that a fit sees is drawn at random, so that one fit says what two would.
    """

    network: Any = None
    protocol: str = field(default="", kw_only=True)
    name: ClassVar[str]
    error_measure: ClassVar[ErrorMeasure]
    tensors: ClassVar[Mapping[str, TensorSpec]] = MappingProxyType({})
    single_threaded: ClassVar[bool] = False
    deterministic: ClassVar[bool] = False

    @property
    def cheap_fits(self) -> bool:
        """True if a search can afford to fit all validation tasks."""
        return False

    @property
    def read_size(self) -> int:
        """The px a side, or rows of a map, that a user's files are read at; 0: as their readers do."""
        return 0

    def conditions(self, device: torch.device | None = None) -> dict[str, str]:
        """Return further conditions of its errors, by name: part of every record and caption.

        Args:
            device: of the steps of fits, whose `precision` is then one of the conditions, unless it is float32
                throughout; None for errors alone.
        """
        return {}

    @abstractmethod
    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Prepare a task for fitting, once: tensors without a task axis."""

    def init(self, rng: Generator, count: int) -> Params:
        """Random network parameters for `count` tasks, each tensor [count, ...]."""
        theta: Params = self.network.init(rng, count)
        return theta

    def task_parameters(self, tasks: Tasks) -> Params:
        """Return parameters that tasks determine, [T, ...]: constants of the steps, or their first values."""
        return {}

    @abstractmethod
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """`count` random samples of each task, from the part a fit may see; tensors [T, ...]."""

    def stage(self, tasks: Tasks, done: float) -> Tasks:
        """The part of tasks that a descent sees after this share of its steps, in [0, 1], such as coarse to fine."""
        return tasks

    @abstractmethod
    def loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """The inner loss of each task, [T]; `learned` are its learned parameters, {} for the plain loss."""

    def loss_parameters(self, steps: int) -> Params:
        """Initial values [steps, ...] of the parameters of the inner loss that a rule may learn."""
        return {}

    def least_squares(self, theta: Params, batch: Batch, learned: Params) -> LeastSquares:
        """Least squares near the inner loss, in the network's `linear_parameter`; without one it is not called."""
        raise NotImplementedError

    def outer_sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """`count` samples for the outer loss, tensors [T, ...]: those of fits."""
        return self.sample(tasks, rng, count)

    def outer_loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """The outer loss of each fit, [T]: the inner loss, if training tasks hold no more than a fit may see."""
        return self.loss(theta, batch, learned)

    def init_encoder(self, rng: Generator) -> Params:
        """Random parameters of General's encoder."""
        encoder: Params = self.network.init_encoder(rng)
        return encoder

    @abstractmethod
    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        """The condition I that General's encoder reads of each task."""

    def encode(self, encoder: Params, condition: Batch) -> Params:
        """Network parameters from the condition, one forward pass; tensors [T, ...]."""
        theta: Params = self.network.encode(encoder, condition)
        return theta

    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Data augmentation: as many other tasks, each changed at random, for training only."""
        return tasks

    def postprocess(self, theta: Params) -> Params:
        """Return fits [T, ...] as they are kept, after the last step."""
        return theta

    @abstractmethod
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        """Error measures [T] on the part of each task that fits never see; "error" is the table's, unscaled.

        Empty if the tasks hold no reference.
        """


def stack_tasks(app: App, tasks: Sequence[Task], device: torch.device | str = "cpu") -> Tasks:
    """Prepare tasks and put them side by side.

    Raises:
        ValueError: there is no task, or they differ in their tensors' shapes.
    """
    if not tasks:
        raise ValueError(f"{app.name}: 0 tasks, expected at least one; give input files or another data set.")
    prepared = [
        app.prepare(task) | {key: task.data[key] for key in RESERVED_TENSORS if key in task.data} for task in tasks
    ]
    # a task may lack what is optional
    common = [key for key in prepared[0] if all(key in tensors for tensors in prepared)]
    for task, tensors in zip(tasks, prepared, strict=True):
        for key in common:
            if tensors[key].shape != prepared[0][key].shape:
                raise ValueError(
                    f"{task.name}: {key} {tuple(tensors[key].shape)}, expected {tuple(prepared[0][key].shape)} as of "
                    f"{tasks[0].name}; convert both with the same settings."
                )
    data = {key: _stack([tensors[key] for tensors in prepared], device) for key in common}
    names, groups = (task.name for task in tasks), (task.group or task.name for task in tasks)
    return Tasks(tuple(names), data, torch.arange(len(tasks), device=device), tuple(groups))


def _stack(tensors: list[Tensor], device: torch.device | str) -> Tensor:
    """Stack, or share one copy if all are the same tensor, as sample positions of a data set often are."""
    first = tensors[0]
    if all(torch.equal(first, other) for other in tensors[1:]):
        return first.to(device).expand(len(tensors), *first.shape)
    return torch.stack(tensors).to(device)
