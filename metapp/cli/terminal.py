"""Messages and progress bars on standard error."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Iterator

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from metapp.cli.streams import escaped, leave, one_line
from metapp.runs.reporter import Bar, Reporter


def plain_console(*, stderr: bool = False, width: int | None = None) -> Console:
    """A console that prints text as it is: names of files and tasks may look like markup or emoji codes."""
    return Console(stderr=stderr, width=width, highlight=False, markup=False, emoji=False)


class _Speed(ProgressColumn):
    """Steps a second."""

    def render(self, task: Task) -> Text:
        return Text(f"{task.speed:.1f}/s" if task.speed else "")


class _Bar(Bar):
    """A row of a progress bar, or, of long work where there is no terminal, lines by `lines`."""

    def __init__(self, bars: Progress, title: str, total: int | None, done: int, lines: Terminal | None) -> None:
        self.bars, self.lines, self.title = bars, lines, title
        self.row = bars.add_task(title, total=total, completed=done, note="")

    def advance(self, note: str = "") -> None:
        self.bars.update(self.row, advance=1, note=note)

    def name(self, note: str) -> None:
        self.bars.update(self.row, note=note)

    def at(self, done: int, total: int | None, note: str = "") -> None:
        self.bars.update(self.row, completed=done, total=total, note=note)
        if self.lines:
            self.lines.say_at_times(f"{self.title}: step {done} of {total}, {note}", last=done == total)


LINE_SECONDS = 60.0


class Terminal(Reporter):
    """Messages and progress on standard error."""

    def __init__(self) -> None:
        self._console = plain_console(stderr=True)
        self._warned: set[str] = set()
        self._last_line = float("-inf")

    def say(self, message: str) -> None:
        """Print a message; an error, a warning or a problem is one line of LONGEST characters, a warning once."""
        if message in self._warned:
            return
        if message.startswith("warning: "):
            self._warned.add(message)
        if message.startswith(("error: ", "warning: ", "problem: ")):
            message = one_line(message)
        message = "\n".join(map(escaped, message.split("\n")))
        try:
            self._console.print(message, soft_wrap=True)
        except OSError:
            leave(sys.stderr)

    def say_at_times(self, line: str, *, last: bool) -> None:
        """Print a line about long work, where the one before is old enough or this is the last."""
        if last or time.monotonic() - self._last_line > LINE_SECONDS:
            self._last_line = time.monotonic()
            self.say(line)

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
        with Progress(*columns, console=console, disable=not console.is_terminal, transient=True) as bars:
            yield _Bar(bars, title, total, done, self if long and not console.is_terminal else None)
