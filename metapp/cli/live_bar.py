"""The progress bar of a terminal, drawn by rich: a row with the share that is done, the time left and the speed.

:mod:`metapp.cli.progress` imports this module where a bar is drawn, since rich's bars take a while to import.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeRemainingColumn,
)
from rich.text import Text
from typing_extensions import override

from metapp.runs.reporter import Bar

MIN_ESTIMATE_SHARE = 0.1  # share of a job that must be done before the time left is shown
SPEED_WINDOW_SECONDS = 3600.0  # s over which the speed is averaged for this estimate
BAR_CHARACTERS = 24  # width of the bar


class SpeedColumn(ProgressColumn):
    """The number of parts that are done in a second."""

    @override
    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:.1f}/s" if task.speed else "")


class RemainingColumn(TimeRemainingColumn):
    """The time left, as soon as MIN_ESTIMATE_SHARE of the job is done."""

    @override
    def render(self, task: Task) -> Text:
        is_known = task.total and task.completed >= MIN_ESTIMATE_SHARE * task.total
        return super().render(task) if is_known else Text("")


class LiveBar(Bar):
    """A row of a progress bar that is drawn anew in place.

    Args:
        bars: the bars that the row is drawn among.
        title: the name of the job.
        total: the number of its parts, if known.
        done: the number of parts that are done already.
    """

    def __init__(self, bars: Progress, title: str, total: int | None, done: int) -> None:
        self.bars, self.done = bars, done
        self.row = bars.add_task(title, total=total, completed=done, note="")

    @override
    def advance(self, note: str = "") -> None:
        self.done += 1
        self.bars.update(self.row, completed=self.done, note=note)

    @override
    def set_label(self, note: str, share: float = 0.0) -> None:
        self.bars.update(self.row, completed=self.done + share, note=note)

    @override
    def set_done(self, done: int, total: int | None, note: str = "") -> None:
        self.done = done
        self.bars.update(self.row, completed=done, total=total, note=note)


@contextlib.contextmanager
def draw_live_bar(console: Console, title: str, total: int | None, done: int) -> Iterator[LiveBar]:
    """Draw a progress bar on a terminal, which disappears at the end of the `with` block.

    Args:
        console: the console of the terminal.
        title: the name of the job.
        total: the number of its parts, if known.
        done: the number of parts that are done already.
    """
    columns: tuple[ProgressColumn, ...] = (
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=BAR_CHARACTERS),
        MofNCompleteColumn(),
        RemainingColumn(),
        SpeedColumn(),
        TextColumn("{task.fields[note]}", markup=False),
    )
    with Progress(*columns, console=console, transient=True, speed_estimate_period=SPEED_WINDOW_SECONDS) as bars:
        yield LiveBar(bars, title, total, done)
