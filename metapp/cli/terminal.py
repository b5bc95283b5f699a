"""Messages and progress bars on standard error."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from metapp.cli.streams import leave, one_line
from metapp.runs.reporter import Bar, Clock, Reporter, duration


def plain_console(*, stderr: bool = False, width: int | None = None) -> Console:
    """A console that prints text as it is: names of files and tasks may look like markup or emoji codes."""
    return Console(stderr=stderr, width=width, highlight=False, markup=False, emoji=False)


class _Speed(ProgressColumn):
    """Steps a second."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:.1f}/s" if task.speed else "")


class _Bar(Bar):
    """A row of a progress bar; where there is no terminal, a line now and then."""

    def __init__(self, shown: Progress, lines: _Lines | None, title: str, total: int | None, done: int) -> None:
        self.shown, self.lines, self.title = shown, lines, title
        self.row = shown.add_task(title, total=total, completed=done, note="")

    def advance(self, note: str = "") -> None:
        self.shown.update(self.row, advance=1, note=note)

    def name(self, note: str) -> None:
        self.shown.update(self.row, note=note)

    def at(self, done: int, total: int | None, note: str = "") -> None:
        self.shown.update(self.row, completed=done, total=total, note=note)
        if self.lines and (self.lines.due() or done == total):
            self.lines.say(f"{self.title}: step {done} of {total}, {note}")


class _Lines:
    """Lines about long work, now and then."""

    def __init__(self, say: Callable[[str], None], last: float) -> None:
        self._say, self._last = say, last

    def due(self) -> bool:
        """Whether the last line is old enough."""
        return time.monotonic() - self._last > LINE_SECONDS

    def say(self, line: str) -> None:
        """Print a line."""
        self._last = time.monotonic()
        self._say(line)


LINE_SECONDS = 60.0


class Terminal(Reporter):
    """Messages and progress on standard error."""

    def __init__(self) -> None:
        self._console = plain_console(stderr=True)
        self._warned: set[str] = set()
        self._steps = _Lines(self.say, float("-inf"))

    def say(self, message: str) -> None:
        """Print a message; an error, a warning or a problem is one line of LONGEST characters, a warning once."""
        if message in self._warned:
            return
        if message.startswith("warning: "):
            self._warned.add(message)
        if message.startswith(("error: ", "warning: ", "problem: ")):
            message = one_line(message)
        try:
            self._console.print(message, soft_wrap=True)
        except OSError:
            leave(sys.stderr)

    @contextlib.contextmanager
    def bar(self, title: str, total: int | None, done: int, long: bool) -> Iterator[Bar]:
        """Show a bar with the time left, the speed and a note."""
        columns: tuple[ProgressColumn, ...] = (
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=24),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            _Speed(),
            TextColumn("{task.fields[note]}", markup=False),
        )
        console = self._console
        with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as shown:
            yield _Bar(shown, self._steps if long and not console.is_terminal else None, title, total, done)

    @contextlib.contextmanager
    def clock(self) -> Iterator[Clock]:
        """Show a bar on a terminal; elsewhere a line now and then."""
        if not self._console.is_terminal:
            lines = _Lines(self.say, time.monotonic())

            def line(note: str, spent: float, left: float) -> None:
                if lines.due():
                    rest = f"about {duration(left)} left" if left else "time left not known yet"
                    lines.say(f"evaluate: {note}; {duration(spent)} so far, {rest}")

            yield line
            return
        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(bar_width=24),
            TextColumn("{task.fields[left]}", markup=False),
            TextColumn("{task.fields[note]}", markup=False),
        )
        with Progress(*columns, console=self._console, transient=True) as shown:
            row = shown.add_task("evaluate", total=None, left="", note="")

            def show(note: str, spent: float, left: float) -> None:
                total, rest = (spent + left, f"about {duration(left)} left") if left > 0 else (None, "")
                shown.update(row, completed=spent, total=total, left=rest, note=note)

            yield show
