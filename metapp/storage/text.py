"""Texts as UTF-8 holds them: file names may have bytes that are none, which Python passes on as lone surrogates."""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any


def meant(word: str, names: Iterable[str]) -> str:
    """A question after an error about a word that is no name, where some names begin so or one is like it; else ""."""
    choices = list(names)
    near = [name for name in choices if word and name.startswith(word)] or difflib.get_close_matches(word, choices, 1)
    return f" Did you mean {' or '.join(map(repr, near))}?" if near else ""


def as_text(value: Any) -> Any:
    r"""A text, or a document with all of its texts, in which lone surrogates are escaped, as \udcff."""
    if isinstance(value, str):
        return value.encode("utf-8", "backslashreplace").decode()
    if isinstance(value, dict):
        return {as_text(key): as_text(each) for key, each in value.items()}
    return [as_text(each) for each in value] if isinstance(value, list | tuple) else value


def path_of(text: str) -> Path:
    """The path that `as_text` made a text of, if it is there; else that of the text itself."""
    path = Path(re.sub(r"\\udc([89a-f][0-9a-f])", lambda escaped: chr(0xDC00 + int(escaped[1], 16)), text))
    return path if os.path.lexists(path) else Path(text)
