"""The four components of an application: a decoder, a sight, a judge and an encoder.

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
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import torch
from torch import Generator, Tensor

from metapp.learning.task import Batch, LeastSquares, Params, Task, Tasks, TensorSpec

Answer = TypeVar("Answer")
Seen = TypeVar("Seen")
Truth = TypeVar("Truth")


def name_tensors(tensors: Any) -> Batch:
    """Return tensors by name: the fields of a named tuple, or a dictionary, for components whose number varies."""
    batch: Batch = tensors if isinstance(tensors, dict) else tensors._asdict()
    return batch


class VisibleData(NamedTuple):
    """The amount of a task's data that a fit may see.

    Attributes:
        sample_count: number of samples that a fit draws from; 1 if each step sees all there is.
        sample_bytes: size of one sample as data sets keep it, in bytes.
        encoder_samples: number of these samples that General's encoder reads.
    """

    sample_count: int
    sample_bytes: int
    encoder_samples: int


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
        """Return tasks as a descent sees them; see :meth:`metapp.learning.app.App.coarsen`. The default keeps them."""
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

    def describe_visible(self, task: Task) -> VisibleData | None:
        """Return how much of a task a fit may see. The default, not known, is None."""
        return None

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

    def reference(self, task: Task) -> Any:
        """Return the truth of a task for people, an asset of the kind of fits. The default, not known, is None."""
        return None

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
        """Return conditions that errors depend on; see :meth:`metapp.learning.app.App.recorded_conditions`."""
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
