"""Messages and progress on standard error: bars on a terminal, lines in a log."""

from __future__ import annotations

import contextlib
import sys
import threading
import time
from collections.abc import Iterator

from typing_extensions import override

from metapp.cli.console import discard_output, escape_control_characters, plain_console, shorten_to_line
from metapp.runs.reporter import Bar, Reporter

# without a terminal, progress is printed in lines
LONG_JOB_LINE_SECONDS = 60.0  # s between lines about a long job
SHORT_JOB_WAIT_SECONDS = 2.0  # s before the first line about a shorter job
SHORT_JOB_LINE_SECONDS = 10.0  # s between further lines about it


class LongJobLines(Bar):
    """Lines about a long job where there is no terminal: one as each part is done, or now and then.

    Args:
        terminal: prints the lines.
        title: the name of the job.
        total: the number of its parts, if known.
        done: the number of parts that are done already.
    """

    def __init__(self, terminal: Terminal, title: str, total: int | None, done: int) -> None:
        self.terminal, self.title, self.total, self.done = terminal, title, total, done

    @override
    def advance(self, note: str = "") -> None:
        self.done += 1
        self.terminal.say(f"{self.title}: {self.done} of {self.total}, {note}")

    @override
    def set_done(self, done: int, total: int | None, note: str = "") -> None:
        self.done = done
        self.terminal.say_if_due(f"{self.title}: step {done} of {total}, {note}", last=done == total)


class ShortJobLines(Bar):
    """Lines about a shorter job where there is no terminal: one after a wait, then others as parts are done.

    Args:
        terminal: prints the lines.
        title: the name of the job.
        total: the number of its parts, if known.
        done: the number of parts that are done already.
    """

    def __init__(self, terminal: Terminal, title: str, total: int | None, done: int) -> None:
        self.terminal, self.title, self.total, self.done, self.note = terminal, title, total, done, ""
        self._next = time.monotonic() + terminal.wait_seconds + terminal.next_seconds
        # a timer says the first line, since the first part may take longer than the wait
        self._timer = threading.Timer(terminal.wait_seconds, self._say)
        self._timer.daemon = True
        self._timer.start()

    @override
    def advance(self, note: str = "") -> None:
        self.set_done(self.done + 1, self.total, note)

    @override
    def set_label(self, note: str, share: float = 0.0) -> None:
        self.set_done(self.done, self.total, note)

    @override
    def set_done(self, done: int, total: int | None, note: str = "") -> None:
        self.done, self.total, self.note = done, total, note
        if time.monotonic() > self._next:
            self._say()

    def end(self) -> None:
        """Stop the timer, so that no further line is printed."""
        self._timer.cancel()

    def _say(self) -> None:
        self._next = time.monotonic() + self.terminal.next_seconds
        state = "under way" if self.total is None else f"{self.done} of {self.total}"
        self.terminal.say(", ".join(filter(None, [f"{self.title}: {state}", self.note])))


class Terminal(Reporter):
    """Messages and progress on standard error.

    Args:
        wait_seconds: seconds before the first line about a shorter job, where there is no terminal.
        next_seconds: seconds between further lines about it.
    """

    def __init__(
        self, *, wait_seconds: float = SHORT_JOB_WAIT_SECONDS, next_seconds: float = SHORT_JOB_LINE_SECONDS
    ) -> None:
        self.wait_seconds, self.next_seconds = wait_seconds, next_seconds
        self._console = plain_console(stderr=True)
        self._warned: set[str] = set()
        self._last_line = float("-inf")

    @override
    def say(self, message: str) -> None:
        """Print a message: errors, warnings and problems shortened to one line, each warning once."""
        if message in self._warned:
            return
        if message.startswith("warning: "):
            self._warned.add(message)
        if message.startswith(("error: ", "warning: ", "problem: ")):
            message = shorten_to_line(message)
        message = "\n".join(map(escape_control_characters, message.split("\n")))
        try:
            self._console.print(message, soft_wrap=True)
        except OSError:
            discard_output(sys.stderr)

    def say_if_due(self, line: str, *, last: bool) -> None:
        """Print a line about a long job, if the line before is old enough or this is the last."""
        if last or time.monotonic() - self._last_line > LONG_JOB_LINE_SECONDS:
            self._last_line = time.monotonic()
            self.say(line)

    @contextlib.contextmanager
    @override
    def bar(self, title: str, total: int | None, done: int, long: bool) -> Iterator[Bar]:
        """Show a bar with the time left, the steps per second and a note; without a terminal, print lines."""
        if self._is_live():
            from metapp.cli.live_bar import draw_live_bar

            with draw_live_bar(self._console, title, total, done) as bar:
                yield bar
        elif long:
            yield LongJobLines(self, title, total, done)
        else:
            lines = ShortJobLines(self, title, total, done)
            try:
                yield lines
            finally:
                lines.end()

    def _is_live(self) -> bool:
        """Return whether a bar can be drawn anew in place: on a terminal, which FORCE_COLOR does not make of a log."""
        console = self._console
        return console.file.isatty() and console.is_terminal and not console.is_dumb_terminal
