"""Pieces of the page: text that is escaped, tables that can be sorted, pictures."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Sequence
from html import escape

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from metapp.evaluation.notes import title_of
from metapp.evaluation.rows import Row, Table
from metapp.evaluation.style import DPI, STYLE, Drawn
from metapp.evaluation.subject import Subject
from metapp.runs.requests.naming import name_of
from metapp.storage.html import element, figure, image, table
from metapp.storage.images import in_8_bits, png_address, png_bytes

LARGEST = 256  # px of a picture in the gallery


def png_of(figure: Figure) -> bytes:
    """A figure as a PNG."""
    buffer = io.BytesIO()
    with rc_context(STYLE):
        figure.savefig(buffer, format="png", dpi=DPI, metadata={"Software": None})
    return buffer.getvalue()


def gallery_address(srgb: np.ndarray) -> str:
    """The address of a picture of the gallery, of display values [H, W, 3] in [0, 1]."""
    picture = in_8_bits(srgb)
    picture.thumbnail((LARGEST, LARGEST))
    return png_address(png_bytes(picture, optimize=True))


def sortable_html(
    head: Sequence[tuple[str, bool]], body: Sequence[Sequence[str]], caption: str = "", classes: Sequence[str] = ()
) -> str:
    """A table that can be sorted.

    Args:
        head: title of each column, True where it is aligned left.
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


def drawn_html(drawn: Drawn, kind: str = "figure") -> str:
    """A figure that was drawn, with its caption."""
    picture = image(png_address(png_of(drawn.figure)), drawn.caption)
    return figure(picture, escape(drawn.caption), class_=kind)


def link_to(subject: Subject) -> str:
    """A link to an application's section."""
    return element("a", escape(subject.title), href=f"#{anchor(subject)}")


def anchor(subject: Subject) -> str:
    """The id of an application's section."""
    return re.sub(r"[^A-Za-z0-9_-]+", "-", name_of(subject.app)).strip("-")
