"""What every command shares: exit codes, consoles, progress bars and the one place that turns errors into one line."""

from __future__ import annotations

import contextlib
import enum
import json
import os
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

# a pipe has no width of its own
out = Console(highlight=False, width=None if sys.stdout.isatty() else 120)
err = Console(stderr=True, highlight=False)


class Exit(enum.IntEnum):
    """Exit codes, as scripts rely on them."""

    DONE = 0
    FAILED = 1
    USAGE = 2
    INTERRUPTED = 130


def say(message: str) -> None:
    """A message for a person, on standard error."""
    err.print(message, markup=False, soft_wrap=True)


def number(value: float | None, form: str) -> str:
    """A number as tables print it."""
    return "-" if value is None else format(value, form)


def print_json(document: dict[str, Any]) -> None:
    """The last line of standard output, one object."""
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
        code = command()
    except typer.Exit as error:
        return error.exit_code
    except typer.Abort:
        return _interrupted()
    except click_error as error:  # type: ignore[misc]  # a class, found at run time
        error.show()
        return Exit.USAGE if isinstance(error, usage_error) else Exit.FAILED
    except KeyboardInterrupt:
        return _interrupted()
    except BrokenPipeError:
        # a reader such as `head` went away: say nothing, also not when Python flushes at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return Exit.FAILED
    except (ValueError, FloatingPointError, OSError, MemoryError, ImportError) as error:
        if os.environ.get("METAPP_TRACEBACK"):
            raise
        say(f"error: {str(error) or type(error).__name__}")
        return Exit.FAILED
    if code == Exit.INTERRUPTED:  # typer turns Ctrl-C into this code by itself
        return _interrupted()
    return code if isinstance(code, int) else Exit.DONE


def _end_like_ctrl_c() -> None:
    """SIGTERM, by which clusters and systems end a program, keeps what Ctrl-C keeps."""

    def stop(*_: Any) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, stop)


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


@contextlib.contextmanager
def progress(quiet: bool = False) -> Iterator[Progress]:
    """A progress bar on standard error, with the time left, the speed and a free `note` field; nothing where quiet."""
    columns: tuple[ProgressColumn, ...] = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=24),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        _Speed(),
        TextColumn("{task.fields[note]}", markup=False),
    )
    with Progress(*columns, console=err, disable=quiet or not err.is_terminal, transient=True) as bar:
        yield bar


@contextlib.contextmanager
def progress_of_all() -> Iterator[Progress]:
    """A progress bar over work of unlike parts: its fields `left` and `note` say the time left and what is done."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=24),
        TextColumn("{task.fields[left]}", markup=False),
        TextColumn("{task.fields[note]}", markup=False),
    )
    with Progress(*columns, console=err, transient=True) as bar:
        yield bar


def follow(bar: Progress, row: Any, step: int, steps: int, note: str) -> None:
    """Show a long job's state: on the bar, or, where there is no terminal, as a line now and then."""
    bar.update(row, completed=step, total=steps, note=note)
    now = time.monotonic()
    if not err.is_terminal and (now - _last_line[0] > LINE_SECONDS or step == steps):
        _last_line[0] = now
        say(f"{bar.tasks[row].description}: step {step} of {steps}, {note}")


LINE_SECONDS = 60.0
_last_line = [float("-inf")]
