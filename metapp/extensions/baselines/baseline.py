"""The contract of baselines: prepared once on training tasks, then fitted to one task at a time."""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, cast

from torch import Generator, Tensor

from metapp.learning.app import App, stack_tasks
from metapp.learning.task import Task, Tasks

INDEX_NUMBERS_AND_BYTES = 1, 4  # the number of a training task, and its bytes


@dataclass(frozen=True, eq=False)
class TrainingTasks:
    """The training tasks that baselines are prepared on.

    Attributes:
        app: the application.
        tasks: of the data set, in its order.
    """

    app: App
    tasks: Sequence[Task]

    @functools.cached_property
    def stacked(self) -> Tasks:
        """All of them, prepared by the application."""
        return stack_tasks(self.app, self.tasks)


class CostLimits(NamedTuple):
    """The samples and bytes of a baseline, so that it is compared at equal cost.

    Attributes:
        samples: that it may draw, as many as Meta's steps do.
        network_bytes: bytes of a task's network.
    """

    samples: int
    network_bytes: int


class BaselineFit(NamedTuple):
    """A baseline's fit of a task.

    Attributes:
        answer: makes the argument of `judge_answer`; not timed, as that of a network is not.
        numbers: that are kept for the task.
        kept_bytes: their bytes.
        picture: to show beside the application's fits, linear RGB [H, W, 3], if it is a picture.
        written: makes the argument of `Presenter.answer_pictures` where files differ from what is judged, of a height
            and width in px, None for the size that is judged; not timed.
    """

    answer: Callable[[], object]
    numbers: int
    kept_bytes: int
    picture: Tensor | None = None
    written: Callable[[tuple[int, int] | None], object] | None = None


class Baseline(ABC):
    """A method that a reader would use instead of a network.

    Attributes:
        name: as rows call it.
        title: its name in words, with its source.
        cannot: an ability of networks that it lacks.
        learns: whether it is prepared on training tasks.
        stored: the tensor of tasks that holds its answers, which were made elsewhere: it has no time; "" for none.
        shared: bytes that all tasks share, without which no fit can be evaluated or made; None if not known.
        sizes: whether its files can have a size that the user asks for (`--size`).
        chosen: settings that validation tasks have chosen.
    """

    name: str
    title: str
    cannot: str
    learns = False
    stored = ""
    shared: int | None = 0
    sizes = False

    def __init__(self, app: App) -> None:
        self.app = app
        self.chosen: dict[str, object] = {}

    def prepare(self, training: TrainingTasks, allowed: CostLimits) -> None:  # noqa: B027  (nothing to do for most)
        """Learn from training tasks, once: of methods that do."""

    @abstractmethod
    def fit(self, tasks: Tasks, rng: Generator, allowed: CostLimits) -> BaselineFit:
        """The fit of one task."""


class JudgingApp(Protocol):
    """An application that judges baselines: its `errors` measures an answer that it makes of a fit by `errors_of`."""

    def errors_of(self, answer: Any, tasks: Tasks) -> dict[str, Tensor]:
        """Return the measures [T] of `App.errors` of an answer: the application's own maps, pictures or densities."""


def judge_answer(app: App, answer: object, tasks: Tasks) -> dict[str, Tensor]:
    """Measure an answer that does not come from the application's network, by the measures [T] of fits."""
    return cast(JudgingApp, app).errors_of(answer, tasks)


def tensor_bytes(*tensors: Tensor) -> int:
    """Bytes of tensors."""
    return sum(tensor.numel() * tensor.element_size() for tensor in tensors)
