"""Pictures of runs: contact sheets of references and fits with their errors.

Pillow draws sheets: matplotlib, which figures are made by, takes longer to import than most fits.
"""

from __future__ import annotations

import importlib.util
import io
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from PIL import Image as pil
from PIL import ImageDraw, ImageFont
from PIL.Image import Image
from PIL.PngImagePlugin import PngInfo
from torch import Tensor

from metapp.appearance.colour import composite_to_srgb
from metapp.appearance.presenter import Presenter
from metapp.learning.task import Params, Task
from metapp.storage import Document
from metapp.storage.files import PARTIAL_PREFIX, read_bytes, write_atomically
from metapp.storage.fit_folders import read_params
from metapp.storage.image_writers import to_8_bit_image
from metapp.storage.parameters import check_params

SHEET_FILE_NAME = "pictures.png"  # of a run, in its folder
ROW_MARKS_KEY = (
    "metapp rows"  # the text of a PNG that says where rows are: [name, first line, line after the last] of each
)
MAX_SHEET_PIXELS = 2**26  # of a sheet that is read
MAX_SHEET_ROWS = 8  # tasks in a picture; a line says how many more there are
TILE_PX = 256  # px, of a square picture; a wide one has a height of it, and twice its width at most
GAP_PX = 8
SMALL_LETTER_PX, LARGE_LETTER_PX = 14, 18  # px, of letters
REFERENCE_PREFIX = "reference "  # begins the name of a picture that stands below that of the fit
FONT_PATH = (
    "mpl-data/fonts/ttf/DejaVuSans.ttf"  # in matplotlib, whose import takes too long; Pillow's own lacks umlauts
)


class Tiles(NamedTuple):
    """The pictures of a task, beside each other.

    Attributes:
        pictures: display values [H, W, 3] in [0, 1] by name; "reference X" stands below X.
        name: of the task.
        errors: below a picture, by its name; "" of the task's own, after its name.
    """

    pictures: dict[str, np.ndarray]
    name: str
    errors: Mapping[str, str] = MappingProxyType({})


class SheetRow(NamedTuple):
    """The row of a fit in a sheet that is there, as it was drawn.

    Attributes:
        name: of the fit's folder.
        picture: the row, as wide as its sheet.
    """

    name: str
    picture: Image


def write_contact_sheet(
    tasks: list[Tiles],
    title: str,
    path: Path,
    count: int = 0,
    names: Sequence[str] = (),
    earlier: Sequence[SheetRow] = (),
) -> Path:
    """Draw the pictures of ROWS tasks below each other, all of a name in one column; the others stay blank.

    Args:
        tasks: one or more.
        title: above them.
        path: the file, a PNG.
        count: of all tasks, if there are more.
        names: of the tasks' folders, by which `read_rows` names their rows; none if nobody reads them.
        earlier: rows of another sheet, which follow as far as there is room.

    Returns:
        The file.
    """
    small, large = _font(SMALL_LETTER_PX), _font(LARGE_LETTER_PX)
    drawn = tasks[:MAX_SHEET_ROWS]
    left, lefts = GAP_PX, {}
    for name, width in _widths(drawn).items():
        lefts[name], left = left, left + width + GAP_PX
    tops, top = [], LARGE_LETTER_PX + 3 * GAP_PX
    line = TILE_PX + SMALL_LETTER_PX + 2 * GAP_PX
    for task in drawn:
        tops.append(top)
        top += (
            SMALL_LETTER_PX + 2 * GAP_PX + line * (1 + any(name.startswith(REFERENCE_PREFIX) for name in task.pictures))
        )
    kept, marks = list(earlier)[: MAX_SHEET_ROWS - len(drawn)], list(zip(names, tops, [*tops[1:], top], strict=False))
    more = max(count, len(tasks)) - len(drawn) - len(kept)
    whole = max(left, round(large.getlength(title)) + 2 * GAP_PX, *(row.picture.width for row in kept))
    below = top
    for row in kept:
        marks.append((row.name, top, top + row.picture.height))
        top += row.picture.height
    sheet = pil.new("RGB", (whole, top + (LARGE_LETTER_PX + GAP_PX) * (more > 0)), "white")
    for row in kept:
        sheet.paste(row.picture, (0, below))
        below += row.picture.height
    draw = ImageDraw.Draw(sheet)
    draw.text((GAP_PX, GAP_PX), title, "black", large)
    for task, y in zip(drawn, tops, strict=True):
        heading = ": ".join(filter(None, (task.name, task.errors.get("", ""))))
        draw.text((GAP_PX, y), _short(heading, whole - 2 * GAP_PX, small), "black", small)
        for name, picture in task.pictures.items():
            of = name.removeprefix(REFERENCE_PREFIX)
            at = y + SMALL_LETTER_PX + GAP_PX + line * (of != name)
            tile = _shrunk(picture)
            sheet.paste(tile, (lefts[of], at))
            caption = f"{name.replace('_', ' ')} {task.errors.get(name, '')}"
            draw.text((lefts[of], at + tile.height + 2), _short(caption, tile.width, small), "black", small)
    if more > 0:
        draw.text((GAP_PX, top), f"and {more:,} more task{'s' * (more > 1)}", "black", large)
    texts = PngInfo()
    texts.add_text(ROW_MARKS_KEY, json.dumps(marks))
    write_atomically(path, lambda target: sheet.save(target, "PNG", pnginfo=texts if marks else None))
    return path


