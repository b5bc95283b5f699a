"""An application made of four components: a decoder, a sight, a judge and an encoder.

They answer four questions about the paper's L_theta(x | I). The decoder: what do parameters theta mean? The sight:
which observations I does a fit see, and how far is an answer from them? The judge: how far is an answer from the truth,
which fits never see? The encoder: which parameters does General predict? Components that agree on the types of answers
and of what is seen can be exchanged: fits of an environment map and of a photographed ball differ in their sights.

What a sight and a judge prepare of a task are named tuples of tensors without a task axis. Tasks that are fitted
together stack these tensors, by the names of the fields: all other methods find them with a leading task axis T. Fields
of a sight and of a judge that have one name are one tensor; the judge's replaces the sight's.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Generic, TypeVar

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.learning.app import App
from metapp.learning.task import Batch, LeastSquares, Params, Task, Tasks, TensorSpec

Answer = TypeVar("Answer")
Seen = TypeVar("Seen")
Truth = TypeVar("Truth")


def name_tensors(tensors: Any) -> Batch:
    """Return tensors by name: the fields of a named tuple, or a dictionary, for components whose number varies."""
    batch: Batch = tensors if isinstance(tensors, dict) else tensors._asdict()
    return batch


class Decoder(ABC, Generic[Answer, Seen]):
    """The meaning of the parameters of a fit: a function from parameters to an answer, such as maps of a material."""

    @property
    def is_periodic(self) -> bool:
        """Whether parameters on a grid continue at the opposite edge, which some update rules ask for."""
        return False

    @property
    def linear_parameter(self) -> str:
        """The name of a parameter [C, F] in which answers are linear but for a last function; "" if there is none."""
        return ""

    @abstractmethod
    def init(self, rng: Generator, count: int) -> Params:
        """Draw random parameters for `count` tasks; each tensor is [count, ...]."""

    @abstractmethod
    def __call__(self, theta: Params, seen: Seen) -> Answer:
        """Return the answer of each task.

        Args:
            theta: parameters [T, ...].
            seen: what the fits saw, [T, ...], on which an answer may depend, too: I in the paper.
        """

    def decode_for_steps(self, theta: Params, seen: Seen) -> Answer:
        """Return the answers whose gradients steps of fits follow. The default is the answer itself.

        A decoder that keeps steps from changing some parameters detaches them here.
        """
        return self(theta, seen)

    def decode_for_training(self, theta: Params, seen: Seen) -> Any:
        """Return what outer losses are of. The default is the answer itself."""
        return self(theta, seen)

    def postprocess(self, theta: Params) -> Params:
        """Change fits [T, ...] after their last step, before they are evaluated and stored. The default keeps them."""
        return theta


class Sight(ABC, Generic[Answer, Seen]):
    """The observations of a task that a fit sees, and the loss of an answer by them.

    What is seen is a named tuple of tensors. A sight of a varying number of tensors shows a dictionary of them, and
    overrides :meth:`gather` and :meth:`read`.

    Attributes:
        observes: what fits see, a value of --observe; "" if all fits of the application see the same.
        seen_type: the named tuple that :meth:`prepare` returns.
    """

    observes: ClassVar[str] = ""
    seen_type: ClassVar[type[Any]]

    @abstractmethod
    def prepare(self, task: Task, decoder: Any) -> Seen:
        """Prepare what a fit sees of one task, without a task axis.

        Args:
            task: the task.
            decoder: the decoder of the application, whose sizes the tensors follow.

        Raises:
            ValueError: the task lacks what a fit must see.
        """

    def seen_type_of(self, tensors: Mapping[str, Tensor]) -> type[Any]:
        """Return the named tuple of what tensors by name show. The default is :attr:`seen_type`.

        A sight whose training shows something else than its fits see overrides it.
        """
        return self.seen_type

    def gather(self, tasks: Tasks) -> Seen:
        """Return all that fits see of tasks, [T, ...]."""
        seen_type = self.seen_type_of(tasks.data)
        seen: Seen = seen_type(**tasks.gather(seen_type._fields))
        return seen

    def coarsen(self, tasks: Tasks, done: float) -> Tasks:
        """Return the tasks as a descent sees them at some share of its steps, see :meth:`App.coarsen`."""
        return tasks

    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Seen:
        """Draw what one step sees of each task, [T, ...]. The default is all that fits see, whatever the count."""
        return self.gather(tasks)

    def read(self, batch: Batch) -> Seen:
        """Return what :meth:`sample` drew, given the tensors [T, ...] of a batch by name."""
        seen_type = self.seen_type_of(batch)
        seen: Seen = seen_type(*(batch[name] for name in seen_type._fields))
        return seen

    @abstractmethod
    def loss(self, answer: Answer, seen: Seen, loss_parameters: Params) -> Tensor:
        """Compute the inner loss of each task, [T].

        Args:
            answer: the answers of the decoder.
            seen: what :meth:`sample` drew.
            loss_parameters: the values [T, ...] that a rule has learned; {} gives the plain loss.
        """

    def initial_loss_parameters(self, steps: int) -> Params:
        """Return initial values [steps, ...] of the loss parameters that a rule may learn. The default is none."""
        return {}

    def least_squares(self, decoder: Any, theta: Params, seen: Seen, loss_parameters: Params) -> LeastSquares:
        """Return least squares near the inner loss in the decoder's `linear_parameter`; see :meth:`loss`.

        It is called only for decoders that have one.
        """
        raise NotImplementedError

    def task_parameters(self, tasks: Tasks, decoder: Any) -> Params:
        """Return parameters [T, ...] that follow from what is seen without any step. The default is none."""
        return {}

    @property
    def task_parameter_specs(self) -> Mapping[str, TensorSpec]:
        """The forms of the parameters that fits have besides those that the decoder draws, or in another shape."""
        return {}

    def complete(self, answer: Answer, seen: Seen) -> Any:
        """Return what is shown and judged of answers: with that which is seen better than it is fitted.

        The default is the answer itself.
        """
        return answer


class Judge(ABC, Generic[Answer, Seen, Truth]):
    """The truth that fits do not see: errors of fits and of baselines, and the outer loss by which training learns.

    The truth is a named tuple of tensors. A judge of tensors that are optional one by one takes a dictionary of them,
    and overrides :meth:`gather` and :meth:`read`.

    Attributes:
        truth_type: the named tuple that :meth:`prepare` returns.
        sampled_type: the named tuple that :meth:`sample` returns.
        trains_by_sight: whether the outer loss is the sight's loss of what :meth:`sample` draws, which then has the
            form of what fits see. Else :meth:`outer_loss` is the outer loss.
    """

    truth_type: ClassVar[type[Any]]
    sampled_type: ClassVar[type[Any]]
    trains_by_sight: ClassVar[bool] = False

    @abstractmethod
    def prepare(self, task: Task, decoder: Any) -> Truth | None:
        """Prepare the truth of one task, without a task axis; None if the task has none."""

    def gather(self, tasks: Tasks) -> Truth | None:
        """Return the truth of tasks, [T, ...]; None if not all tasks have it."""
        names = self.truth_type._fields
        return self.truth_type(**tasks.gather(names)) if tasks.data.keys() >= set(names) else None

    def require(self, tasks: Tasks) -> Truth:
        """Return the truth of training tasks, [T, ...].

        Raises:
            ValueError: not all tasks have it.
        """
        truth = self.gather(tasks)
        if truth is None:
            missing = next(name for name in self.truth_type._fields if name not in tasks.data)
            raise ValueError(
                f"{tasks.selected_names[0]}: no {missing} in this or another training task, expected the truth in all; "
                "train on a data set that has it."
            )
        return truth

    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Any:
        """Draw what the outer loss compares, [T, ...]. The default is all of the truth.

        Raises:
            ValueError: not all tasks have the truth.
        """
        return self.require(tasks)

    def read(self, batch: Batch) -> Any:
        """Return what :meth:`sample` drew, given the tensors [T, ...] of a batch by name."""
        return self.sampled_type(*(batch[name] for name in self.sampled_type._fields))

    def query(self, prediction: Any, truth: Truth) -> Any:
        """Return what is judged of completed answers: themselves, or values of functions where the truth is known."""
        return prediction

    @abstractmethod
    def errors(self, prediction: Any, seen: Seen, truth: Truth) -> dict[str, Tensor]:
        """Measure errors [T], by name; `error` is the one of tables.

        Args:
            prediction: predictions of fits, which :meth:`query` returns, or of baselines.
            seen: what fits see of the tasks.
            truth: the truth of the tasks.
        """

    def outer_loss(self, answer: Any, seen: Seen, truth: Any) -> Tensor:
        """Compute the outer loss of each fit, [T]; judges that train by the sight have none.

        Args:
            answer: what `Decoder.decode_for_training` returns.
            seen: what the fits saw.
            truth: what :meth:`sample` drew.
        """
        raise NotImplementedError


class Encoder(ABC, Generic[Seen]):
    """The encoder of General: a function from what is seen to parameters, in one forward pass.

    Attributes:
        samples: how many random samples of what a fit sees the encoder reads; None for all that a fit sees.
    """

    samples: ClassVar[int | None] = None

    def recorded_conditions(self, device: torch.device | None = None) -> dict[str, str]:
        """Return the conditions that errors depend on, by name; see :meth:`App.recorded_conditions`."""
        return {}

    @abstractmethod
    def init(self, rng: Generator, decoder: Any) -> Params:
        """Draw random parameters of the encoder."""

    @abstractmethod
    def select_input(self, seen: Seen) -> Batch:
        """Select the encoder's input of what is seen, by name; tensors are [T, ...]."""

    @abstractmethod
    def __call__(self, encoder: Params, encoder_input: Batch, decoder: Any) -> Params:
        """Predict parameters [T, ...].

        Args:
            encoder: the parameters of the encoder.
            encoder_input: the input [T, ...] from :meth:`select_input`.
            decoder: the decoder of the application, which the parameters are for.
        """


