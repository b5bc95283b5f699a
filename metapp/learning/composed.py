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
from metapp.learning.task import Batch, LeastSquares, Params, Task, Tasks, TensorSpec

Answer = TypeVar("Answer")
Seen = TypeVar("Seen")
Truth = TypeVar("Truth")


class Decoder(ABC, Generic[Answer, Seen]):
    """What the parameters of a fit mean: from parameters to an answer, such as maps of a material."""

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
            seen: what the fits saw, [T, ...], of which an answer may depend, too: I in the paper.
        """

    def decode_for_steps(self, theta: Params, seen: Seen) -> Answer:
        """Return the answer of each task with gradients in those parameters alone that steps of fits change."""
        return self(theta, seen)

    def decode_for_training(self, theta: Params, seen: Seen) -> Answer:
        """Return the answer of each task that outer losses judge; the answer itself, where nothing else is said."""
        return self(theta, seen)

    def postprocess(self, theta: Params) -> Params:
        """Change fits [T, ...] after their last step, before they are evaluated and stored; here not at all."""
        return theta


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

    def seen_type_of(self, tensors: Mapping[str, Tensor]) -> type[Any]:
        """Return the named tuple of what is seen in tensors by name: augmented tasks may show something else."""
        return self.seen_type

    def gather(self, tasks: Tasks) -> Seen:
        """Return what fits see of tasks, [T, ...], as :meth:`prepare` prepared it."""
        seen_type = self.seen_type_of(tasks.data)
        seen: Seen = seen_type(**tasks.gather(seen_type._fields))
        return seen

    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Seen:
        """Draw `count` random samples of what fits see of each task, [T, ...]; here all of it, whatever the count."""
        return self.gather(tasks)

    def read(self, batch: Batch) -> Seen:
        """Return what :meth:`sample` drew, out of the tensors [T, ...] of a batch by name."""
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
        """Return initial values [steps, ...] of the loss parameters that a rule may learn, by name."""
        return {}

    def least_squares(self, decoder: Any, theta: Params, seen: Seen, loss_parameters: Params) -> LeastSquares:
        """Return least squares near the inner loss in the decoder's `linear_parameter`; see :meth:`loss`.

        It is called only for decoders that have one.
        """
        raise NotImplementedError

    def find_parameters(self, tasks: Tasks, decoder: Any) -> Params:
        """Return parameters [T, ...] of the decoder that follow from what is seen in closed form, without any step."""
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
        sampled_type: the named tuple that :meth:`sample` returns.
        draws_samples: whether :meth:`sample` draws held-out samples in the form of what fits see. The outer loss is
            then the inner loss of these, and judges get None in place of what fits saw.
    """

    truth_type: ClassVar[type[Any]]
    sampled_type: ClassVar[type[Any]]
    draws_samples: ClassVar[bool] = False

    @abstractmethod
    def prepare(self, task: Task, decoder: Any) -> Truth | None:
        """Prepare the truth of one task, without a task axis; None if the task has none."""

    def gather(self, tasks: Tasks) -> Truth | None:
        """Return the truth of tasks, [T, ...], as :meth:`prepare` prepared it; None if not all tasks have it."""
        names = self.truth_type._fields
        return self.truth_type(**tasks.gather(names)) if tasks.data.keys() >= set(names) else None

    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Any:
        """Draw what an outer loss compares, [T, ...]; here all of the truth, or None if tasks have none."""
        return self.gather(tasks)

    def query(self, answer: Any, truth: Truth) -> Any:
        """Return what is judged of a completed answer: the answer itself, or its values where the truth is known."""
        return answer

    @abstractmethod
    def errors(self, prediction: Any, seen: Seen, truth: Truth) -> dict[str, Tensor]:
        """Measure errors [T], by name; `error` is the one of tables.

        Args:
            prediction: predictions of fits, which :meth:`query` returns, or of baselines.
            seen: what fits see of the tasks.
            truth: the truth of the tasks.
        """

    def outer_loss(self, answer: Answer, seen: Seen, truth: Any) -> Tensor:
        """Compute the outer loss of each fit, [T]; judges that draw samples need none.

        Args:
            answer: the answers of the decoder.
            seen: what the fits saw.
            truth: what :meth:`sample` drew; None if the training tasks have no truth.
        """
        raise NotImplementedError


