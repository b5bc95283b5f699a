"""An application made of four components: a decoder, a sight, a judge and an encoder.

They answer four questions of the paper's L_theta(x | I): what parameters theta mean (the decoder), which observations I
a fit sees and how far an answer is from them (the sight), how an answer differs from the truth that fits never see (the
judge), and how General predicts parameters (the encoder). Each can be exchanged by itself: fits of an environment map
and fits of a photographed ball differ in their sights alone.

What a sight and a judge prepare of a task are named tuples of tensors without a task axis; tasks that are fitted
together stack them, so that all other methods find them with a leading task axis T.
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
from metapp.learning.task import Batch, Params, Task, Tasks, TensorSpec

Answer = TypeVar("Answer")
Seen = TypeVar("Seen")
Truth = TypeVar("Truth")


class Decoder(ABC, Generic[Answer, Seen]):
    """What the parameters of a fit mean: from parameters to an answer, such as maps of a material."""

    @property
    def is_periodic(self) -> bool:
        """Whether parameters on a grid continue at the opposite edge, which some update rules ask for."""
        return False

    @abstractmethod
    def init(self, rng: Generator, count: int) -> Params:
        """Draw random parameters for `count` tasks; each tensor is [count, ...]."""

    @abstractmethod
    def __call__(self, theta: Params, seen: Seen) -> Answer:
        """Return the answer of each task.

        Args:
            theta: parameters [T, ...].
            seen: what the fits saw, [T, ...], of which an answer may depend, too: I in the paper.
        """

    def decode_for_steps(self, theta: Params, seen: Seen) -> Answer:
        """Return the answer of each task with gradients in those parameters alone that steps of fits change."""
        return self(theta, seen)


class Sight(ABC, Generic[Answer, Seen]):
    """What a fit sees of a task, and the loss of an answer by it.

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
            decoder: the decoder of the application, whose sizes tensors follow.

        Raises:
            ValueError: the task lacks what a fit must see.
        """

    def sample(self, seen: Seen, rng: Generator, count: int) -> Seen:
        """Draw `count` random samples of what is seen, [T, ...]; here all of it, whatever the count."""
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
        """Return initial values [steps, ...] of the loss parameters that a rule may learn, by name."""
        return {}

    def find_parameters(self, seen: Seen) -> Params:
        """Return parameters [T, ...] that follow from what is seen in closed form, without any step."""
        return {}

    @property
    def found_parameter_specs(self) -> Mapping[str, TensorSpec]:
        """The forms of the parameters that :meth:`find_parameters` returns, by name, without a task axis."""
        return {}

    @abstractmethod
    def complete(self, answer: Answer, seen: Seen) -> Any:
        """Return the predictions that are judged and shown: answers, and what is seen better than it is fitted."""


class Judge(ABC, Generic[Answer, Seen, Truth]):
    """How far predictions are from the truth: errors of fits and of baselines, and the loss that training lowers.

    Attributes:
        truth_type: the named tuple that :meth:`prepare` returns.
    """

    truth_type: ClassVar[type[Any]]

    @abstractmethod
    def prepare(self, task: Task, decoder: Any) -> Truth | None:
        """Prepare the truth of one task, without a task axis; None if the task has none."""

    def sample(self, truth: Truth, rng: Generator) -> Truth:
        """Draw at random what an outer loss compares, [T, ...]; here all of the truth."""
        return truth

    @abstractmethod
    def errors(self, prediction: Any, truth: Truth) -> dict[str, Tensor]:
        """Measure errors [T], by name; `error` is the one of tables.

        Args:
            prediction: predictions of fits or baselines, which `Sight.complete` returns of answers.
            truth: the truth of the tasks.
        """

    @abstractmethod
    def outer_loss(self, answer: Answer, seen: Seen, truth: Truth) -> Tensor:
        """Compute the outer loss of each fit, [T], from its answer, what it saw, and the truth."""


class Encoder(ABC, Generic[Seen]):
    """The encoder of General: from what is seen to parameters, in one forward pass."""

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
    """An application that is put together: every method asks one of the components.

    A subclass states the name, the error measure and the tensors of tasks, and how tasks are augmented.

    Attributes:
        decoder: what parameters mean.
        sight: what a fit sees.
        judge: how answers are judged.
        encoder: how General predicts parameters.
    """

    decoder: Any
    sight: Any
    judge: Any
    encoder: Any

    @property
    @override
    def observes(self) -> str:
        """What fits see, a value of --observe, as the sight says."""
        observes: str = self.sight.observes
        return observes

    @property
    @override
    def is_periodic(self) -> bool:
        return bool(self.decoder.is_periodic)

    @property
    @override
    def encoder_settings(self) -> tuple[object, ...]:
        return self.decoder, self.encoder

    @override
    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Prepare what a fit sees and, if the task has one, the truth, by the names of their fields."""
        seen: dict[str, Tensor] = self.sight.prepare(task, self.decoder)._asdict()
        if seen.keys() >= set(self.judge.truth_type._fields):
            return seen  # a fit that sees the truth itself
        truth = self.judge.prepare(task, self.decoder)
        return seen if truth is None else seen | truth._asdict()

    def see(self, tasks: Tasks) -> Any:
        """Return what fits see of tasks, as the sight prepared it, [T, ...]."""
        return self._as_seen(tasks.gather(self.sight.seen_type._fields))

    def find_truth(self, tasks: Tasks) -> Any | None:
        """Return the truth of tasks, as the judge prepared it, [T, ...]; None if not all tasks have it."""
        names = self.judge.truth_type._fields
        return self.judge.truth_type(**tasks.gather(names)) if tasks.data.keys() >= set(names) else None

    def _as_seen(self, batch: Batch) -> Any:
        """Return those tensors [T, ...] of a batch that the sight sampled."""
        return self.sight.seen_type(*(batch[name] for name in self.sight.seen_type._fields))

    @override
    def init(self, rng: Generator, count: int) -> Params:
        theta: Params = self.decoder.init(rng, count)
        return theta

    @override
    def task_parameters(self, tasks: Tasks) -> Params:
        parameters: Params = self.sight.find_parameters(self.see(tasks))
        return parameters

    @property
    @override
    def task_parameter_specs(self) -> Mapping[str, TensorSpec]:
        specs: Mapping[str, TensorSpec] = self.sight.found_parameter_specs
        return specs

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        batch: Batch = self.sight.sample(self.see(tasks), rng, count)._asdict()
        return batch

    @override
    def loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        seen = self._as_seen(batch)
        loss: Tensor = self.sight.loss(self.decoder.decode_for_steps(theta, seen), seen, loss_parameters)
        return loss

    @override
    def initial_loss_parameters(self, steps: int) -> Params:
        parameters: Params = self.sight.initial_loss_parameters(steps)
        return parameters

    @override
    def outer_sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Add what the judge draws of the truth, which all training tasks have."""
        truth: Batch = self.judge.sample(self.find_truth(tasks), rng)._asdict()
        return self.sample(tasks, rng, count) | truth

    @override
    def outer_loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        seen = self._as_seen(batch)
        truth = self.judge.truth_type(*(batch[name] for name in self.judge.truth_type._fields))
        loss: Tensor = self.judge.outer_loss(self.decoder(theta, seen), seen, truth)
        return loss

    @override
    def init_encoder(self, rng: Generator) -> Params:
        encoder: Params = self.encoder.init(rng, self.decoder)
        return encoder

    @override
    def encoder_input(self, tasks: Tasks, rng: Generator) -> Batch:
        batch: Batch = self.encoder.select_input(self.see(tasks))
        return batch

    @override
    def encode(self, encoder: Params, encoder_input: Batch) -> Params:
        theta: Params = self.encoder(encoder, encoder_input, self.decoder)
        return theta

    def prediction(self, theta: Params, seen: Any) -> Any:
        """Return the predictions of fits [T, ...] that are judged and shown; see :meth:`Sight.complete`.

        Args:
            theta: fits [T, ...].
            seen: what the fits saw, from :meth:`see`.
        """
        return self.sight.complete(self.decoder(theta, seen), seen)

    @override
    @torch.no_grad()
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        return self.errors_of(self.prediction(theta, self.see(tasks)), tasks)

    def errors_of(self, prediction: Any, tasks: Tasks) -> dict[str, Tensor]:
        """Measure how far predictions of fits or baselines are from the truth; {} if the tasks have none."""
        truth = self.find_truth(tasks)
        errors: dict[str, Tensor] = {} if truth is None else self.judge.errors(prediction, truth)
        return errors
