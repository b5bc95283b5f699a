"""Messages and progress of long work, passed to the one reporter that is in force.

The command line puts a reporter in force that prints. A program that calls the Python API gets warnings alone. Code
that computes only says what it does, and does not know who shows it.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator
from contextlib import AbstractContextManager
from contextvars import ContextVar


class Bar:
    """The progress of one job; this base class shows nothing."""

    def advance(self, note: str = "") -> None:
        """Count one more part of the job as done.

        Args:
            note: a word about the part that was done, or that comes next.
        """

    def set_label(self, note: str, share: float = 0.0) -> None:
        """Show the name of the current part of the job.

        Args:
            note: the name of the part.
            share: the share of this part that is done, 0 to 1.
        """

    def set_done(self, done: int, total: int | None, note: str = "") -> None:
        """Set how many parts of the job are done.

        Args:
            done: number of parts that are done.
            total: number of all parts; None if it is not known.
            note: a word about the current part.
        """


class Reporter:
    """A receiver of messages and progress; this base class passes warnings on to Python's `warnings`, nothing else."""

    def say(self, message: str) -> None:
        """Tell a person something.

        Args:
            message: one line; an error, a warning or a problem begins with that word and a colon.
        """
        if message.startswith("warning: "):
            warnings.warn(message.removeprefix("warning: "), stacklevel=3)

    def bar(self, title: str, total: int | None, done: int, long: bool) -> AbstractContextManager[Bar]:
        """Show the progress of a job.

        Where no bar can be drawn, lines are printed instead: about a long job as its parts are done, or now and then;
        about another one only after it has taken a while.

        Args:
            title: the name of the job.
            total: number of its parts; None if it is not known yet.
            done: number of parts that are already done.
            long: whether the job is expected to be long.
        """
        return contextlib.nullcontext(Bar())


_REPORTER: ContextVar[Reporter] = ContextVar("reporter", default=Reporter())  # noqa: B039  (it has no state)


@contextlib.contextmanager
def use_reporter(reporter: Reporter) -> Iterator[None]:
    """Put a reporter in force for the time of a `with` block."""
    token = _REPORTER.set(reporter)
    try:
        yield
    finally:
        _REPORTER.reset(token)


def say(message: str) -> None:
    """Tell a person something by the reporter in force; see :meth:`Reporter.say`."""
    _REPORTER.get().say(message)


def progress(
    title: str, total: int | None = None, *, done: int = 0, long: bool = False, quiet: bool = False
) -> AbstractContextManager[Bar]:
    """Show the progress of a job by the reporter in force; see :meth:`Reporter.bar`.

    Args:
        title: the name of the job.
        total: number of its parts; None if it is not known yet.
        done: number of parts that are already done.
        long: whether the job is expected to be long.
        quiet: whether nothing is shown.
    """
    return contextlib.nullcontext(Bar()) if quiet else _REPORTER.get().bar(title, total, done, long)


def format_number(value: float | None, form: str) -> str:
    """Write a number as tables print it, or a dash if there is none.

    Args:
        value: the number.
        form: its format specification, such as ".3f".

    >>> format_number(0.12345, ".3f"), format_number(None, ".3f")
    ('0.123', '-')
    """
    return "-" if value is None else format(value, form)
