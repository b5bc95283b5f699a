"""Watch fits: one picture that is rewritten as steps go by, and a page that follows."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import torch

from metapp.appearance.colour import to_srgb
from metapp.appearance.presentation import view_of
from metapp.apps import presentation_of
from metapp.learning.app import App
from metapp.learning.deadline import Stopwatch
from metapp.learning.learn import Step
from metapp.learning.task import Params, Task
from metapp.runs.naming import title_of
from metapp.runs.pictures import Column, write_sheet
from metapp.storage import Document
from metapp.viewer.live import Live
from metapp.viewer.page import Group, Shown, document

EVERY = 0.25  # seconds between two pictures at least, and as long as one takes to draw
SIDE = 300  # px


class Watched:
    """A picture of the task that is being fitted: what it should show beside what it shows after so many steps.

    Attributes:
        file: a PNG, written to a temporary name and renamed.
        live: the page of the same, where it is served.
    """

    def __init__(self, app: App, paradigm: str, folder: Path, quiet: bool = False) -> None:
        self.app, self.paradigm, self.file = app, paradigm, folder / "watch.png"
        self.live = None if quiet else Live()
        self.lines = (
            []
            if self.live is None
            else [
                f"watch: {self.file}; the time that it takes to draw is not part of the seconds",
                f"watch: {self.live.address} shows the same in a browser of this machine, until the fits are over",
            ]
        )
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
        """Draw the first of parameters [T, ...], unless the last picture is too young."""
        self._last = (task, theta, when)
        if time.monotonic() >= self._next:
            self.draw()

    @torch.no_grad()
    def draw(self) -> None:
        """Draw what was shown last, if it is not on the picture yet."""
        if self._last is None:
            return
        (task, theta, when), begin = self._last, time.monotonic()
        first = {key: value[0].detach().cpu() for key, value in theta.items()}
        presentation = presentation_of(self.app)
        pictures = presentation.outputs(first, task)
        column = Column({name: to_srgb(picture) for name, picture in pictures.items()}, task.name)
        title = f"{title_of(self.app)}, {self.paradigm}"
        write_sheet([column], f"{title}: {when}", self.file, SIDE)
        if self.live:
            shown = Shown(self.paradigm, when, view_of(presentation, first, task, quick=True))
            self._told = document(title, [Group(task.name, title, [shown])]), when
            self.live.tell(*self._told, self._curve)
        self._last, now = None, time.monotonic()
        self._next = now + max(EVERY, now - begin)

    def close(self) -> None:
        """Close the page."""
        if self.live:
            self.live.close()

    def finish(self) -> None:
        """Draw what was not drawn yet; tell the page that it was the last."""
        self.draw()
        if self.live and self._told:
            page, when = self._told
            self.live.tell(page, f"{when}; the fit is over", self._curve, done=True)
