"""Watch fits: one picture that is rewritten as steps go by."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import torch

from metapp.apps import presentation_of
from metapp.learning.app import App
from metapp.learning.deadline import Stopwatch
from metapp.learning.learn import Step
from metapp.learning.task import Params, Task
from metapp.runs.naming import title_of
from metapp.runs.pictures import Column, to_srgb, write_sheet

EVERY = 0.25  # seconds between two pictures at least, and as long as one takes to draw
SIDE = 300  # px


class Watched:
    """A picture of the task that is being fitted: what it should show beside what it shows after so many steps.

    Attributes:
        file: a PNG, written to a temporary name and renamed.
    """

    def __init__(self, app: App, paradigm: str, file: Path) -> None:
        self.app, self.paradigm, self.file = app, paradigm, file
        self._next = 0.0  # on the clock of time.monotonic
        self._last: tuple[Task, Params, str] | None = None  # what was not drawn, as it came too soon

    def shown(self, descent: Iterator[Step], task: Task, steps: int, clock: Stopwatch) -> Iterator[Step]:
        """The descent of a fit of this task, first of several, as it is drawn; drawing pauses the clock."""
        for now in descent:
            with clock.paused():
                self.show(task, now.theta, f"step {now.step} of {steps}")
            yield now

    def show(self, task: Task, theta: Params, when: str) -> None:
        """Draw the first of parameters [T, ...], unless the last picture is too young."""
        self._last = (task, theta, when)
        if time.monotonic() >= self._next:
            self.finish()

    @torch.no_grad()
    def finish(self) -> None:
        """Draw what was shown last, if it is not on the picture yet."""
        if self._last is None:
            return
        (task, theta, when), begin = self._last, time.monotonic()
        first = {key: value[0].detach().cpu() for key, value in theta.items()}
        pictures = presentation_of(self.app).outputs(first, task)
        column = Column({name: to_srgb(picture) for name, picture in pictures.items()}, task.name)
        write_sheet([column], f"{title_of(self.app)}, {self.paradigm}: {when}", self.file, SIDE)
        self._last, now = None, time.monotonic()
        self._next = now + max(EVERY, now - begin)
