"""The terminal: standard output, messages, progress bars, and the one place that turns errors into a line.

Nothing here knows of applications. rich is imported when something is printed, since completion prints nothing.
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

from typing_extensions import override

from metapp.options import BadOption
from metapp.runs.memory_errors import describe_short_memory
from metapp.runs.reporter import Bar, Reporter, use_reporter
from metapp.storage import Document
from metapp.storage.files import DISK_FULL_ERRNOS, error_text, to_json_value

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress

MAX_MESSAGE_CHARACTERS = 300  # length of an error or a warning
MAX_PATH_CHARACTERS = 45  # length of the end of a path that is kept where a message is too long
# without a terminal, progress is printed in lines
LONG_JOB_LINE_SECONDS = 60.0  # s between lines about a long job
SHORT_JOB_WAIT_SECONDS = 2.0  # s before the first line about a shorter job
SHORT_JOB_LINE_SECONDS = 10.0  # s between further lines about it
MIN_ESTIMATE_SHARE = 0.1  # share of a job that must be done before the time left is shown
SPEED_WINDOW_SECONDS = 3600.0  # s over which the speed is averaged for this estimate
REPORT_REQUEST = "this is unexpected: please report it with the command and its output under METAPP_TRACEBACK=1."
INTERRUPTED_MESSAGE = "interrupted."
_begin = time.perf_counter()  # s, when the command began, or when this module was imported
_interrupted_message = INTERRUPTED_MESSAGE  # what is said if the command is interrupted


class Exit(enum.IntEnum):
    """Exit codes, which scripts rely on."""

    DONE = 0
    FAILED = 1
    USAGE = 2
    INTERRUPTED = 130
    UNREAD = 141  # the reader of the output ended early; shells have this code for SIGPIPE


def plain_console(*, stderr: bool = False, width: int | None = None) -> Console:
    """Make a console that prints text as it is: names of files and tasks may look like markup or emoji codes."""
    from rich.console import Console

    return Console(stderr=stderr, width=width, highlight=False, markup=False, emoji=False)


def standard_output() -> Console:
    """Return the console of standard output, for tables; a pipe has no width, and gets 100 characters."""
    return plain_console(width=None if sys.stdout.isatty() else 100)


def print_json(document: Document) -> None:
    """Print an object as one line of standard output, at once."""
    sys.stdout.write(json.dumps(to_json_value(document), allow_nan=False, default=float) + "\n")
    sys.stdout.flush()


def escape_control_characters(text: str) -> str:
    """Replace control characters, and those that change the writing direction, by their escapes in Python."""
    return "".join(
        character if character.isprintable() else character.encode("unicode_escape").decode() for character in text
    )


def shorten_to_line(message: str) -> str:
    """Return a message as one line of at most MAX_MESSAGE_CHARACTERS characters, without control characters.

    Long paths are cut first, then the middle of the message: its ends hold the subject and the remedy.
    """
    text = escape_control_characters(message)
    if len(text) > MAX_MESSAGE_CHARACTERS:
        text = re.sub(r"[^\s(]{60,}", lambda path: _shorten_path(path[0]), text)
    half = (MAX_MESSAGE_CHARACTERS - 5) // 2
    return text if len(text) <= MAX_MESSAGE_CHARACTERS else f"{text[:half]} ... {text[-half:]}"


def _shorten_path(path: str) -> str:
    """Return the end of a long path, which tells most, from the beginning of a folder's name if that is near.

    >>> _shorten_path("/home/somebody/projects/metapp/.venv/metapp/checkpoints/brdf/general.safetensors")
    '.../metapp/checkpoints/brdf/general.safetensors'
    """
    end = path[-MAX_PATH_CHARACTERS:]
    return f"...{end[max(0, end.find('/')) :]}"


class _Bar(Bar):
    """A row of a progress bar, or lines about a long job where there is no terminal.

    Args:
        bars: the bars that the row is drawn among.
        title: the name of the job.
        total: the number of its parts, if known.
        done: the number of parts that are done already.
        lines: prints a line as each part is done; None if the row itself is visible.
    """

    def __init__(self, bars: Progress, title: str, total: int | None, done: int, lines: Terminal | None) -> None:
        self.bars, self.lines, self.title, self.done, self.total = bars, lines, title, done, total
        self.row = bars.add_task(title, total=total, completed=done, note="")

    @override
    def advance(self, note: str = "") -> None:
        self.done += 1
        self.bars.update(self.row, completed=self.done, note=note)
        if self.lines:
            self.lines.say(f"{self.title}: {self.done} of {self.total}, {note}")

    @override
    def set_label(self, note: str, share: float = 0.0) -> None:
        self.bars.update(self.row, completed=self.done + share, note=note)

    @override
    def set_done(self, done: int, total: int | None, note: str = "") -> None:
        self.done = done
        self.bars.update(self.row, completed=done, total=total, note=note)
        if self.lines:
            self.lines.say_if_due(f"{self.title}: step {done} of {total}, {note}", last=done == total)


class _Lines(Bar):
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
            _discard(sys.stderr)

    def say_if_due(self, line: str, *, last: bool) -> None:
        """Print a line about a long job, if the line before is old enough or this is the last."""
        if last or time.monotonic() - self._last_line > LONG_JOB_LINE_SECONDS:
            self._last_line = time.monotonic()
            self.say(line)

    @contextlib.contextmanager
    @override
    def bar(self, title: str, total: int | None, done: int, long: bool) -> Iterator[Bar]:
        """Show a bar with the time left, the steps per second and a note; without a terminal, print lines."""
        is_live = self._is_live()
        if not (is_live or long):
            lines = _Lines(self, title, total, done)
            try:
                yield lines
            finally:
                lines.end()
            return
        from rich import progress, text

        class SpeedColumn(progress.ProgressColumn):
            @override
            def render(self, task: progress.Task) -> text.Text:
                return text.Text(f"{task.speed:.1f}/s" if task.speed else "")

        class RemainingColumn(progress.TimeRemainingColumn):
            @override
            def render(self, task: progress.Task) -> text.Text:
                is_known = task.total and task.completed >= MIN_ESTIMATE_SHARE * task.total
                return super().render(task) if is_known else text.Text("")

        columns: tuple[progress.ProgressColumn, ...] = (
            progress.TextColumn("{task.description}", markup=False),
            progress.BarColumn(bar_width=24),
            progress.MofNCompleteColumn(),
            RemainingColumn(),
            SpeedColumn(),
            progress.TextColumn("{task.fields[note]}", markup=False),
        )
        settings: Any = {"console": self._console, "disable": not is_live, "transient": True}
        with progress.Progress(*columns, speed_estimate_period=SPEED_WINDOW_SECONDS, **settings) as bars:
            yield _Bar(bars, title, total, done, None if is_live else self)

    def _is_live(self) -> bool:
        """Return whether a bar can be drawn anew in place: on a terminal, which FORCE_COLOR does not make of a log."""
        console = self._console
        return console.file.isatty() and console.is_terminal and not console.is_dumb_terminal


@contextlib.contextmanager
def pause_garbage_collection() -> Iterator[None]:
    """Pause garbage collection while torch is imported, whose objects stay: it saves a tenth of the time."""
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
    """Run a command; an error of the user or of the data is one line on standard error, never a traceback.

    Args:
        command: the command; a whole number that it returns is the exit code.
        terminal: prints messages and progress; None makes a new one.

    Returns:
        The exit code.
    """
    import typer

    global _begin, _interrupted_message
    _begin, _interrupted_message = time.perf_counter(), INTERRUPTED_MESSAGE
    _open_streams()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # a name with any characters can be printed
    terminal = terminal or Terminal()
    # typer contains its own click from 0.2x on, so click's classes are found as bases of what typer exports
    usage_error, click_error = typer.BadParameter.__mro__[1:3]
    # a user sees the warnings of this project's packages, none of libraries
    warnings.simplefilter("ignore")
    warnings.filterwarnings("default", module=r"(metapp|data_tools)\b")
    warnings.showwarning = lambda message, *_, **__: terminal.say(f"warning: {message}")
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, _interrupt)  # clusters end programs by SIGTERM; it is handled as Ctrl-C is
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
            raise  # a command that ended well, such as --show-completion; click also says a broken pipe by SystemExit
        # a reader such as `head` ended: print no error, neither now nor when Python flushes at exit
        _discard(sys.stdout)
        return Exit.UNREAD
    except Exception as error:
        terminal.say(f"error: {error_message(error)}")
        try:
            sys.stdout.flush()
        except OSError:
            _discard(sys.stdout)  # the disk is full
        return Exit.FAILED
    if code == Exit.INTERRUPTED:  # typer itself turns Ctrl-C into this code
        terminal.say(_interrupted_message)
    return code if isinstance(code, int) else Exit.DONE


def state_what_interruption_keeps(text: str) -> None:
    """Set what is said if the command that runs is interrupted: what is kept, and how to go on."""
    global _interrupted_message
    _interrupted_message = f"{INTERRUPTED_MESSAGE.removesuffix('.')}; {text}."


def command_seconds() -> float:
    """Return the seconds since the command began, its imports included."""
    return time.perf_counter() - _begin


def _open_streams() -> None:
    """Open /dev/null in place of closed standard streams, whose numbers the next opened files would get.

    A closed standard output then refuses what is printed, as a full one does.
    """
    for number, mode in enumerate((os.O_RDONLY, os.O_RDONLY, os.O_WRONLY)):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, mode)  # gets the lowest free number
    sys.stdout = sys.stdout or os.fdopen(1, "w", closefd=False)
    sys.stderr = sys.stderr or os.fdopen(2, "w", closefd=False)


def error_message(error: Exception) -> str:
    """Return the message of an error: its own if it was foreseen, else also its type and a request to report it.

    Raises:
        Exception: the error itself, if METAPP_TRACEBACK asks for a traceback.
    """
    if os.environ.get("METAPP_TRACEBACK"):
        raise error
    if line := describe_short_memory(error):
        return line
    # whoever writes a file names it in the error; without a name it is standard output
    if isinstance(error, OSError) and error.errno in DISK_FULL_ERRNOS and error.strerror and error.filename is None:
        return f"standard output: {error.strerror}; print to another file."
    if isinstance(error, OSError) and error.errno == errno.EBADF and error.filename is None:
        return "standard output: closed, expected an open one; print to a file or to /dev/null, or add --quiet."
    is_foreseen = isinstance(error, ValueError | FloatingPointError | OSError | MemoryError | ImportError)
    message = error_text(error)
    shortened = message if len(message) < 150 else f"{message[:147]}..."  # messages of libraries may fill pages
    return message if is_foreseen else f"{type(error).__name__}: {shortened}; {REPORT_REQUEST}"


def _interrupt(*_: object) -> None:
    raise KeyboardInterrupt


def _discard(stream: IO[str]) -> None:
    """Send the rest of a stream that cannot be written to nowhere, or Python would fail at it again at exit."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
