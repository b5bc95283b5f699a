"""The process of a command: its streams, signals and time, and the one place that turns errors into a line."""

from __future__ import annotations

import contextlib
import enum
import errno
import gc
import io
import os
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator

from metapp.cli.console import discard_output, shorten_to_line
from metapp.cli.progress import Terminal
from metapp.options import BadOption
from metapp.runs.memory_errors import describe_short_memory
from metapp.runs.reporter import use_reporter
from metapp.storage.files import DISK_FULL_ERRNOS, error_text

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
        discard_output(sys.stdout)
        return Exit.UNREAD
    except Exception as error:
        terminal.say(f"error: {error_message(error)}")
        try:
            sys.stdout.flush()
        except OSError:
            discard_output(sys.stdout)  # the disk is full
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
