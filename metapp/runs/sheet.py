"""Contact sheets: pictures of tasks, a column each, with names of rows and errors.

Pillow draws them: matplotlib, which figures are made by, takes longer to import than most fits.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from metapp.storage.files import write_atomically

if TYPE_CHECKING:
    from PIL.Image import Image

COLUMNS = 10
SIDE = 150  # px, of a square picture
GAP = 6
SMALL, LARGE = 11, 15  # px, of letters


class Column(NamedTuple):
    """A task.

    Attributes:
        pictures: display values [H, W, 3] in [0, 1] by the row's name, which may go on with an error after a space.
        name: of the task.
        error: below the last picture, where the row's name does not say it.
    """

    pictures: dict[str, np.ndarray]
    name: str
    error: str = ""


def write_sheet(tasks: list[Column], title: str, path: Path, side: int = SIDE) -> Path:
    """Draw columns of pictures, COLUMNS beside each other; what a task does not have stays blank.

    A square picture has `side` px.

    Returns:
        The file, a PNG.
    """
    from PIL import Image, ImageDraw, ImageFont

    small, large = (ImageFont.load_default(size) for size in (SMALL, LARGE))
    rows = _rows(tasks)
    height, width = _cell(tasks, side)
    step = height + SMALL + GAP  # an error may stand below each picture
    left = 2 * GAP + max(round(small.getlength(row)) for row in rows)
    columns = min(COLUMNS, len(tasks))
    block = step * len(rows) + 2 * (SMALL + GAP)
    top = LARGE + 3 * GAP
    whole = max(left + columns * (width + GAP), round(large.getlength(title)) + 2 * GAP)
    sheet = Image.new("RGB", (whole, top + block * -(-len(tasks) // COLUMNS)), "white")
    draw = ImageDraw.Draw(sheet)
    draw.text((whole / 2, GAP), title, "black", large, "ma")
    for i, task in enumerate(tasks):
        x, y = left + i % COLUMNS * (width + GAP), top + i // COLUMNS * block
        middle = x + width / 2
        for name, picture in task.pictures.items():
            row, _, error = name.partition(" ")
            at = y + rows.index(row) * step
            sheet.paste(_shrunk(picture, height, width), (x, at))
            draw.text((middle, at + height + 2), error, "black", small, "ma")
        if i % COLUMNS == 0:
            for k, row in enumerate(rows):
                draw.text((GAP, y + k * step + height / 2), row, "black", small, "lm")
        below = y + step * len(rows) - (SMALL + 2 if task.error else 0)
        for line, text in enumerate(filter(None, (task.error, _short(task.name, width, small)))):
            draw.text((middle, below + line * (SMALL + 4)), text, "black", small, "ma")
    write_atomically(path, lambda target: sheet.save(target, "PNG"))
    return path


def _rows(tasks: list[Column]) -> list[str]:
    """The names of all rows in order, the reference on top, also where the first task has none."""
    found = dict.fromkeys(name.partition(" ")[0] for task in tasks for name in task.pictures)
    return sorted(found, key=lambda name: name != "reference")


def _cell(tasks: list[Column], side: int) -> tuple[int, int]:
    """Height and width of all pictures; wide ones hold several: they get more room."""
    rows, across = next(iter(tasks[0].pictures.values())).shape[:2]
    aspect = max(1.0, across / rows)
    width = side * aspect**0.6
    return round(width * rows / across if rows <= across else side), round(width)


def _shrunk(picture: np.ndarray, height: int, width: int) -> Image:
    from PIL import Image

    pixels = (np.clip(picture, 0, 1) * 255 + 0.5).astype(np.uint8)
    return Image.fromarray(pixels).resize((width, height), Image.Resampling.BICUBIC)


def _short(name: str, width: int, font: object) -> str:
    """The beginning of a name that is too long for its column."""
    length = font.getlength  # type: ignore[attr-defined]
    if length(name) <= width:
        return name
    kept = next(end for end in range(len(name), 0, -1) if end == 1 or length(name[:end] + "…") <= width)
    return name[:kept] + "…"
