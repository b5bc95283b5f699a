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
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn
from rich.text import Text

from metapp.runs import BadOption
from metapp.runs.reporter import Bar, Clock, Reporter, duration, reporting

LONGEST = 300  # characters of an error or a warning


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
            setattr(sys, name, open(os.devnull, "w" if descriptor else "r"))  # noqa: SIM115  (for the whole run)
            _closed.add(name)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


_closed: set[str] = set()  # names of the standard streams that were closed when the program began
open_streams()
# a pipe has no width of its own
out = Console(highlight=False, width=None if sys.stdout.isatty() else 120)
err = Console(stderr=True, highlight=False)


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


def _leave(stream: Any) -> None:
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


def print_json(document: dict[str, Any]) -> None:
    """Write an object as one line of standard output, at once.

    Raises:
        ValueError: standard output is closed.
    """
    if "stdout" in _closed:
        raise ValueError("standard output: closed, expected an open one for --json; what was made is kept.")
    sys.stdout.write(json.dumps(document, allow_nan=False, default=float) + "\n")
    sys.stdout.flush()


def run(command: Callable[[], Any]) -> int:
    """Run a command; an error of the user's or of the data is one line on standard error, never a traceback."""
    import typer

    # typer carries click inside from 0.2x on, so its classes are reached through those that typer exports
    usage_error, click_error = typer.BadParameter.__mro__[1:3]
    # only our own warnings are for the user
    warnings.simplefilter("ignore")
    warnings.filterwarnings("default", module=r"(metapp|data_tools)\b")
    warnings.showwarning = lambda message, *_, **__: say(f"warning: {message}")
    _end_like_ctrl_c()
    try:
        with reporting(TERMINAL):
            code = command()
        sys.stdout.flush()
    except typer.Exit as error:
        return error.exit_code
    except typer.Abort:
        return _interrupted()
    except click_error as error:  # type: ignore[misc]  # a class, found at run time
        if hasattr(error, "message"):
            error.message = one_line(str(error.message))
        error.show()
        return Exit.USAGE if isinstance(error, usage_error) else Exit.FAILED
    except BadOption as error:
        typer.BadParameter(one_line(str(error))).show()
        return Exit.USAGE
    except KeyboardInterrupt:
        return _interrupted()
    except BrokenPipeError:
        # a reader such as `head` went away: say nothing, also not when Python flushes at exit
        _leave(sys.stdout)
        return Exit.FAILED
    except Exception as error:
        say(f"error: {what_failed(error)}")
        try:
            sys.stdout.flush()
        except OSError:
            _leave(sys.stdout)  # it is full
        return Exit.FAILED
    if code == Exit.INTERRUPTED:  # typer turns Ctrl-C into this code by itself
        return _interrupted()
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

    def stop(*_: Any) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, stop)


REPORT = "unexpected: please report it with the output of METAPP_TRACEBACK=1 and the command."


def _cut(message: str) -> str:
    """The beginning of what a library says, which may be pages."""
    return message if len(message) < 150 else f"{message[:147]}..."


def _interrupted() -> int:
    say(
        "interrupted; the same command goes on with training where it was and with fits that are not finished; "
        "conversions start over."
    )
    return Exit.INTERRUPTED


class _Speed(ProgressColumn):
    """Steps a second."""

    def render(self, task: Any) -> Text:
        return Text(f"{task.speed:.1f}/s" if task.speed else "")


class _Bar(Bar):
    """A row of a progress bar; where there is no terminal, a line now and then."""

    def __init__(self, shown: Progress, title: str, total: int | None, done: int, long: bool) -> None:
        self.shown, self.title, self.long = shown, title, long
        self.row = shown.add_task(title, total=total, completed=done, note="")

    def advance(self, note: str = "") -> None:
        self.shown.update(self.row, advance=1, note=note)

    def name(self, note: str) -> None:
        self.shown.update(self.row, note=note)

    def at(self, done: int, total: int | None, note: str = "") -> None:
        self.shown.update(self.row, completed=done, total=total, note=note)
        now = time.monotonic()
        if self.long and not err.is_terminal and (now - _last_line[0] > LINE_SECONDS or done == total):
            _last_line[0] = now
            say(f"{self.title}: step {done} of {total}, {note}")


LINE_SECONDS = 60.0
_last_line = [float("-inf")]


class Terminal(Reporter):
    """Messages and progress on standard error."""

    def say(self, message: str) -> None:
        """Print a message; an error, a warning or a problem is one line of LONGEST characters."""
        if message.startswith(("error: ", "warning: ", "problem: ")):
            message = one_line(message)
        try:
            err.print(message, markup=False, soft_wrap=True)
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
        with Progress(*columns, console=err, disable=not err.is_terminal, transient=True) as shown:
            yield _Bar(shown, title, total, done, long)

    @contextlib.contextmanager
    def clock(self) -> Iterator[Clock]:
        """Show a bar on a terminal; elsewhere a line now and then."""
        if not err.is_terminal:
            yield _lines()
            return
        columns = (
            TextColumn("{task.description}"),
            BarColumn(bar_width=24),
            TextColumn("{task.fields[left]}", markup=False),
            TextColumn("{task.fields[note]}", markup=False),
        )
        with Progress(*columns, console=err, transient=True) as shown:
            row = shown.add_task("evaluate", total=None, left="", note="")

            def show(note: str, spent: float, left: float) -> None:
                known = left > 0
                total, said = (spent + left, f"about {duration(left)} left") if known else (None, "")
                shown.update(row, completed=spent, total=total, left=said, note=note)

            yield show


def _lines() -> Clock:
    """A line now and then about how far work is."""
    last = time.monotonic()

    def line(note: str, spent: float, left: float) -> None:
        nonlocal last
        if time.monotonic() - last > LINE_SECONDS:
            last = time.monotonic()
            rest = f"about {duration(left)} left" if left else "time left not known yet"
            say(f"evaluate: {note}; {duration(spent)} so far, {rest}")

    return line


TERMINAL = Terminal()
say = TERMINAL.say
