"""Pieces of the page: text that is escaped, tables that can be sorted, pictures that are part of the page."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

import numpy as np

from metapp.evaluation.notes import title_of
from metapp.evaluation.rows import Row, Table
from metapp.evaluation.style import Drawn, png_of
from metapp.evaluation.subject import Subject
from metapp.runs.requests.naming import name_of
from metapp.storage.files import write_atomically
from metapp.storage.html import element, figure, image, table
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
    sides = ["left" if aligned else "" for _, aligned in head]
    titles = (
        element("th", element("button", escape(title)), scope="col", class_=side, aria_sort="none")
        for (title, _), side in zip(head, sides, strict=True)
    )
    rows = []
    for i, (name, *cells) in enumerate(body):
        first = element("th", escape(name), scope="row", class_=sides[0])
        others = (element("td", escape(text), class_=side) for text, side in zip(cells, sides[1:], strict=True))
        rows.append(element("tr", first, *others, class_=classes[i] if classes else ""))
    return scrolling(table([element("tr", *titles)], rows, caption, class_="sortable"))


def scrolling(content: str) -> str:
    """Something that may be wider than the page."""
    return element("div", content, class_="scroll")


def table_html(measured: Table, subject: Subject, rows: list[Row]) -> str:
    """A table with its caption, and notes below."""
    head = [(column.title, column.left) for column in measured.columns]
    body = [[column.text(row) for column in measured.columns] for row in rows]
    classes = [str(row["paradigm"]).partition(":")[0] for row in rows]
    sortable = sortable_html(head, body, title_of(measured, subject, rows), classes)
    return sortable + notes_html(measured.notes(subject, rows))


def notes_html(notes: Iterable[str]) -> str:
    """Texts in small type, a line each."""
    return element("ul", *(element("li", escape(note)) for note in notes), class_="notes")


def drawn_html(drawn: Drawn, name: str, pictures: Pictures, kind: str = "figure") -> str:
    """A figure that was drawn, with its caption."""
    picture = image(pictures.add(name, png_of(drawn.figure)), drawn.caption)
    return figure(picture, escape(drawn.caption), class_=kind)


def link_to(subject: Subject) -> str:
    """A link to an application's section."""
    return element("a", escape(subject.title), href=f"#{anchor(subject)}")


def anchor(subject: Subject) -> str:
    """The id of an application's section."""
    return identifier(name_of(subject.app))


def identifier(*parts: str) -> str:
    """A name that may be an id or part of a file's name."""
    return re.sub(r"[^A-Za-z0-9_-]+", "-", "-".join(filter(None, parts))).strip("-")
