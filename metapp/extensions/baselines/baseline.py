"""The record of a baseline: prepared once on training tasks, then fitted to one task at a time."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from torch import Generator, Tensor

from metapp.learning.app import App, stack
from metapp.learning.task import Task, Tasks

INDEX = 1, 4  # the number of a training task, and its bytes


@dataclass(frozen=True, eq=False)
class Training:
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
        return stack(self.app, self.tasks)


class Allowed(NamedTuple):
    """The samples and bytes of a baseline, so that it is compared at equal cost.

    Attributes:
        samples: that it may draw, as many as Meta's steps do.
        size: bytes of a task's network.
    """

    samples: int
    size: int


class BaselineFit(NamedTuple):
    """A baseline's fit of a task.

    Attributes:
        answer: makes what `App.errors_of` judges; not timed, as that of a network is not.
        numbers: that are kept for the task.
        size: their bytes.
        picture: what it looks like beside the application's fits, linear RGB [H, W, 3], where it is a picture.
    """

    answer: Callable[[], object]
    numbers: int
    size: int
    picture: Tensor | None = None


FitTask = Callable[[Tasks, Generator, Allowed], BaselineFit]  # of one task


class PreparedBaseline(NamedTuple):
    """A baseline at work.

    Attributes:
        fit: fits one task.
        shared: bytes that all tasks share, without which no fit can be evaluated or made; None where not known.
        chosen: what validation tasks have chosen.
    """

    fit: FitTask
    shared: int | None = 0
    chosen: dict[str, object] = {}  # noqa: RUF012  (never written to)


class Baseline(NamedTuple):
    """A method that a reader would use instead.

    Attributes:
        name: as rows call it.
        title: what it is, with its source.
        cannot: what it cannot do that a network can.
        prepare: (training tasks, what fits may use) -> the baseline at work.
        learns: whether it needs any.
        stored: the tensor of tasks that holds its answers, which were made elsewhere: it has no time; "" for none.
    """

    name: str
    title: str
    cannot: str
    prepare: Callable[[Training, Allowed], PreparedBaseline]
    learns: bool = True
    stored: str = ""


def bytes_of(*tensors: Tensor) -> int:
    """Bytes of tensors."""
    return sum(tensor.numel() * tensor.element_size() for tensor in tensors)
