"""The view of fits in notebooks: HTML that holds its pictures, on a light and on a dark page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING

from metapp.learning.app import App
from metapp.runs.reporter import number
from metapp.runs.requests.naming import factor_of, title_of
from metapp.storage import html
from metapp.storage.html import element
from metapp.storage.images import png_address, png_bytes

if TYPE_CHECKING:
    from PIL.Image import Image

LARGE, SMALL = 192, 96  # px, the height of fit and reference, and of other pictures
LINE = "margin:.3em 0"
FIGURE = "display:inline-block;margin:0 .5em .3em 0;vertical-align:top;font-size:.85em"
WARNING = "margin:.3em 0;padding-left:.6em;border-left:3px solid #d08700"


def card_of(name: str, about: str, images: Mapping[str, Image], facts: str, warning: str) -> str:
    """One fit: its name and what it is, its pictures, and lines below them."""
    main = {key: image for key, image in images.items() if key in ("reference", "fit")}
    others = {key: image for key, image in images.items() if key not in main}
    lines = [
        element("div", element("b", escape(name)), f" &ensp;{escape(about)}", style=LINE),
        *(_row(each, height) for each, height in ((main, LARGE), (others, SMALL)) if each),
        element("div", escape(facts), style=LINE),
        element("div", escape(f"warning: {warning}"), style=WARNING) if warning else "",
    ]
    return element("div", *lines)


def _row(images: Mapping[str, Image], height: int) -> str:
    sized = f"height:{height}px;max-width:none;margin:0;display:block"
    figures = (
        html.figure(
            html.image(_address(each, 2 * height), name, style=sized), escape(name.replace("_", " ")), style=FIGURE
        )
        for name, each in images.items()
    )
    return element("div", *figures)


def _address(image: Image, highest: int) -> str:
    """The address of a picture, made no higher than so many px: screens may have two for one of a page."""
    if image.height > highest:
        image = image.resize((max(1, round(image.width * highest / image.height)), highest))
    return png_address(png_bytes(image))


def table_of(rows: Sequence[tuple[str, float | None, float, str]], app: App | None) -> str:
    """Several fits, as name, error, seconds and warning."""
    if app is None:
        return element("div", "no fits")
    titles = ("", f"error{factor_of(app)}", "seconds", "warning" if any(warning for *_, warning in rows) else "")
    body = [html.row((name, number(error, ".3f"), f"{seconds:.3g}", told)) for name, error, seconds, told in rows]
    return element("div", escape(f"{title_of(app)}, fits: {len(rows)}"), html.table([html.row(titles, "th")], body))
