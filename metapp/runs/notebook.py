"""What notebooks show of fits: HTML that holds its pictures, on a light and on a dark page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from metapp.learning.app import App
from metapp.runs.naming import factor_of, title_of
from metapp.runs.reporter import number
from metapp.storage.images import png_address, png_bytes

if TYPE_CHECKING:
    from PIL.Image import Image

LARGE, SMALL = 192, 96  # px, the height of fit and reference, and of other pictures
LINE = "margin:.3em 0"
WARNING = "margin:.3em 0;padding-left:.6em;border-left:3px solid #d08700"


def card_of(name: str, about: str, images: Mapping[str, Image], facts: str, warning: str, page: Path | None) -> str:
    """One fit: its name and what it is, its pictures, and lines below them; a link to its page, if there is one."""
    main = {key: image for key, image in images.items() if key in ("reference", "fit")}
    others = {key: image for key, image in images.items() if key not in main}
    lines = [
        f"<div style='{LINE}'><b>{escape(name)}</b> &ensp;{escape(about)}</div>",
        *(_row(each, height) for each, height in ((main, LARGE), (others, SMALL)) if each),
        f"<div style='{LINE}'>{escape(facts)}</div>",
        *([f"<div style='{LINE}'><a href='{quote(str(page))}'>interactive page</a></div>"] if page else []),
        *([f"<div style='{WARNING}'>warning: {escape(warning)}</div>"] if warning else []),
    ]
    return f"<div>{''.join(lines)}</div>"


def _row(images: Mapping[str, Image], height: int) -> str:
    figures = (
        "<figure style='display:inline-block;margin:0 .5em .3em 0;vertical-align:top'>"
        f"<img src='{_address(image, 2 * height)}' alt='{escape(name)}' "
        f"style='height:{height}px;max-width:none;margin:0;display:block'>"
        f"<figcaption style='font-size:.85em;opacity:.8'>{escape(name.replace('_', ' '))}</figcaption></figure>"
        for name, image in images.items()
    )
    return f"<div>{''.join(figures)}</div>"


def _address(image: Image, highest: int) -> str:
    """The address of a picture, made no higher than so many px: screens may have two for one of a page."""
    if image.height > highest:
        image = image.resize((max(1, round(image.width * highest / image.height)), highest))
    return png_address(png_bytes(image))


def table_of(rows: Sequence[tuple[str, float | None, float, str]], app: App | None) -> str:
    """Several fits, as name, error, seconds and warning."""
    if app is None:
        return "<div>no fits</div>"
    titles = ("", f"error{factor_of(app)}", "seconds", "warning" if any(row[3] for row in rows) else "")
    shown = ((name, number(error, ".3f"), f"{seconds:.3g}", told) for name, error, seconds, told in rows)
    lines = [f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in shown]
    head = "".join(f"<th>{title}</th>" for title in titles)
    return f"<div>{escape(title_of(app))}: {len(rows)} fits<table><tr>{head}</tr>{''.join(lines)}</table></div>"
