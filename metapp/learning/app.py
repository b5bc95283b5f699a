"""The contract of an application: a network, the samples it is fitted to, and the distance that says how well it fits.

Learning needs these methods and nothing else, so that an application runs in a notebook without the command line.
Applications fulfil the contract by components, see :mod:`metapp.learning.composed`.
What people look at, such as pictures and surfaces, is made elsewhere, by `metapp.appearance.presenter.Presenter`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import ClassVar

import torch
from torch import Generator, Tensor

from metapp.learning.task import RESERVED_TENSORS, Batch, LeastSquares, Params, Task, Tasks, TensorSpec


@dataclass(frozen=True)
class ErrorMeasure:
    """The meaning and the scale of an application's errors.

    Attributes:
        text: what the error is, in one line.
        scale: the factor by which errors are multiplied in records and tables; 100 where the paper prints x100.
        logarithmic: whether the error is a logarithm and may have any sign: two errors are then compared by their
            difference, not by their ratio.
        further: further errors whose means are printed in tables: one line each, by the names that records give them.

    >>> ErrorMeasure("mean absolute error", scale=100).factor
    ' x100'
    """

    text: str
    scale: float = 1.0
    logarithmic: bool = False
    further: Mapping[str, str] = field(default_factory=dict)

    @property
    def factor(self) -> str:
        """The factor by which printed errors are multiplied, such as " x100"; "" if it is 1."""
        return f" x{self.scale:g}" if self.scale != 1 else ""


@dataclass(frozen=True)
class App(ABC):
    """An application: a network, the samples it is fitted to, and the distance that says how well it fits.

    Methods that take fits or tasks are batched: parameters and batches have a leading task axis T. Every application
    defines the abstract methods; the other methods have defaults. A recipe holds an application; all sizes are fields
    of it, so that two applications with equal fields are equal. A subclass with fields of its own is a frozen
    dataclass, too.

    What :meth:`prepare` returns of each task is stacked: methods that take `tasks` find a tensor of the T selected
    tasks as `tasks.data[name][tasks.rows]`. An application that has baselines defines `errors_of(prediction, tasks)`,
    too: it measures a prediction that need not come from the network, and :meth:`errors` calls it.

    Attributes:
        name: the application's name on the command line.
        error_measure: the meaning and the scale of the errors that `errors` returns.
        tensors: the form of each tensor of a task, by the tensor's name.
        small_tensors: whether the tensors of one task are so small that threads and GPUs only slow its fit down, and
            that compiling the inner step pays in training.
        deterministic: whether a fit observes nothing random, so that a second fit would give the first one's result.
    """

    name: ClassVar[str]
    error_measure: ClassVar[ErrorMeasure]
    tensors: ClassVar[Mapping[str, TensorSpec]] = MappingProxyType({})
    small_tensors: ClassVar[bool] = False
    deterministic: ClassVar[bool] = False

    @property
    def observes(self) -> str:
        """What fits observe of a task, a value of --observe; "" if all fits of the application observe the same."""
        return ""

    @property
    def is_periodic(self) -> bool:
        """Whether parameters on a grid continue at the opposite edge, which some update rules ask for."""
        return False

    @property
    def linear_parameter(self) -> str:
        """The name of a parameter [C, F] in which the network's output is linear; "" if there is none."""
        return ""

    @property
    def encoder_settings(self) -> tuple[object, ...]:
        """The settings by which applications can share a checkpoint of General: those with equal ones do."""
        # named tuples of different types are equal where their fields are
        return tuple((type(value), value) for value in (getattr(self, field.name) for field in fields(self)))

    @property
    def full_name(self) -> str:
        """The name of the application, followed by what fits observe, if that may differ: "illumination photo"."""
        return f"{self.name} {self.observes}".rstrip()

    @property
    def observation(self) -> dict[str, str]:
        """The entry `observe` of records, rows and headers of checkpoints; {} if all fits observe the same."""
        return {"observe": self.observes} if self.observes else {}

    @property
    def read_size(self) -> int:
        """The size at which a user's files are read, in px a side or rows of a map; 0 leaves it to the readers."""
        return 0

    def recorded_conditions(self, device: torch.device | None = None) -> dict[str, str]:
        """Return the conditions that errors depend on, by name, which every record and caption states.

        Args:
            device: the device on which fits take their steps: the precision of steps there is then one of the
                conditions, `precision`, unless it is float32 throughout. None returns the conditions of errors alone.
        """
        return {}

    @abstractmethod
    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Prepare one task for fitting, once, and return tensors without a task axis, by name.

        Tasks that are fitted together must have tensors of equal shapes.
        """

    @abstractmethod
    def init(self, rng: Generator, count: int) -> Params:
        """Draw random network parameters for `count` tasks; each tensor is [count, ...]."""

    def task_parameters(self, tasks: Tasks) -> Params:
        """Return parameters [T, ...] that tasks determine: constants of fits, or first values of what they learn."""
        return {}

    @property
    def task_parameter_specs(self) -> Mapping[str, TensorSpec]:
        """The forms of the parameters that :meth:`task_parameters` returns, by name, without a task axis.

        Letters in them stand for sizes that differ from task to task, such as the number of a task's photographs.
        """
        return {}

    @abstractmethod
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Draw `count` random samples of each task from the part that a fit may observe; tensors are [T, ...]."""

    def coarsen(self, tasks: Tasks, done: float) -> Tasks:
        """Return the tasks as a descent observes them at some share of its steps, for example coarse tasks first.

        Args:
            tasks: the complete tasks.
            done: the share of the steps that were taken, in [0, 1].
        """
        return tasks

    @abstractmethod
    def loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        """Compute the inner loss of each task, [T].

        Args:
            theta: network parameters [T, ...].
            batch: samples [T, ...] that :meth:`sample` drew.
            loss_parameters: the values [T, ...] that a rule has learned; {} gives the plain loss.
        """

    def initial_loss_parameters(self, steps: int) -> Params:
        """Return initial values [steps, ...] of the loss parameters that a rule may learn, by name."""
        return {}

    def least_squares(self, theta: Params, batch: Batch, loss_parameters: Params) -> LeastSquares:
        """Return least squares near the inner loss in the parameter :attr:`linear_parameter`.

        It is called only for applications that have one. See :meth:`loss` for the arguments.
        """
        raise NotImplementedError

    @property
    def has_outer_loss(self) -> bool:
        """Whether the outer loss is a function of its own; else it is the inner loss of other samples."""
        return type(self).outer_loss is not App.outer_loss

    def outer_sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Draw `count` samples of each task for the outer loss; tensors are [T, ...].

        By default they are drawn like samples of fits. See :meth:`sample`.
        """
        return self.sample(tasks, rng, count)

    def outer_loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        """Compute the outer loss of each fit, [T].

        The default is the inner loss, for training tasks that contain no more than a fit may observe. See
        :meth:`loss` for the arguments.
        """
        return self.loss(theta, batch, loss_parameters)

    @abstractmethod
    def init_encoder(self, rng: Generator) -> Params:
        """Draw random parameters of General's encoder."""

    @abstractmethod
    def encoder_input(self, tasks: Tasks, rng: Generator) -> Batch:
        """Return the input of General's encoder for each task (I in the paper); tensors are [T, ...]."""

    @abstractmethod
    def encode(self, encoder: Params, encoder_input: Batch) -> Params:
        """Predict network parameters [T, ...] in one forward pass of the encoder.

        Args:
            encoder: the parameters of the encoder.
            encoder_input: the input [T, ...] of the encoder for each task, from :meth:`encoder_input`.
        """

    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Return as many augmented tasks, each a random variation of one of the tasks; for training only."""
        return tasks

    def postprocess(self, theta: Params, tasks: Tasks | None = None) -> Params:
        """Change fits [T, ...] after their last step, before they are evaluated and stored.

        Args:
            theta: the fits.
            tasks: the fitted tasks; None for parameters that were not fitted, of which only names and shapes count.
        """
        return theta

    @abstractmethod
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        """Measure errors [T], by name, on the part of each task that fits never observe.

        Returns:
            The error of tables as "error", without the scale of :attr:`error_measure`, and further errors; {} if the
            tasks contain no reference to compare with.
        """


def stack_tasks(app: App, tasks: Sequence[Task], device: torch.device | str = "cpu") -> Tasks:
    """Prepare tasks and stack their tensors along a new task axis.

    Tensors that some of the tasks lack, because they are optional, are left out. See :meth:`App.prepare`.

    Raises:
        ValueError: there is no task, or the tensors of tasks differ in their shapes.
    """
    if not tasks:
        raise ValueError(f"{app.name}: 0 tasks, expected at least one; give input files or another data set.")
    prepared = [
        app.prepare(task) | {key: task.data[key] for key in RESERVED_TENSORS if key in task.data} for task in tasks
    ]
    # a task may lack optional tensors, and a stack has only those that all tasks have
    common = [key for key in prepared[0] if all(key in tensors for tensors in prepared)]
    for task, tensors in zip(tasks, prepared, strict=True):
        for key in common:
            if tensors[key].shape != prepared[0][key].shape:
                raise ValueError(
                    f"{task.name}: {key} {tuple(tensors[key].shape)}, expected {tuple(prepared[0][key].shape)} like "
                    f"{tasks[0].name}; convert both with the same settings."
                )
    data = {key: _stack([tensors[key] for tensors in prepared], device) for key in common}
    names, groups = (task.name for task in tasks), (task.group or task.name for task in tasks)
    return Tasks(tuple(names), data, torch.arange(len(tasks), device=device), tuple(groups))


def _stack(tensors: list[Tensor], device: torch.device | str) -> Tensor:
    """Stack tensors, or expand one of them if all are equal, as sample positions of a data set often are."""
    first = tensors[0]
    if all(torch.equal(first, other) for other in tensors[1:]):
        return first.to(device).expand(len(tensors), *first.shape)
    return torch.stack(tensors).to(device)
