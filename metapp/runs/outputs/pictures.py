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

from metapp.appearance.colour import to_srgb
from metapp.appearance.presenter import Presenter
from metapp.learning.task import Params, Task
from metapp.storage import Document
from metapp.storage.files import PARTIAL, read_bytes, write_atomically
from metapp.storage.fits import read_params
from metapp.storage.images import in_8_bits
from metapp.storage.parameters import check_params

SHEET = "pictures.png"  # of a run, in its folder
MARKS = "metapp rows"  # the text of a PNG that says where rows are: [name, first line, line after the last] of each
MOST_PIXELS = 2**26  # of a sheet that is read
ROWS = 8  # tasks in a picture; a line says how many more there are
SIDE = 256  # px, of a square picture; a wide one has a height of it, and twice its width at most
GAP = 8
SMALL, LARGE = 14, 18  # px, of letters
REFERENCE = "reference "  # begins the name of a picture that stands below that of the fit
FONT = "mpl-data/fonts/ttf/DejaVuSans.ttf"  # in matplotlib, whose import takes too long; Pillow's own lacks umlauts


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


class Row(NamedTuple):
    """The row of a fit in a sheet that is there, as it was drawn.

    Attributes:
        name: of the fit's folder.
        picture: the row, as wide as its sheet.
    """

    name: str
    picture: Image


