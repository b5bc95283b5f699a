"""Pieces of the page: text that is escaped, tables that can be sorted, pictures that are part of the page."""

from __future__ import annotations

import base64
import io
import re
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from metapp.evaluation.figures import Drawn
from metapp.evaluation.formats import title_of
from metapp.evaluation.rows import Row, Table
from metapp.evaluation.subject import Subject
from metapp.runs.naming import name_of
from metapp.storage.files import write_atomically

EMBEDDED = 14_000_000  # bytes of pictures up to which they are part of the page; else they lie beside it
LARGEST = 256  # px of a picture in the gallery
_TOKEN = re.compile(r"\{\{picture:([^}]+)\}\}")


class Pictures:
    """The pictures of a page: collected first, as where they end up depends on how many bytes all have."""

    def __init__(self) -> None:
        self._files: dict[str, bytes] = {}

    def add(self, name: str, png: bytes) -> str:
        """Keep a PNG; what stands for its address until `place`."""
        self._files[name] = png
        return f"{{{{picture:{name}}}}}"

    def add_array(self, name: str, srgb: np.ndarray) -> str:
        """Keep display values [H, W, 3] in [0, 1]."""
        from PIL import Image  # matplotlib brings it

        image = Image.fromarray((np.clip(srgb, 0, 1) * 255 + 0.5).astype(np.uint8))
        image.thumbnail((LARGEST, LARGEST))
        buffer = io.BytesIO()
        image.save(buffer, "PNG", optimize=True)
        return self.add(name, buffer.getvalue())

    def place(self, page: str, folder: Path) -> str:
        """The page with the pictures' addresses: in the page itself, or, where they are too many, files beside it."""
        inside = sum(len(png) for png in self._files.values()) * 4 / 3 <= EMBEDDED

        def address(match: re.Match[str]) -> str:
            name, png = match[1], self._files[match[1]]
            if inside:
                return f"data:image/png;base64,{base64.b64encode(png).decode()}"
            write_atomically(folder / "pictures" / f"{name}.png", lambda partial: partial.write_bytes(png))
            return f"pictures/{name}.png"

        return _TOKEN.sub(address, page)


def table_html(table: Table, subject: Subject, rows: list[Row]) -> str:
    """A table with its caption, and notes below."""
    head = "".join(
        f'<th scope="col"{_left(column.left)} aria-sort="none"><button>{escape(column.title)}</button></th>'
        for column in table.columns
    )
    body = "".join(
        f'<tr class="{escape(str(row["paradigm"]).partition(":")[0])}">'
        + "".join(_cell(i, column.text(row), column.left) for i, column in enumerate(table.columns))
        + "</tr>"
        for row in rows
    )
    notes = "".join(f"<li>{escape(note)}</li>" for note in table.notes(subject, rows))
    caption = escape(title_of(table, subject, rows))
    return (
        f'<div class="scroll"><table class="sortable"><caption>{caption}</caption><thead><tr>{head}</tr></thead>'
        f'<tbody>{body}</tbody></table></div><ul class="notes">{notes}</ul>'
    )


def _cell(i: int, text: str, left: bool) -> str:
    tag = 'th scope="row"' if i == 0 else "td"
    return f"<{tag}{_left(left)}>{escape(text)}</{tag.partition(' ')[0]}>"


def _left(left: bool) -> str:
    return ' class="left"' if left else ""


def figure_html(address: str, caption: str, kind: str = "figure") -> str:
    """A figure; its caption is what it says to those who do not see it."""
    said = escape(caption)
    image = f'<img loading="lazy" src="{address}" alt="{said}">'
    return f'<figure class="{kind}">{image}<figcaption>{said}</figcaption></figure>'


def drawn_html(drawn: Drawn, name: str, pictures: Pictures, kind: str = "figure") -> str:
    """A figure that was drawn."""
    from metapp.evaluation.figures.style import png_of

    return figure_html(pictures.add(name, png_of(drawn.figure)), drawn.caption, kind)


def anchor(subject: Subject) -> str:
    """The id of an application's section."""
    return identifier(name_of(subject.app))


def identifier(*parts: Any) -> str:
    """A name that may be an id or part of a file's name."""
    return re.sub(r"[^A-Za-z0-9_-]+", "-", "-".join(str(part) for part in parts if str(part))).strip("-")
