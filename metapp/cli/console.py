"""What every command shares: exit codes, consoles, progress bars and the one place that turns errors into one line."""

from __future__ import annotations

import contextlib
import enum
import gc
import io
import json
import os
import re
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from typing import IO

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
from rich.text import Text

from metapp.runs import BadOption
from metapp.runs.reporter import Bar, Clock, Reporter, duration, reporting
from metapp.storage import Document
from metapp.storage.text import as_text

LONGEST = 300  # characters of an error or a warning


class _Closed(io.TextIOWrapper):
    """A standard stream that was closed when the program began: what is written to it leads nowhere."""


def open_streams() -> None:
    """Give closed standard streams a place to go (`metapp ... >&-`), and let no character of a name stop a line.

    A closed descriptor is filled first: else the next file that is opened takes its number, and gets what is printed.
    """
    for descriptor, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(descriptor)
        except OSError:
            os.dup2(os.open(os.devnull, os.O_RDWR), descriptor)
        if getattr(sys, name) is None:
            setattr(sys, name, _Closed(open(os.devnull, "r+b")))  # noqa: SIM115  (for the whole run)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def out() -> Console:
    """Standard output, for tables; a pipe has no width of its own."""
    return Console(highlight=False, width=None if sys.stdout.isatty() else 120)


class Exit(enum.IntEnum):
    """Exit codes, as scripts rely on them."""

    DONE = 0
    FAILED = 1
    USAGE = 2
    INTERRUPTED = 130


def one_line(message: str) -> str:
    """A message without control characters, its long paths cut, then its middle: the ends hold subject and remedy."""
    text = "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in message)
    if len(text) > LONGEST:
        text = re.sub(r"[^\s(]{60,}", lambda word: f"...{word[0][-45:]}", text)  # long paths: their ends tell most
    half = (LONGEST - 5) // 2
    return text if len(text) <= LONGEST else f"{text[:half]} ... {text[-half:]}"


def _leave(stream: IO[str]) -> None:
    """Let a stream that cannot be written to lead nowhere, so that Python does not fail at it again when it ends."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


@contextlib.contextmanager
def importing() -> Iterator[None]:
    """Import torch without looking for garbage among what modules make, which is there to stay: a tenth of the time."""
    if "torch" in sys.modules:
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def print_json(document: Document) -> None:
    """Write an object as one line of standard output, at once.

    Raises:
        ValueError: standard output is closed.
    """
    if isinstance(sys.stdout, _Closed):
        raise ValueError("standard output: closed, expected an open one for --json; what was made is kept.")
    sys.stdout.write(json.dumps(as_text(document), allow_nan=False, default=float) + "\n")
    sys.stdout.flush()


def run(command: Callable[[], object]) -> int:
    """Run a command; an error of the user's or of the data is one line on standard error, never a traceback."""
    import typer

    open_streams()
    terminal = Terminal()
    # typer carries click inside from 0.2x on, so its classes are reached through those that typer exports
    usage_error, click_error = typer.BadParameter.__mro__[1:3]
    # only our own warnings are for the user
    warnings.simplefilter("ignore")
    warnings.filterwarnings("default", module=r"(metapp|data_tools)\b")
    warnings.showwarning = lambda message, *_, **__: terminal.say(f"warning: {message}")
    _end_like_ctrl_c()
    try:
        with reporting(terminal):
            code = command()
        sys.stdout.flush()
    except typer.Exit as error:
        return error.exit_code
    except typer.Abort:
        return _interrupted(terminal)
    except click_error as error:  # type: ignore[misc]  # a class, found at run time
        if hasattr(error, "message"):
            error.message = one_line(str(error.message))
        error.show()
        return Exit.USAGE if isinstance(error, usage_error) else Exit.FAILED
    except BadOption as error:
        typer.BadParameter(one_line(str(error))).show()
        return Exit.USAGE
    except KeyboardInterrupt:
        return _interrupted(terminal)
    except BrokenPipeError:
        # a reader such as `head` went away: say nothing, also not when Python flushes at exit
        _leave(sys.stdout)
        return Exit.FAILED
    except Exception as error:
        terminal.say(f"error: {what_failed(error)}")
        try:
            sys.stdout.flush()
        except OSError:
            _leave(sys.stdout)  # it is full
        return Exit.FAILED
    if code == Exit.INTERRUPTED:  # typer turns Ctrl-C into this code by itself
        return _interrupted(terminal)
    return code if isinstance(code, int) else Exit.DONE


def what_failed(error: Exception) -> str:
    """What to say of an error: what it says itself, if it was foreseen.

    Raises:
        Exception: the same, where METAPP_TRACEBACK asks for a traceback.
    """
    if os.environ.get("METAPP_TRACEBACK"):
        raise error
    foreseen = isinstance(error, ValueError | FloatingPointError | OSError | MemoryError | ImportError)
    what = str(error) or type(error).__name__
    return what if foreseen else f"{type(error).__name__}: {_cut(what)}; {REPORT}"


def lines_of_input() -> Iterator[str]:
    """Lines of standard input as they come, without their ends; empty ones are left out."""
    for line in sys.stdin.buffer:
        if text := os.fsdecode(line.rstrip(b"\r\n")):
            yield text


def _end_like_ctrl_c() -> None:
    """SIGTERM, by which clusters and systems end a program, keeps what Ctrl-C keeps."""

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, stop)


REPORT = "unexpected: please report it with the output of METAPP_TRACEBACK=1 and the command."


def _cut(message: str) -> str:
    """The beginning of what a library says, which may be pages."""
    return message if len(message) < 150 else f"{message[:147]}..."


def _interrupted(terminal: Terminal) -> int:
    terminal.say(
        "interrupted; the same command goes on with training where it was and with fits that are not finished; "
        "conversions start over."
    )
    return Exit.INTERRUPTED


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
        self._console = Console(stderr=True, highlight=False)
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
            self._console.print(message, markup=False, soft_wrap=True)
        except OSError:
            _leave(sys.stderr)

    @contextlib.contextmanager
    def bar(self, title: str, total: int | None, done: int, long: bool) -> Iterator[Bar]:
        """Show a bar with the time left, the speed and a note."""
        columns: tuple[ProgressColumn, ...] = (
            TextColumn("{task.description}"),
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
            TextColumn("{task.description}"),
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
