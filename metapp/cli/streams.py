"""Standard streams: closed ones, broken ones, and messages of one line."""

from __future__ import annotations

import contextlib
import io
import os
import re
import sys
from typing import IO

LONGEST = 300  # characters of an error or a warning


class Closed(io.TextIOWrapper):
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
            setattr(sys, name, Closed(open(os.devnull, "r+b")))  # noqa: SIM115  (for the whole run)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def escaped(text: str) -> str:
    """A text with control characters, also those of the direction of writing, as Python writes them."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def one_line(message: str) -> str:
    """A message without control characters, its long paths cut, then its middle: the ends hold subject and remedy."""
    text = escaped(message)
    if len(text) > LONGEST:
        text = re.sub(r"[^\s(]{60,}", lambda word: f"...{word[0][-45:]}", text)  # long paths: their ends tell most
    half = (LONGEST - 5) // 2
    return text if len(text) <= LONGEST else f"{text[:half]} ... {text[-half:]}"


def leave(stream: IO[str]) -> None:
    """Let a stream that cannot be written to lead nowhere, so that Python does not fail at it again when it ends."""
    with contextlib.suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
