"""An application: what a fit's parameters mean, what a fit sees, how it is judged, and how General predicts it.

Learning needs these methods and nothing else, so that an application runs in a notebook without the command line. What
people look at is made elsewhere: of assets, see :mod:`metapp.appearance.assets`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, ClassVar

import torch
from torch import Generator, Tensor

from metapp.learning.components import Decoder, Encoder, Judge, Sight, name_tensors
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
class App:
    """An application: a decoder, a sight, a judge and an encoder.

    A subclass states the name, the error measure and the tensors of tasks, and how training tasks are augmented. A
    recipe holds an application; all sizes are fields of it and of its components, so that two applications with equal
    fields are equal.

    Methods that take fits or tasks are batched: parameters and batches have a leading task axis T. What :meth:`prepare`
    returns of each task is stacked: methods that take `tasks` find a tensor of the T selected tasks as
    `tasks.data[name][tasks.rows]`.

    Attributes:
        decoder: the meaning of parameters.
        sight: what a fit sees.
        judge: the truth, and how answers are judged by it.
        encoder: General's encoder.
        name: the application's name on the command line.
        error_measure: the meaning and the scale of the errors that `errors` returns.
        tensors: the form of each tensor of a task, by the tensor's name.
        small_tensors: whether the tensors of one task are so small that threads and GPUs only slow its fit down, and
            that compiling the inner step pays in training.
        deterministic: whether a fit observes nothing random, so that a second fit would give the first one's result.
    """

    decoder: Decoder[Any, Any]
    sight: Sight[Any, Any]
    judge: Judge[Any, Any, Any]
    encoder: Encoder[Any]

    name: ClassVar[str]
    error_measure: ClassVar[ErrorMeasure]
    tensors: ClassVar[Mapping[str, TensorSpec]] = MappingProxyType({})
    small_tensors: ClassVar[bool] = False
    deterministic: ClassVar[bool] = False

    @property
    def observes(self) -> str:
        """What fits observe of a task, a value of --observe; "" if all fits of the application observe the same."""
        return self.sight.observes

    @property
    def is_periodic(self) -> bool:
        """Whether parameters on a grid continue at the opposite edge, which some update rules ask for."""
        return self.decoder.is_periodic

    @property
    def linear_parameter(self) -> str:
        """The name of a parameter [C, F] in which the network's output is linear; "" if there is none."""
        return self.decoder.linear_parameter

    @property
    def encoder_settings(self) -> tuple[object, ...]:
        """The settings by which applications can share a checkpoint of General: those with equal ones do.

        Sights may differ, since General's outer loss is the judge's.
        """
        return self.decoder, self.encoder, self.judge

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
        return self.encoder.recorded_conditions(device)

    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Prepare what a fit sees of a task and, if the task has one, the truth, by the names of their fields.

        Tensors have no task axis. Tasks that are fitted together must have tensors of equal shapes.
        """
        seen, truth = name_tensors(self.sight.prepare(task, self.decoder)), self.judge.prepare(task, self.decoder)
        return seen if truth is None else seen | name_tensors(truth)

    def init(self, rng: Generator, count: int) -> Params:
        """Draw random network parameters for `count` tasks; each tensor is [count, ...]."""
        return self.decoder.init(rng, count)

    def task_parameters(self, tasks: Tasks) -> Params:
        """Return parameters [T, ...] that tasks determine: constants of fits, or first values of what they learn."""
        return self.sight.task_parameters(tasks, self.decoder)

    @property
    def task_parameter_specs(self) -> Mapping[str, TensorSpec]:
        """The forms of the parameters that :meth:`task_parameters` returns, by name, without a task axis.

        Letters in them stand for sizes that differ from task to task, such as the number of a task's photographs.
        """
        return self.sight.task_parameter_specs

    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Draw `count` random samples of each task from the part that a fit may observe; tensors are [T, ...]."""
        return name_tensors(self.sight.sample(tasks, rng, count))

    def coarsen(self, tasks: Tasks, done: float) -> Tasks:
        """Return the tasks as a descent observes them at some share of its steps, for example coarse tasks first.

        Args:
            tasks: the complete tasks.
            done: the share of the steps that were taken, in [0, 1].
        """
        return self.sight.coarsen(tasks, done)

    def loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        """Compute the inner loss of each task, [T].

        Args:
            theta: network parameters [T, ...].
            batch: samples [T, ...] that :meth:`sample` drew.
            loss_parameters: the values [T, ...] that a rule has learned; {} gives the plain loss.
        """
        seen = self.sight.read(batch)
        return self.sight.loss(self.decoder.decode_for_steps(theta, seen), seen, loss_parameters)

    def initial_loss_parameters(self, steps: int) -> Params:
        """Return initial values [steps, ...] of the loss parameters that a rule may learn, by name."""
        return self.sight.initial_loss_parameters(steps)

    def least_squares(self, theta: Params, batch: Batch, loss_parameters: Params) -> LeastSquares:
        """Return least squares near the inner loss in the parameter :attr:`linear_parameter`.

        It is called only for applications that have one. See :meth:`loss` for the arguments.
        """
        return self.sight.least_squares(self.decoder, theta, self.sight.read(batch), loss_parameters)

    @property
    def has_outer_loss(self) -> bool:
        """Whether the outer loss is a function of its own; else it is the inner loss of other samples."""
        return not self.judge.trains_by_sight

    def outer_sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Draw what the judge compares. Unless the judge trains by the sight, draw what a step of a fit sees, too."""
        drawn = name_tensors(self.judge.sample(tasks, rng, count))
        return drawn if self.judge.trains_by_sight else self.sample(tasks, rng, count) | drawn

    def outer_loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        """Compute the outer loss of each fit, [T].

        Args:
            theta: the fits [T, ...].
            batch: what :meth:`outer_sample` drew.
            loss_parameters: the values [T, ...] that a rule has learned, which inner losses of other samples read.
        """
        if self.judge.trains_by_sight:
            return self.loss(theta, batch, loss_parameters)
        seen = self.sight.read(batch)
        return self.judge.outer_loss(self.decoder.decode_for_training(theta, seen), seen, self.judge.read(batch))

    def init_encoder(self, rng: Generator) -> Params:
        """Draw random parameters of General's encoder."""
        return self.encoder.init(rng, self.decoder)

    def encoder_input(self, tasks: Tasks, rng: Generator) -> Batch:
        """Return the input of General's encoder for each task (I in the paper); tensors are [T, ...]."""
        count = self.encoder.samples
        seen = self.sight.gather(tasks) if count is None else self.sight.sample(tasks, rng, count)
        return self.encoder.select_input(seen)

    def encode(self, encoder: Params, encoder_input: Batch) -> Params:
        """Predict network parameters [T, ...] in one forward pass of the encoder.

        Args:
            encoder: the parameters of the encoder.
            encoder_input: the input [T, ...] of the encoder for each task, from :meth:`encoder_input`.
        """
        return self.encoder(encoder, encoder_input, self.decoder)

    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Return as many augmented tasks, each a random variation of one of the tasks; for training only."""
        return tasks

    def postprocess(self, theta: Params, tasks: Tasks | None = None) -> Params:
        """Change fits [T, ...] after their last step, before they are evaluated and stored.

        Args:
            theta: the fits.
            tasks: the fitted tasks; None for parameters that were not fitted, of which only names and shapes count.
        """
        return self.decoder.postprocess(theta)

    def prediction(self, theta: Params, seen: Any) -> Any:
        """Return what is shown and judged of fits [T, ...]; see :meth:`metapp.learning.components.Sight.complete`.

        Args:
            theta: fits [T, ...].
            seen: what the fits saw, from `sight.gather`.
        """
        return self.sight.complete(self.decoder(theta, seen), seen)

    @torch.no_grad()
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        """Measure errors [T], by name, on the part of each task that fits never observe.

        Returns:
            The error of tables as "error", without the scale of :attr:`error_measure`, and further errors; {} if the
            tasks contain no reference to compare with.
        """
        truth = self.judge.gather(tasks)
        if truth is None:
            return {}
        return self.errors_of(self.judge.query(self.prediction(theta, self.sight.gather(tasks)), truth), tasks)

    def errors_of(self, prediction: Any, tasks: Tasks) -> dict[str, Tensor]:
        """Measure predictions of fits or baselines, see :meth:`metapp.learning.components.Judge.errors`.

        Returns:
            Errors [T] by name; {} if the tasks have no truth.
        """
        truth = self.judge.gather(tasks)
        return {} if truth is None else self.judge.errors(prediction, self.sight.gather(tasks), truth)


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