def write_sheet(
    tasks: list[Tiles], title: str, path: Path, count: int = 0, names: Sequence[str] = (), earlier: Sequence[Row] = ()
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
    small, large = _font(SMALL), _font(LARGE)
    drawn = tasks[:ROWS]
    left, lefts = GAP, {}
    for name, width in _widths(drawn).items():
        lefts[name], left = left, left + width + GAP
    tops, top = [], LARGE + 3 * GAP
    line = SIDE + SMALL + 2 * GAP
    for task in drawn:
        tops.append(top)
        top += SMALL + 2 * GAP + line * (1 + any(name.startswith(REFERENCE) for name in task.pictures))
    kept, marks = list(earlier)[: ROWS - len(drawn)], list(zip(names, tops, [*tops[1:], top], strict=False))
    more = max(count, len(tasks)) - len(drawn) - len(kept)
    whole = max(left, round(large.getlength(title)) + 2 * GAP, *(row.picture.width for row in kept))
    below = top
    for row in kept:
        marks.append((row.name, top, top + row.picture.height))
        top += row.picture.height
    sheet = pil.new("RGB", (whole, top + (LARGE + GAP) * (more > 0)), "white")
    for row in kept:
        sheet.paste(row.picture, (0, below))
        below += row.picture.height
    draw = ImageDraw.Draw(sheet)
    draw.text((GAP, GAP), title, "black", large)
    for task, y in zip(drawn, tops, strict=True):
        heading = ": ".join(filter(None, (task.name, task.errors.get("", ""))))
        draw.text((GAP, y), _short(heading, whole - 2 * GAP, small), "black", small)
        for name, picture in task.pictures.items():
            of = name.removeprefix(REFERENCE)
            at = y + SMALL + GAP + line * (of != name)
            tile = _shrunk(picture)
            sheet.paste(tile, (lefts[of], at))
            caption = f"{name.replace('_', ' ')} {task.errors.get(name, '')}"
            draw.text((lefts[of], at + tile.height + 2), _short(caption, tile.width, small), "black", small)
    if more > 0:
        draw.text((GAP, top), f"and {more:,} more task{'s' * (more > 1)}", "black", large)
    texts = PngInfo()
    texts.add_text(MARKS, json.dumps(marks))
    write_atomically(path, lambda target: sheet.save(target, "PNG", pnginfo=texts if marks else None))
    return path


def read_rows(path: Path) -> list[Row]:
    """The rows of a sheet that `write_sheet` wrote; none of a file that is missing, damaged or another picture."""
    try:
        with pil.open(io.BytesIO(read_bytes(path)), formats=["PNG"]) as sheet:
            marks = [(str(name), int(top), int(end)) for name, top, end in json.loads(sheet.info[MARKS])[:ROWS]]
            tall = sheet.width * sheet.height > MOST_PIXELS
            if tall or any(not 0 <= top < end <= sheet.height for _, top, end in marks):
                return []
            return [Row(name, sheet.convert("RGB").crop((0, top, sheet.width, end))) for name, top, end in marks]
    except (OSError, ValueError, KeyError, TypeError, SyntaxError, RecursionError, pil.DecompressionBombError):
        return []


def add_to_sheet(tiles: Mapping[str, Tiles], title: str, run_folder: Path) -> Path:
    """Write `pictures.png` of a run's folder: fits of now, then those of before that its sheet shows, up to ROWS.

    Args:
        tiles: of fits of now, by the names of their folders, one or more.
        title: above them.
        run_folder: of the run.
    """
    folders = {entry.name for entry in os.scandir(run_folder) if entry.is_dir() and not entry.name.startswith(PARTIAL)}
    earlier = [row for row in read_rows(run_folder / SHEET) if row.name in folders - tiles.keys()]
    return write_sheet([*tiles.values()], title, run_folder / SHEET, len(folders), [*tiles], earlier)


def _font(size: int) -> ImageFont.FreeTypeFont:
    package = importlib.util.find_spec("matplotlib")
    assert package is not None
    assert package.origin is not None
    return ImageFont.truetype(Path(package.origin).parent / FONT, size)


def _widths(tasks: list[Tiles]) -> dict[str, int]:
    """The columns by name, in order, reference and photo first, and their widths."""
    widths: dict[str, int] = {}
    for task in tasks:
        for name, picture in task.pictures.items():
            of = name.removeprefix(REFERENCE)
            widths[of] = max(widths.get(of, 0), _size(picture)[1])
    return dict(sorted(widths.items(), key=lambda item: item[0] not in GIVEN))


def _size(picture: np.ndarray) -> tuple[int, int]:
    """Height and width of a tile."""
    rows, across = picture.shape[:2]
    scale = min(SIDE / rows, 2 * SIDE / across)
    return max(1, round(rows * scale)), max(1, round(across * scale))


def _shrunk(picture: np.ndarray) -> Image:
    height, width = _size(picture)
    return in_8_bits(picture).resize((width, height), pil.Resampling.BICUBIC)


def image_of(linear: Tensor | np.ndarray) -> Image:
    """A linear picture as `to_srgb` takes it, in 8 bits of sRGB."""
    return in_8_bits(to_srgb(linear))


def _short(text: str, width: int, font: ImageFont.FreeTypeFont) -> str:
    """The beginning of a text that is too long for its place."""
    length = font.getlength
    if length(text) <= width:
        return text
    kept = next(end for end in range(len(text), 0, -1) if end == 1 or length(text[:end] + "…") <= width)
    return text[:kept] + "…"


GIVEN = ("reference", "photo", "samples")  # pictures that are the task's, not of a fit
PICTURE = "picture"  # what is kept in place of parameters where there are none


def tiles_of_fit(presenter: Presenter[Any], task: Task, theta: Params, record: Document) -> Tiles:
    """The pictures of a fit, parameters without a task axis, and the error of its record."""
    return Tiles(_shown(presenter.tiles(theta, task)), record["name"], {"": _label(record, "error ")})


def tiles_of(task: Task, fits: Sequence[tuple[str, Presenter[Any], Document]]) -> Tiles:
    """The reference or the samples of a task, and its fits: (label, presenter, record) of each."""
    tiles: dict[str, np.ndarray] = {}
    for label, presenter, record in fits:
        theta = read_params(record["folder"])
        if PICTURE not in theta:
            check_params(theta, presenter.app, record["folder"])
        pictures = {"fit": theta[PICTURE]} if PICTURE in theta else presenter.preview(theta, task)
        tiles |= {} if tiles else _shown({name: pictures[name] for name in GIVEN if name in pictures})
        tiles[label] = to_srgb(pictures["fit"])
    return Tiles(tiles, task.name, {label: _label(record) for label, _, record in fits})


def write_compared(presenter: Presenter[Any], tasks: list[Tiles], file: Path) -> Path:
    """Write fits that are compared as one picture."""
    return write_sheet(
        tasks, f"{presenter.title}: mean error{presenter.app.error_measure.factor} of each fit below it", file
    )


def _label(record: Document, before: str = "") -> str:
    if record["error"] is not None:
        return f"{before}{record['error']:.3f}"
    return f"|fit - photo| {record['photo_error']:.2f} %" if "photo_error" in record else ""


def _shown(pictures: Mapping[str, Tensor | np.ndarray]) -> dict[str, np.ndarray]:
    return {name: to_srgb(picture) for name, picture in pictures.items()}


def beside(images: Sequence[Image], height: int = 0) -> Image:
    """Pictures beside each other on white, each of a height in px; 0: as high as the first one."""
    height = height or images[0].height
    resized = [image.resize((max(1, round(height * image.width / image.height)), height)) for image in images]
    strip = pil.new("RGB", (sum(image.width for image in resized) + 4 * (len(resized) - 1), height), "white")
    left = 0
    for image in resized:
        strip.paste(image, (left, 0))
        left += image.width + 4
    return strip
