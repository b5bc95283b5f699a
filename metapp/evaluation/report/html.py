"""Pieces of the page: text that is escaped, tables that can be sorted, pictures that are part of the page."""

from __future__ import annotations

import re
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np

from metapp.evaluation.figures.style import Drawn, png_of
from metapp.evaluation.notes import title_of
from metapp.evaluation.rows import Row, Table
from metapp.evaluation.subject import Subject
from metapp.runs.naming import name_of
from metapp.storage.files import write_atomically
from metapp.storage.images import in_8_bits, png_address, png_bytes

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
        image = in_8_bits(srgb)
        image.thumbnail((LARGEST, LARGEST))
        return self.add(name, png_bytes(image, optimize=True))

    def place(self, page: str, folder: Path) -> str:
        """The page with the pictures' addresses: in the page itself, or, where they are too many, files beside it."""
        inside = sum(len(png) for png in self._files.values()) * 4 / 3 <= EMBEDDED

        def address(match: re.Match[str]) -> str:
            name, png = match[1], self._files[match[1]]
            if inside:
                return png_address(png)
            write_atomically(folder / "pictures" / f"{name}.png", lambda partial: partial.write_bytes(png))
            return f"pictures/{name}.png"

        return _TOKEN.sub(address, page)


def sortable_html(
    head: Sequence[tuple[str, bool]], body: Sequence[Sequence[str]], caption: str = "", classes: Sequence[str] = ()
) -> str:
    """A table that can be sorted.

    Args:
        head: title of each column, and whether it is aligned left.
        body: the cells of each row; the first one names it.
        caption: above it.
        classes: of each row, if any.
    """
    left = [' class="left"' if aligned else "" for _, aligned in head]
    titles = "".join(
        f'<th scope="col"{css} aria-sort="none"><button>{escape(title)}</button></th>'
        for (title, _), css in zip(head, left, strict=True)
    )
    rows = []
    for i, cells in enumerate(body):
        css = f' class="{escape(classes[i])}"' if classes else ""
        first, *rest = (f"{align}>{escape(text)}" for align, text in zip(left, cells, strict=True))
        rows.append(f'<tr{css}><th scope="row"{first}</th>' + "".join(f"<td{cell}</td>" for cell in rest) + "</tr>")
    top = f"<caption>{escape(caption)}</caption>" if caption else ""
    table = f'<table class="sortable">{top}<thead><tr>{titles}</tr></thead><tbody>{"".join(rows)}</tbody></table>'
    return f'<div class="scroll">{table}</div>'


def table_html(table: Table, subject: Subject, rows: list[Row]) -> str:
    """A table with its caption, and notes below."""
    head = [(column.title, column.left) for column in table.columns]
    body = [[column.text(row) for column in table.columns] for row in rows]
    classes = [str(row["paradigm"]).partition(":")[0] for row in rows]
    notes = "".join(f"<li>{escape(note)}</li>" for note in table.notes(subject, rows))
    return sortable_html(head, body, title_of(table, subject, rows), classes) + f'<ul class="notes">{notes}</ul>'


def details_html(summary: str, content: str) -> str:
    """Something that is shown at a click."""
    return f"<details><summary>{escape(summary)}</summary>{content}</details>"


def image_html(address: str, text: str) -> str:
    """A picture, and what it is to those who do not see it."""
    return f'<img loading="lazy" src="{address}" alt="{escape(text)}">'


def drawn_html(drawn: Drawn, name: str, pictures: Pictures, kind: str = "figure") -> str:
    """A figure that was drawn, with its caption."""
    image = image_html(pictures.add(name, png_of(drawn.figure)), drawn.caption)
    return f'<figure class="{kind}">{image}<figcaption>{escape(drawn.caption)}</figcaption></figure>'


def anchor(subject: Subject) -> str:
    """The id of an application's section."""
    return identifier(name_of(subject.app))


def identifier(*parts: str) -> str:
    """A name that may be an id or part of a file's name."""
    return re.sub(r"[^A-Za-z0-9_-]+", "-", "-".join(filter(None, parts))).strip("-")
