"""Parts that all commands share: exit codes, standard output and the one place that turns errors into one line."""

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
import warnings
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from metapp.cli.streams import leave, one_line
from metapp.options import BadOption
from metapp.runs.reporter import Reporter, reporting
from metapp.storage import Document
from metapp.storage.files import as_text

if TYPE_CHECKING:
    from rich.console import Console


def out() -> Console:
    """Standard output, for tables; a pipe has no width of its own."""
    from metapp.cli.terminal import plain_console

    return plain_console(width=None if sys.stdout.isatty() else 120)


class Exit(enum.IntEnum):
    """Exit codes, as scripts rely on them."""

    DONE = 0
    FAILED = 1
    USAGE = 2
    INTERRUPTED = 130
    UNREAD = 141  # whoever read the output went away, as shells say it of other programs


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
    """Write an object as one line of standard output, at once."""
    sys.stdout.write(json.dumps(as_text(document), allow_nan=False, default=float) + "\n")
    sys.stdout.flush()


def run(command: Callable[[], object]) -> int:
    """Run a command; an error of the user's or of the data is one line on standard error, never a traceback."""
    import typer

    from metapp.cli.terminal import Terminal  # here: completion needs none of it

    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # no character of a name stops a line
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
        if remedy := _remedy(error.format_message()):
            error = usage_error(f"{error.format_message()}{remedy}", error.ctx)
        error.show()
        return Exit.USAGE if isinstance(error, usage_error) else Exit.FAILED
    except BadOption as error:
        typer.BadParameter(one_line(str(error))).show()
        return Exit.USAGE
    except KeyboardInterrupt:
        return _interrupted(terminal)
    except (BrokenPipeError, SystemExit) as error:
        if isinstance(error, SystemExit) and not isinstance(error.__context__, BrokenPipeError):
            raise  # not click's word for a broken pipe: it has ended well, as --show-completion does
        # a reader such as `head` went away: say nothing, also not when Python flushes at exit
        leave(sys.stdout)
        return Exit.UNREAD
    except Exception as error:
        terminal.say(f"error: {what_failed(error)}")
        try:
            sys.stdout.flush()
        except OSError:
            leave(sys.stdout)  # it is full
        return Exit.FAILED
    if code == Exit.INTERRUPTED:  # typer turns Ctrl-C into this code by itself
        return _interrupted(terminal)
    return code if isinstance(code, int) else Exit.DONE


def _remedy(message: str) -> str:
    """A remedy for an application that was forgotten or is no command, or a word that is no choice; else ""."""
    from metapp.apps import app_names
    from metapp.registry import did_you_mean

    if message == "Missing argument 'APP'.":
        return f" It is one of {', '.join(app_names())}."
    if choice := re.search(r"'([^']*)' is not one of ('.*')\.$", message):
        return did_you_mean(choice[1], choice[2].strip("'").split("', '"))
    given = re.fullmatch(r"No such command '(\w+)'\.", message)
    return f" {given[1]} is an application: metapp meta {given[1]}." if given and given[1] in app_names() else ""


def what_failed(error: Exception) -> str:
    """The message of an error: its own, if it was foreseen.

    Raises:
        Exception: the same, where METAPP_TRACEBACK asks for a traceback.
    """
    if os.environ.get("METAPP_TRACEBACK"):
        raise error
    foreseen = isinstance(error, ValueError | FloatingPointError | OSError | MemoryError | ImportError)
    what = str(error) or type(error).__name__
    cut = what if len(what) < 150 else f"{what[:147]}..."  # libraries say pages
    return what if foreseen else f"{type(error).__name__}: {cut}; {REPORT}"


def _end_like_ctrl_c() -> None:
    """SIGTERM, by which clusters and systems end a program, keeps what Ctrl-C keeps."""

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, stop)


REPORT = "unexpected: please report it with the output of METAPP_TRACEBACK=1 and the command."


def _interrupted(terminal: Reporter) -> int:
    terminal.say(
        "interrupted; the same command goes on with training where it was, with --resume with fits that are not "
        "finished; conversions start over."
    )
    return Exit.INTERRUPTED
