"""The contract of baselines: prepared once on training tasks, then fitted to one task at a time.

Applications offer baselines by this contract, so that the command and the table know nothing of their methods.
"""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from torch import Generator, Tensor

from metapp.appearance.assets import Asset
from metapp.learning.app import App, stack_tasks
from metapp.learning.task import Task, Tasks

INDEX_NUMBERS_AND_BYTES = 1, 4  # a prediction that is the index of a training task: one number of four bytes


@dataclass(frozen=True, eq=False)
class TrainingTasks:
    """The training tasks that baselines are prepared on.

    Attributes:
        app: the application of the tasks.
        tasks: the training tasks of a data set, in its order.
    """

    app: App
    tasks: Sequence[Task]

    @functools.cached_property
    def prepared_tasks(self) -> Tasks:
        """All training tasks, prepared by the application and stacked."""
        return stack_tasks(self.app, self.tasks)


class CostLimits(NamedTuple):
    """The numbers of samples and bytes that a baseline may use, so that methods are compared at equal cost.

    Attributes:
        samples: the number of samples that a fit may draw, as many as Meta's steps do.
        network_bytes: the number of bytes of a task's network.
    """

    samples: int
    network_bytes: int


class BaselineFit(NamedTuple):
    """A baseline's fit of one task.

    Attributes:
        prediction: a function that makes the prediction that :meth:`metapp.learning.app.App.errors_of` takes; it is not
            timed, as the evaluation of a network is not timed either.
        kept_numbers: how many numbers are kept for the task.
        kept_bytes: how many bytes these numbers take.
        asset: a function that makes the asset of the task for people, at a height and width in px, or None for the
            usual size of its files; it is not timed. None for a prediction at some places that is nothing in between.
        picture: a picture as large as the ones of fits, to show beside them, linear RGB [H, W, 3]; None for no picture.
    """

    prediction: Callable[[], object]
    kept_numbers: int
    kept_bytes: int
    asset: Callable[[Task, tuple[int, int] | None], Asset] | None = None
    picture: Tensor | None = None


class Baseline(ABC):
    """A method that a reader would use instead of a network; a subclass defines `name`, `title`, `cannot` and `fit`.

    Args:
        app: the application's network and sizes, at the recipe of the fits.

    Attributes:
        app: the application.
        name: the name by which the option `--method` and the rows of tables call the method.
        title: the method in words, with its source.
        cannot: an ability of networks that the method lacks, as words that follow "cannot".
        learns: whether the method is prepared on training tasks.
        stored_tensor: the name of the task's tensor that holds the predictions of a method that was run elsewhere, and
            so has no time; "" for methods that make their predictions.
        shared_bytes: how many bytes all tasks share, without which no fit can be made or evaluated; None if that is not
            known.
        is_resizable: whether files can have a size that the user asks for (`--size`).
        chosen: the settings that were chosen on validation tasks.
    """

    name: str
    title: str
    cannot: str
    learns = False
    stored_tensor = ""
    shared_bytes: int | None = 0
    is_resizable = False

    def __init__(self, app: App) -> None:
        self.app = app
        self.chosen: dict[str, object] = {}

    def prepare(self, training: TrainingTasks, allowed: CostLimits) -> None:  # noqa: B027  (nothing to do for most)
        """Learn from training tasks, once; methods that learn nothing do nothing."""

    @abstractmethod
    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        """Fit the one selected task.

        Args:
            tasks: prepared tasks, of which one is selected.
            rng: the generator of all random draws.
            allowed: how many samples and bytes the fit may use.
        """


def tensor_bytes(*tensors: Tensor) -> int:
    """Return the number of bytes that tensors take."""
    return sum(tensor.numel() * tensor.element_size() for tensor in tensors)
