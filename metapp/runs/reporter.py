"""Reports of long work to whoever waits for it: messages and progress, through the one reporter that is in force.

The command line puts one in force that prints; a program that calls the Python API hears warnings alone.
"""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Iterator
from contextlib import AbstractContextManager
from contextvars import ContextVar


class Bar:
    """The progress of one job; this one shows nothing."""

    def advance(self, note: str = "") -> None:
        """Count one more as done; `note` names the next or the last one."""

    def name(self, note: str, share: float = 0.0) -> None:
        """Show the name of the current one, and the share of it that is done."""

    def at(self, done: int, total: int | None, note: str = "") -> None:
        """Show that so many are done, of so many if that is known."""


class Reporter:
    """Receives messages and progress; this one passes warnings on to Python's `warnings` and drops the rest."""

    def say(self, message: str) -> None:
        """Tell a person something; errors, warnings and problems begin with that word and a colon."""
        if message.startswith("warning: "):
            warnings.warn(message.removeprefix("warning: "), stacklevel=3)

    def bar(self, title: str, total: int | None, done: int, long: bool) -> AbstractContextManager[Bar]:
        """Show the progress of a job of `total` parts (None: not known yet), `done` of which are done.

        If there is nothing to draw a bar on, a `long` one is said in lines, as parts are done, or now and then; another
        one only once it has taken a while.
        """
        return contextlib.nullcontext(Bar())


_in_force: ContextVar[Reporter] = ContextVar("reporter", default=Reporter())  # noqa: B039  (it has no state)


@contextlib.contextmanager
def use_reporter(reporter: Reporter) -> Iterator[None]:
    """Put a reporter in force."""
    token = _in_force.set(reporter)
    try:
        yield
    finally:
        _in_force.reset(token)


def say(message: str) -> None:
    """Tell a person something; see `Reporter.say`."""
    _in_force.get().say(message)


def progress(
    title: str, total: int | None = None, *, done: int = 0, long: bool = False, quiet: bool = False
) -> AbstractContextManager[Bar]:
    """Show the progress of a job; see `Reporter.bar`. Nothing if quiet."""
    return contextlib.nullcontext(Bar()) if quiet else _in_force.get().bar(title, total, done, long)


def format_number(value: float | None, form: str) -> str:
    """Write a number as tables print it, a dash if there is none.

    >>> number(0.12345, ".3f"), number(None, ".3f")
    ('0.123', '-')
    """
    return "-" if value is None else format(value, form)