@dataclass(frozen=True)
class ComposedApp(App):
    """An application that fulfils the contract by asking its components.

    A subclass states the name, the error measure and the tensors of tasks, and how tasks are augmented.

    Attributes:
        decoder: the meaning of parameters.
        sight: what a fit sees.
        judge: the truth, and how answers are judged by it.
        encoder: General's encoder.
    """

    decoder: Decoder[Any, Any]
    sight: Sight[Any, Any]
    judge: Judge[Any, Any, Any]
    encoder: Encoder[Any]

    @property
    @override
    def observes(self) -> str:
        return self.sight.observes

    @property
    @override
    def is_periodic(self) -> bool:
        return self.decoder.is_periodic

    @property
    @override
    def linear_parameter(self) -> str:
        return self.decoder.linear_parameter

    @property
    @override
    def encoder_settings(self) -> tuple[object, ...]:
        # sights may differ: applications share one General, whose outer loss is the judge's
        return self.decoder, self.encoder, self.judge

    @override
    def recorded_conditions(self, device: torch.device | None = None) -> dict[str, str]:
        return self.encoder.recorded_conditions(device)

    @override
    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Prepare what a fit sees and, if the task has one, the truth, by the names of their fields."""
        seen = name_tensors(self.sight.prepare(task, self.decoder))
        truth = self.judge.prepare(task, self.decoder)
        return seen if truth is None else seen | name_tensors(truth)

    @override
    def init(self, rng: Generator, count: int) -> Params:
        return self.decoder.init(rng, count)

    @override
    def task_parameters(self, tasks: Tasks) -> Params:
        return self.sight.task_parameters(tasks, self.decoder)

    @property
    @override
    def task_parameter_specs(self) -> Mapping[str, TensorSpec]:
        return self.sight.task_parameter_specs

    @override
    def coarsen(self, tasks: Tasks, done: float) -> Tasks:
        return self.sight.coarsen(tasks, done)

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        return name_tensors(self.sight.sample(tasks, rng, count))

    @override
    def loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        seen = self.sight.read(batch)
        return self.sight.loss(self.decoder.decode_for_steps(theta, seen), seen, loss_parameters)

    @override
    def initial_loss_parameters(self, steps: int) -> Params:
        return self.sight.initial_loss_parameters(steps)

    @override
    def least_squares(self, theta: Params, batch: Batch, loss_parameters: Params) -> LeastSquares:
        return self.sight.least_squares(self.decoder, theta, self.sight.read(batch), loss_parameters)

    @property
    @override
    def has_outer_loss(self) -> bool:
        return not self.judge.trains_by_sight

    @override
    def outer_sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Draw what the judge compares. Unless the judge trains by the sight, draw what a step of a fit sees, too."""
        drawn = name_tensors(self.judge.sample(tasks, rng, count))
        return drawn if self.judge.trains_by_sight else self.sample(tasks, rng, count) | drawn

    @override
    def outer_loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        if self.judge.trains_by_sight:
            return self.loss(theta, batch, loss_parameters)
        seen = self.sight.read(batch)
        truth = self.judge.read(batch)
        return self.judge.outer_loss(self.decoder.decode_for_training(theta, seen), seen, truth)

    @override
    def init_encoder(self, rng: Generator) -> Params:
        return self.encoder.init(rng, self.decoder)

    @override
    def encoder_input(self, tasks: Tasks, rng: Generator) -> Batch:
        count = self.encoder.samples
        seen = self.sight.gather(tasks) if count is None else self.sight.sample(tasks, rng, count)
        return self.encoder.select_input(seen)

    @override
    def encode(self, encoder: Params, encoder_input: Batch) -> Params:
        return self.encoder(encoder, encoder_input, self.decoder)

    @override
    def postprocess(self, theta: Params, tasks: Tasks | None = None) -> Params:
        return self.decoder.postprocess(theta)

    def prediction(self, theta: Params, seen: Any) -> Any:
        """Return what is shown and judged of fits [T, ...]; see :meth:`Sight.complete`.

        Args:
            theta: fits [T, ...].
            seen: what the fits saw, from :meth:`Sight.gather`.
        """
        return self.sight.complete(self.decoder(theta, seen), seen)

    @override
    @torch.no_grad()
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        truth = self.judge.gather(tasks)
        if truth is None:
            return {}
        return self.errors_of(self.judge.query(self.prediction(theta, self.sight.gather(tasks)), truth), tasks)

    def errors_of(self, prediction: Any, tasks: Tasks) -> dict[str, Tensor]:
        """Measure predictions of fits or baselines, see :meth:`Judge.errors`; {} if the tasks have no truth."""
        truth = self.judge.gather(tasks)
        return {} if truth is None else self.judge.errors(prediction, self.sight.gather(tasks), truth)
