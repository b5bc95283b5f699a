"""What is printed: control characters of names escaped, messages of one line, streams that break."""

from __future__ import annotations

import contextlib
import os
import re
from typing import IO

LONGEST = 300  # characters of an error or a warning


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
