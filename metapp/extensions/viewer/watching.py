"""Watch fits: a page that follows them while they run."""

from __future__ import annotations

import time
from collections.abc import Iterator

import torch

from metapp.apps import presentation_of
from metapp.extensions.viewer.live import Live
from metapp.extensions.viewer.page import Group, Shown, document
from metapp.extensions.viewer.view import view_of
from metapp.learning.app import App
from metapp.learning.deadline import Stopwatch
from metapp.learning.learn import Step
from metapp.learning.task import Params, Task
from metapp.runs.requests.naming import title_of
from metapp.storage import Document

EVERY = 0.25  # seconds between two drawings at least, and as long as one takes


class Watched:
    """The page of the task that is being fitted, after so many steps.

    Attributes:
        live: serves it.
        lines: what to say before the first fit.
    """

    def __init__(self, app: App, paradigm: str) -> None:
        self.app, self.paradigm, self.live = app, paradigm, Live()
        self.lines = [
            f"watch: {self.live.address} shows the fits in a browser of this machine, until they are over; the time "
            "that it takes to draw is not part of the seconds"
        ]
        self._next = 0.0  # on the clock of time.monotonic
        self._last: tuple[Task, Params, str] | None = None  # what was not drawn, as it came too soon
        self._curve: list[tuple[int, float]] = []
        self._told: tuple[Document, str] | None = None

    def follow(self, descent: Iterator[Step], task: Task, steps: int, clock: Stopwatch) -> Iterator[Step]:
        """The descent of a fit of this task, first of several, as it is drawn; drawing pauses the clock."""
        self._curve = []
        for now in descent:
            with clock.paused():
                if now.loss is not None:
                    self._curve.append((now.step, float(now.loss[0])))
                self.show(task, now.theta, f"step {now.step} of {steps}")
            yield now

    def show(self, task: Task, theta: Params, when: str) -> None:
        """Draw the first of parameters [T, ...], unless the last drawing is too young."""
        self._last = (task, theta, when)
        if time.monotonic() >= self._next:
            self.draw()

    @torch.no_grad()
    def draw(self) -> None:
        """Draw what was shown last, if it is not on the page yet."""
        if self._last is None:
            return
        (task, theta, when), begin = self._last, time.monotonic()
        first = {key: value[0].detach().cpu() for key, value in theta.items()}
        title = title_of(self.app)
        shown = Shown(self.paradigm, when, view_of(presentation_of(self.app), first, task, quick=True))
        self._told = document(f"{title}, {self.paradigm}", [Group(task.name, title, [shown])]), when
        self.live.tell(*self._told, self._curve)
        self._last, now = None, time.monotonic()
        self._next = now + max(EVERY, now - begin)

    def close(self) -> None:
        """Close the page."""
        self.live.close()

    def finish(self) -> None:
        """Draw what was not drawn yet; tell the page that it was the last."""
        self.draw()
        if self._told:
            page, when = self._told
            self.live.tell(page, f"{when}; the fit is over", self._curve, done=True)