def read_rows(path: Path) -> list[SheetRow]:
    """The rows of a sheet that `write_contact_sheet` wrote; none of a file that is missing, damaged or another picture."""
    try:
        with pil.open(io.BytesIO(read_bytes(path)), formats=["PNG"]) as sheet:
            marks = [
                (str(name), int(top), int(end))
                for name, top, end in json.loads(sheet.info[ROW_MARKS_KEY])[:MAX_SHEET_ROWS]
            ]
            tall = sheet.width * sheet.height > MAX_SHEET_PIXELS
            if tall or any(not 0 <= top < end <= sheet.height for _, top, end in marks):
                return []
            return [SheetRow(name, sheet.convert("RGB").crop((0, top, sheet.width, end))) for name, top, end in marks]
    except (OSError, ValueError, KeyError, TypeError, SyntaxError, RecursionError, pil.DecompressionBombError):
        return []


def add_to_sheet(tiles: Mapping[str, Tiles], title: str, run_folder: Path) -> Path:
    """Write `pictures.png` of a run's folder: fits of now, then those of before that its sheet shows, up to ROWS.

    Args:
        tiles: of fits of now, by the names of their folders, one or more.
        title: above them.
        run_folder: of the run.
    """
    folders = {
        entry.name for entry in os.scandir(run_folder) if entry.is_dir() and not entry.name.startswith(PARTIAL_PREFIX)
    }
    earlier = [row for row in read_rows(run_folder / SHEET_FILE_NAME) if row.name in folders - tiles.keys()]
    return write_contact_sheet([*tiles.values()], title, run_folder / SHEET_FILE_NAME, len(folders), [*tiles], earlier)


def _font(size: int) -> ImageFont.FreeTypeFont:
    package = importlib.util.find_spec("matplotlib")
    assert package is not None
    assert package.origin is not None
    return ImageFont.truetype(Path(package.origin).parent / FONT_PATH, size)


def _widths(tasks: list[Tiles]) -> dict[str, int]:
    """The columns by name, in order, reference and photo first, and their widths."""
    widths: dict[str, int] = {}
    for task in tasks:
        for name, picture in task.pictures.items():
            of = name.removeprefix(REFERENCE_PREFIX)
            widths[of] = max(widths.get(of, 0), _size(picture)[1])
    return dict(sorted(widths.items(), key=lambda item: item[0] not in TASK_PICTURE_NAMES))


def _size(picture: np.ndarray) -> tuple[int, int]:
    """Height and width of a tile."""
    rows, across = picture.shape[:2]
    scale = min(TILE_PX / rows, 2 * TILE_PX / across)
    return max(1, round(rows * scale)), max(1, round(across * scale))


def _shrunk(picture: np.ndarray) -> Image:
    height, width = _size(picture)
    return to_8_bit_image(picture).resize((width, height), pil.Resampling.BICUBIC)


def srgb_image(linear: Tensor | np.ndarray) -> Image:
    """A linear picture as `composite_to_srgb` takes it, in 8 bits of sRGB."""
    return to_8_bit_image(composite_to_srgb(linear))


def _short(text: str, width: int, font: ImageFont.FreeTypeFont) -> str:
    """The beginning of a text that is too long for its place."""
    length = font.getlength
    if length(text) <= width:
        return text
    kept = next(end for end in range(len(text), 0, -1) if end == 1 or length(text[:end] + "…") <= width)
    return text[:kept] + "…"


TASK_PICTURE_NAMES = ("reference", "photo", "samples")  # pictures that are the task's, not of a fit
PICTURE_KEY = "picture"  # what is kept in place of parameters where there are none


def tiles_of_fit(presenter: Presenter[Any], task: Task, theta: Params, record: Document) -> Tiles:
    """The pictures of a fit, parameters without a task axis, and the error of its record."""
    return Tiles(_shown(presenter.tiles(theta, task)), record["name"], {"": _label(record, "error ")})


def tiles_of_methods(task: Task, fits: Sequence[tuple[str, Presenter[Any], Document]]) -> Tiles:
    """The reference or the samples of a task, and its fits: (label, presenter, record) of each."""
    tiles: dict[str, np.ndarray] = {}
    for label, presenter, record in fits:
        theta = read_params(record["folder"])
        if PICTURE_KEY not in theta:
            check_params(theta, presenter.app, record["folder"])
        pictures = {"fit": theta[PICTURE_KEY]} if PICTURE_KEY in theta else presenter.preview(theta, task)
        tiles |= {} if tiles else _shown({name: pictures[name] for name in TASK_PICTURE_NAMES if name in pictures})
        tiles[label] = composite_to_srgb(pictures["fit"])
    return Tiles(tiles, task.name, {label: _label(record) for label, _, record in fits})


def write_comparison_sheet(presenter: Presenter[Any], tasks: list[Tiles], file: Path) -> Path:
    """Write fits that are compared as one picture."""
    return write_contact_sheet(
        tasks, f"{presenter.title}: mean error{presenter.app.error_measure.factor} of each fit below it", file
    )


def _label(record: Document, before: str = "") -> str:
    if record["error"] is not None:
        return f"{before}{record['error']:.3f}"
    return f"|fit - photo| {record['photo_error']:.2f} %" if "photo_error" in record else ""


def _shown(pictures: Mapping[str, Tensor | np.ndarray]) -> dict[str, np.ndarray]:
    return {name: composite_to_srgb(picture) for name, picture in pictures.items()}


def place_side_by_side(images: Sequence[Image], height: int = 0) -> Image:
    """Pictures beside each other on white, each of a height in px; 0: as high as the first one."""
    height = height or images[0].height
    resized = [image.resize((max(1, round(height * image.width / image.height)), height)) for image in images]
    strip = pil.new("RGB", (sum(image.width for image in resized) + 4 * (len(resized) - 1), height), "white")
    left = 0
    for image in resized:
        strip.paste(image, (left, 0))
        left += image.width + 4
    return strip
