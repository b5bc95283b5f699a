"""What commands print: consoles, JSON, and texts that can be printed in one line.

rich is imported when something is printed, since completion prints nothing.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import sys
from typing import IO, TYPE_CHECKING

from metapp.storage import Document
from metapp.storage.files import to_json_value

if TYPE_CHECKING:
    from rich.console import Console

MAX_MESSAGE_CHARACTERS = 300  # length of an error or a warning
MAX_PATH_CHARACTERS = 45  # length of the end of a path that is kept where a message is too long


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

    >>> _shorten_path("/home/somebody/projects/metapp/.venv/metapp/checkpoints/brdf/quick.safetensors")
    '.../metapp/checkpoints/brdf/quick.safetensors'
    """
    end = path[-MAX_PATH_CHARACTERS:]
    return f"...{end[max(0, end.find('/')) :]}"


def discard_output(stream: IO[str]) -> None:
    """Send the rest of a stream that cannot be written to nowhere, or Python would fail at it again at exit."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
