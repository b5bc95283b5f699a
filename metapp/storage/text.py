"""Texts as UTF-8 holds them, names that files may have, and JSON documents of them, which anybody may have written.

File names may have bytes that are no UTF-8, which Python passes on as lone surrogates.
"""

from __future__ import annotations

import difflib
import hashlib
import json
import os
import re
import unicodedata
from collections.abc import Iterable
from pathlib import Path
from typing import Any

LONGEST = 100  # bytes of a name; file systems take 255, of which suffixes and temporary names need some


def meant(word: str, names: Iterable[str]) -> str:
    """A question after an error about a word that is no name, where some names begin so or one is like it; else ""."""
    choices = list(names)
    near = [name for name in choices if word and name.startswith(word)] or difflib.get_close_matches(word, choices, 1)
    return f" Did you mean {' or '.join(map(repr, near))}?" if near else ""


def entry_of(document: object, key: str, kind: type, where: str, remedy: str, absent: object = None) -> Any:
    """An entry of a JSON object; `absent` where there is none.

    Raises:
        ValueError: it is of another type; the message begins with `where` and ends with the remedy.
    """
    value = document.get(key, absent) if isinstance(document, dict) else None
    if not isinstance(value, kind) or isinstance(value, bool):
        raise ValueError(f"{where}'{key}' is {json.dumps(value)[:60]}, expected {_KINDS[kind]}; {remedy}.")
    return value


_KINDS = {int: "a whole number", str: "text", list: "a list", dict: "an object"}


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


def safe_name(name: str) -> str:
    """A name that can be printed and drawn, of LONGEST bytes at most; others get a digest of what they were.

    Control characters, line ends and bytes that are no text (lone surrogates) become underscores.
    """
    return _marked("".join("_" if unicodedata.category(c)[0] == "C" or c in "\u2028\u2029" else c for c in name), name)


def file_name(task: str) -> str:
    """A task's name as a file name: letters, digits, dot, underscore and hyphen, the rest as underscores.

    It has LONGEST bytes at most; one that differs from the task's name ends with a digest of that.
    """
    return _marked("".join(c if c.isalnum() or c in "._-" else "_" for c in task).lstrip(".") or "task", task)


def _marked(safe: str, name: str) -> str:
    """`safe` where it is the name itself and short, else with a digest of the name."""
    if safe == name and len(safe.encode()) <= LONGEST:
        return safe
    mark = hashlib.sha256(name.encode(errors="surrogatepass")).hexdigest()[:6]
    return f"{safe.encode()[: LONGEST - 7].decode(errors='ignore')}-{mark}"
