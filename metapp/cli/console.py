"""The terminal: standard output, messages and progress bars, and the one place that turns errors into one line.

rich is imported when something is printed, since completion prints nothing.
"""

from __future__ import annotations

import contextlib
import enum
import errno
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
from typing import IO, TYPE_CHECKING, Any

from metapp.options import BadOption
from metapp.runs.reporter import Bar, Reporter, use_reporter
from metapp.storage import Document
from metapp.storage.files import DISK_FULL_ERRNOS, to_json_value

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

MAX_MESSAGE_CHARACTERS = 300  # characters of an error or a warning
LONG_JOB_LINE_SECONDS = 60.0  # between lines about long work where there is no terminal
SHORT_JOB_WAIT_SECONDS, SHORT_JOB_LINE_SECONDS = (
    2.0,
    10.0,
)  # before the first line about shorter work, and between further ones
MIN_ESTIMATE_SHARE = 0.1  # of a job, before which no estimate of the time left is shown
SPEED_WINDOW_SECONDS = 3600.0  # seconds, whose mean speed makes the estimate
REPORT_REQUEST = "unexpected: please report it with the output of METAPP_TRACEBACK=1 and the command."
_begin = time.perf_counter()  # of the command, or of this import
INTERRUPTED = (
    "interrupted; the same command goes on with training where it was, with --resume with fits that are not finished; "
    "conversions start over."
)


class Exit(enum.IntEnum):
    """Exit codes, as scripts rely on them."""

    DONE = 0
    FAILED = 1
    USAGE = 2
    INTERRUPTED = 130
    UNREAD = 141  # whoever read the output went away, as shells say it of other programs


def plain_console(*, stderr: bool = False, width: int | None = None) -> Console:
    """A console that prints text as it is: names of files and tasks may look like markup or emoji codes."""
    from rich.console import Console

    return Console(stderr=stderr, width=width, highlight=False, markup=False, emoji=False)


def standard_output() -> Console:
    """Standard output, for tables; a pipe has no width of its own."""
    return plain_console(width=None if sys.stdout.isatty() else 100)


def print_json(document: Document) -> None:
    """Write an object as one line of standard output, at once."""
    sys.stdout.write(json.dumps(to_json_value(document), allow_nan=False, default=float) + "\n")
    sys.stdout.flush()