class Encoder(ABC, Generic[Seen]):
    """The encoder of General: from what is seen to parameters, in one forward pass.

    Attributes:
        samples: how many samples of what a fit sees the encoder reads, if the sight draws samples.
    """

    samples: ClassVar[int] = 0

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
    def linear_parameter(self) -> str:
        name: str = self.decoder.linear_parameter
        return name

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
        return self.sight.gather(tasks)

    def find_truth(self, tasks: Tasks) -> Any | None:
        """Return the truth of tasks, as the judge prepared it, [T, ...]; None if not all tasks have it."""
        return self.judge.gather(tasks)

    @override
    def recorded_conditions(self, device: torch.device | None = None) -> dict[str, str]:
        conditions: dict[str, str] = self.encoder.recorded_conditions(device)
        return conditions

    @override
    def postprocess(self, theta: Params) -> Params:
        kept: Params = self.decoder.postprocess(theta)
        return kept

    @override
    def init(self, rng: Generator, count: int) -> Params:
        theta: Params = self.decoder.init(rng, count)
        return theta

    @override
    def task_parameters(self, tasks: Tasks) -> Params:
        parameters: Params = self.sight.find_parameters(tasks, self.decoder)
        return parameters

    @property
    @override
    def task_parameter_specs(self) -> Mapping[str, TensorSpec]:
        specs: Mapping[str, TensorSpec] = self.sight.found_parameter_specs
        return specs

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        batch: Batch = self.sight.sample(tasks, rng, count)._asdict()
        return batch

    @override
    def loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        seen = self.sight.read(batch)
        loss: Tensor = self.sight.loss(self.decoder.decode_for_steps(theta, seen), seen, loss_parameters)
        return loss

    @override
    def least_squares(self, theta: Params, batch: Batch, loss_parameters: Params) -> LeastSquares:
        squares: LeastSquares = self.sight.least_squares(self.decoder, theta, self.sight.read(batch), loss_parameters)
        return squares

    @override
    def initial_loss_parameters(self, steps: int) -> Params:
        parameters: Params = self.sight.initial_loss_parameters(steps)
        return parameters

    @property
    @override
    def has_outer_loss(self) -> bool:
        return not self.judge.draws_samples

    @override
    def outer_sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Draw what fits see, and what the judge compares with the truth; or held-out samples alone."""
        truth = self.judge.sample(tasks, rng, count)
        drawn: Batch = {} if truth is None else truth._asdict()
        return drawn if self.judge.draws_samples else self.sample(tasks, rng, count) | drawn

    @override
    def outer_loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        if not self.has_outer_loss:
            return self.loss(theta, batch, loss_parameters)
        seen = self.sight.read(batch)
        names = self.judge.sampled_type._fields
        truth = self.judge.sampled_type(*(batch[name] for name in names)) if batch.keys() >= set(names) else None
        loss: Tensor = self.judge.outer_loss(self.decoder.decode_for_training(theta, seen), seen, truth)
        return loss

    @override
    def init_encoder(self, rng: Generator) -> Params:
        encoder: Params = self.encoder.init(rng, self.decoder)
        return encoder

    @override
    def encoder_input(self, tasks: Tasks, rng: Generator) -> Batch:
        batch: Batch = self.encoder.select_input(self.sight.sample(tasks, rng, self.encoder.samples))
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
        truth = self.find_truth(tasks)
        if truth is None:
            return {}
        seen = None if self.judge.draws_samples else self.see(tasks)
        errors: dict[str, Tensor] = self.judge.errors(
            self.judge.query(self.prediction(theta, seen), truth), seen, truth
        )
        return errors

    def errors_of(self, prediction: Any, tasks: Tasks) -> dict[str, Tensor]:
        """Measure how far predictions of fits or baselines are from the truth; {} if the tasks have none."""
        truth = self.find_truth(tasks)
        if truth is None:
            return {}
        errors: dict[str, Tensor] = self.judge.errors(
            prediction, None if self.judge.draws_samples else self.see(tasks), truth
        )
        return errors
