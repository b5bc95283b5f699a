"""HTML of interactive pages: elements, and documents that need no network."""

from __future__ import annotations

import json
from html import escape
from pathlib import Path

from metapp.storage import Document
from metapp.storage.files import write_atomically

HEAD = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<link rel="icon" href="data:,">"""


def element(name: str, *content: str, **attributes: str) -> str:
    """An element.

    Args:
        name: of its tag.
        content: HTML.
        attributes: texts; those of "" are left out. In their names _ stands for -, but for one at the end: `class_`.
    """
    pairs = ((key.rstrip("_").replace("_", "-"), escape(text)) for key, text in attributes.items() if text)
    words = [name, *(f'{key}="{text}"' for key, text in pairs)]
    return f"<{' '.join(words)}>{''.join(content)}</{name}>"


def data_script(name: str, document: Document) -> str:
    """A JSON document that a script of the page reads as the element `name`.

    Raises:
        ValueError: a number is not finite.
    """
    content = json.dumps(document, allow_nan=False).replace("<", "\\u003c")  # no text can end the script
    return element("script", content, type="application/json", id=name)


def page(title: str, style: str, *body: str) -> str:
    """A whole document.

    Args:
        title: text.
        style: CSS.
        body: HTML, a line each.
    """
    head = "\n".join([HEAD, element("title", escape(title)), element("style", style), "</head>"])
    return "\n".join([head, "<body>", *body, "</body>", "</html>", ""])


def write_page(text: str, path: Path) -> Path:
    """Write a document, whole or not at all.

    Returns:
        The file.

    Raises:
        OSError: it cannot be written.
    """
    write_atomically(path, lambda partial: partial.write_text(text, encoding="utf-8", errors="backslashreplace"))
    return path