def escape_control_characters(text: str) -> str:
    """A text with control characters, also those of the direction of writing, as Python writes them."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def shorten_to_line(message: str) -> str:
    """A message without control characters, its long paths cut, then its middle: the ends hold subject and remedy."""
    text = escape_control_characters(message)
    if len(text) > MAX_MESSAGE_CHARACTERS:
        text = re.sub(r"[^\s(]{60,}", lambda word: f"...{word[0][-45:]}", text)  # long paths: their ends tell most
    half = (MAX_MESSAGE_CHARACTERS - 5) // 2
    return text if len(text) <= MAX_MESSAGE_CHARACTERS else f"{text[:half]} ... {text[-half:]}"


class _Bar(Bar):
    """A row of a progress bar, or, of long work if there is no terminal, lines by `lines`: one as each part is done."""

    def __init__(self, bars: Progress, title: str, total: int | None, done: int, lines: Terminal | None) -> None:
        self.bars, self.lines, self.title, self.done, self.total = bars, lines, title, done, total
        self.row = bars.add_task(title, total=total, completed=done, note="")

    def advance(self, note: str = "") -> None:
        self.done += 1
        self.bars.update(self.row, completed=self.done, note=note)
        if self.lines:
            self.lines.say(f"{self.title}: {self.done} of {self.total}, {note}")

    def set_label(self, note: str, share: float = 0.0) -> None:
        self.bars.update(self.row, completed=self.done + share, note=note)

    def set_done(self, done: int, total: int | None, note: str = "") -> None:
        self.done = done
        self.bars.update(self.row, completed=done, total=total, note=note)
        if self.lines:
            self.lines.say_at_times(f"{self.title}: step {done} of {total}, {note}", last=done == total)


class _Lines(Bar):
    """Lines about short work where there is no terminal: one after a wait, then some as parts are done."""

    def __init__(self, terminal: Terminal, title: str, total: int | None, done: int) -> None:
        self.terminal, self.title, self.total, self.done, self.note = terminal, title, total, done, ""
        self._next = time.monotonic() + terminal.wait_seconds + terminal.next_seconds
        # the first part may take all the time, so that nothing else would say anything
        self._timer = threading.Timer(terminal.wait_seconds, self._say)
        self._timer.daemon = True
        self._timer.start()

    def advance(self, note: str = "") -> None:
        self.set_done(self.done + 1, self.total, note)

    def set_label(self, note: str, share: float = 0.0) -> None:
        self.set_done(self.done, self.total, note)

    def set_done(self, done: int, total: int | None, note: str = "") -> None:
        self.done, self.total, self.note = done, total, note
        if time.monotonic() > self._next:
            self._say()

    def end(self) -> None:
        """Say no more."""
        self._timer.cancel()

    def _say(self) -> None:
        self._next = time.monotonic() + self.terminal.next_seconds
        state = "under way" if self.total is None else f"{self.done} of {self.total}"
        self.terminal.say(", ".join(filter(None, [f"{self.title}: {state}", self.note])))


class Terminal(Reporter):
    """Messages and progress on standard error.

    Args:
        wait_seconds: silence, after which a line says about shorter work how far it is where there is no terminal.
        next_seconds: time between further lines about it.
    """

    def __init__(
        self, *, wait_seconds: float = SHORT_JOB_WAIT_SECONDS, next_seconds: float = SHORT_JOB_LINE_SECONDS
    ) -> None:
        self.wait_seconds, self.next_seconds = wait_seconds, next_seconds
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
            message = shorten_to_line(message)
        message = "\n".join(map(escape_control_characters, message.split("\n")))
        try:
            self._console.print(message, soft_wrap=True)
        except OSError:
            _leave(sys.stderr)

    def say_at_times(self, line: str, *, last: bool) -> None:
        """Print a line about long work, if the one before is old enough or this is the last."""
        if last or time.monotonic() - self._last_line > LONG_JOB_LINE_SECONDS:
            self._last_line = time.monotonic()
            self.say(line)

    @contextlib.contextmanager
    def bar(self, title: str, total: int | None, done: int, long: bool) -> Iterator[Bar]:
        """Show a bar with the time left, the speed in steps a second and a note."""
        is_terminal = self._console.is_terminal
        if not (is_terminal or long):
            lines = _Lines(self, title, total, done)
            try:
                yield lines
            finally:
                lines.end()
            return
        from rich import progress, text

        class Speed(progress.ProgressColumn):
            def render(self, task: progress.Task) -> text.Text:
                return text.Text(f"{task.speed:.1f}/s" if task.speed else "")

        class Remaining(progress.TimeRemainingColumn):
            def render(self, task: progress.Task) -> text.Text:
                known = task.total and task.completed >= MIN_ESTIMATE_SHARE * task.total
                return super().render(task) if known else text.Text("")

        columns: tuple[progress.ProgressColumn, ...] = (
            progress.TextColumn("{task.description}", markup=False),
            progress.BarColumn(bar_width=24),
            progress.MofNCompleteColumn(),
            Remaining(),
            Speed(),
            progress.TextColumn("{task.fields[note]}", markup=False),
        )
        shown: Any = {"console": self._console, "disable": not is_terminal, "transient": True}
        with progress.Progress(*columns, speed_estimate_period=SPEED_WINDOW_SECONDS, **shown) as bars:
            yield _Bar(bars, title, total, done, None if is_terminal else self)


@contextlib.contextmanager
def pause_garbage_collection() -> Iterator[None]:
    """Import torch without garbage collection among objects of modules, which stay: a tenth of the time."""
    if "torch" in sys.modules:
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.enable()


def run_command(command: Callable[[], object], terminal: Terminal | None = None) -> int:
    """Run a command; an error of the user's or of the data is one line on standard error, never a traceback.

    Args:
        command: what is done; its whole numbers are exit codes.
        terminal: prints messages and progress; None is a new one.

    Returns:
        The exit code.
    """
    import typer

    global _begin
    _begin = time.perf_counter()
    _open_streams()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # no character of a name stops a line
    terminal = terminal or Terminal()
    # typer carries click inside from 0.2x on, so its classes are reached through those that typer exports
    usage_error, click_error = typer.BadParameter.__mro__[1:3]
    # only our own warnings are for the user
    warnings.simplefilter("ignore")
    warnings.filterwarnings("default", module=r"(metapp|data_tools)\b")
    warnings.showwarning = lambda message, *_, **__: terminal.say(f"warning: {message}")
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, _interrupt)  # by which clusters end a program; it keeps what Ctrl-C keeps
    code: object = None
    try:
        with use_reporter(terminal):
            code = command()
        sys.stdout.flush()
    except typer.Exit as error:
        return error.exit_code
    except (typer.Abort, KeyboardInterrupt):
        code = Exit.INTERRUPTED
    except click_error as error:  # type: ignore[misc]  # a class, found at run time
        if hasattr(error, "message"):
            error.message = shorten_to_line(str(error.message))
        error.show()
        return Exit.USAGE if isinstance(error, usage_error) else Exit.FAILED
    except BadOption as error:
        typer.BadParameter(shorten_to_line(str(error))).show()
        return Exit.USAGE
    except (BrokenPipeError, SystemExit) as error:
        if isinstance(error, SystemExit) and not isinstance(error.__context__, BrokenPipeError):
            raise  # not click's word for a broken pipe: it has ended well, as --show-completion does
        # a reader such as `head` went away: say nothing, also not when Python flushes at exit
        _leave(sys.stdout)
        return Exit.UNREAD
    except Exception as error:
        terminal.say(f"error: {error_message(error)}")
        try:
            sys.stdout.flush()
        except OSError:
            _leave(sys.stdout)  # it is full
        return Exit.FAILED
    if code == Exit.INTERRUPTED:  # typer turns Ctrl-C into this code by itself
        terminal.say(INTERRUPTED)
    return code if isinstance(code, int) else Exit.DONE


def command_seconds() -> float:
    """The seconds since the command began, what it imports included."""
    return time.perf_counter() - _begin


def _open_streams() -> None:
    """Put /dev/null in the place of closed streams, whose numbers the first files that are opened would get.

    A closed standard output refuses what is printed, as a full one does.
    """
    for number, mode in enumerate((os.O_RDONLY, os.O_RDONLY, os.O_WRONLY)):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, mode)  # gets the lowest number that is free
    sys.stdout = sys.stdout or os.fdopen(1, "w", closefd=False)
    sys.stderr = sys.stderr or os.fdopen(2, "w", closefd=False)


def error_message(error: Exception) -> str:
    """The message of an error: its own, if it was foreseen.

    Raises:
        Exception: the same, if METAPP_TRACEBACK asks for a traceback.
    """
    if os.environ.get("METAPP_TRACEBACK"):
        raise error
    # files are named by whoever writes them
    if isinstance(error, OSError) and error.errno in DISK_FULL_ERRNOS and error.strerror and error.filename is None:
        return f"standard output: {error.strerror}; print to another file."
    if isinstance(error, OSError) and error.errno == errno.EBADF and error.filename is None:
        return "standard output: closed, expected an open one; print to a file or to /dev/null, or add --quiet."
    foreseen = isinstance(error, ValueError | FloatingPointError | OSError | MemoryError | ImportError)
    what = str(error) or type(error).__name__
    cut = what if len(what) < 150 else f"{what[:147]}..."  # libraries say pages
    return what if foreseen else f"{type(error).__name__}: {cut}; {REPORT_REQUEST}"


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt


def _leave(stream: IO[str]) -> None:
    """Let a stream that cannot be written to lead nowhere, so that Python does not fail at it again when it ends."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
