"""Pictures of runs: contact sheets of references and fits with their errors.

Pillow draws sheets: matplotlib, which figures are made by, takes longer to import than most fits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from torch import Tensor

from metapp.appearance.colour import to_srgb
from metapp.learning.app import App
from metapp.learning.task import Params, Task
from metapp.storage import Document
from metapp.storage.files import write_atomically
from metapp.storage.fits import read_params
from metapp.storage.images import in_8_bits

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
        error: below the last picture, if the row's name does not say it.
    """

    pictures: dict[str, np.ndarray]
    name: str
    error: str = ""


def write_sheet(tasks: list[Column], title: str, path: Path) -> Path:
    """Draw columns of pictures, COLUMNS beside each other; pictures that a task does not have stay blank.

    Returns:
        The file, a PNG.
    """
    from PIL import Image, ImageDraw, ImageFont

    small, large = (ImageFont.load_default(size) for size in (SMALL, LARGE))
    rows = _rows(tasks)
    height, width = _cell(tasks)
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
    """The names of all rows in order, the reference on top, also if the first task has none."""
    names = dict.fromkeys(name.partition(" ")[0] for task in tasks for name in task.pictures)
    return sorted(names, key=lambda name: name != "reference")


def _cell(tasks: list[Column]) -> tuple[int, int]:
    """Height and width of all pictures; wide ones hold several: they get more room."""
    rows, across = next(iter(tasks[0].pictures.values())).shape[:2]
    aspect = max(1.0, across / rows)
    width = SIDE * aspect**0.6
    return round(width * rows / across if rows <= across else SIDE), round(width)


def _shrunk(picture: np.ndarray, height: int, width: int) -> Image:
    from PIL.Image import Resampling

    return in_8_bits(picture).resize((width, height), Resampling.BICUBIC)


def image_of(linear: Tensor | np.ndarray) -> Image:
    """A linear picture as `to_srgb` takes it, in 8 bits of sRGB."""
    return in_8_bits(to_srgb(linear))


def _short(name: str, width: int, font: object) -> str:
    """The beginning of a name that is too long for its column."""
    length = font.getlength  # type: ignore[attr-defined]
    if length(name) <= width:
        return name
    kept = next(end for end in range(len(name), 0, -1) if end == 1 or length(name[:end] + "…") <= width)
    return name[:kept] + "…"


COMPARED = 20  # tasks in a picture of all paradigms
GIVEN = ("reference", "samples")  # pictures that are the task's, not of a fit
PICTURE = "picture"  # what is kept in place of parameters where there are none


def column_of_fit(app: App, task: Task, theta: Params, record: Document) -> Column:
    """The reference of a task above its fit, parameters without a task axis, and the error of its record."""
    return Column(_shown(app.preview(theta, task)), record["name"], _label(record))


def column_of(task: Task, fits: Sequence[tuple[str, App, Document]]) -> Column:
    """The reference or the samples of a task, and its fits below: (label, application, record) of each."""
    rows: dict[str, np.ndarray] = {}
    for label, app, record in fits:
        theta = read_params(record["folder"])
        pictures = {"fit": theta[PICTURE]} if PICTURE in theta else app.preview(theta, task)
        rows |= {} if rows else _shown({name: pictures[name] for name in GIVEN if name in pictures})
        rows[f"{label} {_label(record)}".rstrip()] = to_srgb(pictures["fit"])
    return Column(rows, task.name)


def write_compared(app: App, columns: list[Column], file: Path) -> Path:
    """Write columns of fits that are compared as one picture."""
    return write_sheet(columns, f"{app.full_title}: mean error{app.factor} of each fit below it", file)


def _label(record: Document) -> str:
    return "" if record["error"] is None else f"{record['error']:.3f}"


def _shown(pictures: Mapping[str, Tensor | np.ndarray]) -> dict[str, np.ndarray]:
    return {name: to_srgb(picture) for name, picture in pictures.items()}


def beside(images: Sequence[Image], height: int = 0) -> Image:
    """Pictures beside each other on white, each of a height in px; 0: as high as the first one."""
    from PIL import Image

    height = height or images[0].height
    resized = [image.resize((max(1, round(height * image.width / image.height)), height)) for image in images]
    strip = Image.new("RGB", (sum(image.width for image in resized) + 4 * (len(resized) - 1), height), "white")
    left = 0
    for image in resized:
        strip.paste(image, (left, 0))
        left += image.width + 4
    return strip
