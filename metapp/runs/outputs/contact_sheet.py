"""Contact sheets of runs: a row of pictures for each fit, with references, photos and errors.

Pillow draws them: matplotlib, by which figures are drawn, takes longer to import than most fits take.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from PIL import Image as pil
from PIL import ImageDraw, ImageFont
from PIL.Image import Image
from torch import Tensor

from metapp.appearance.colour import composite_to_srgb
from metapp.storage.files import write_atomically
from metapp.storage.fit_folders import fit_folders
from metapp.storage.image_writers import to_8_bit_image

SHEET_FILE_NAME = "pictures.png"  # the name of a run's contact sheet in the folder of the run
MAX_SHEET_ROWS = 8  # number of fits in a sheet; a line says how many more there are
TILE_PX = 256  # the side of a square picture; a wide one is at most this high and twice as wide
GAP_PX = 8  # between two pictures
SMALL_LETTER_PX, LARGE_LETTER_PX = 14, 18  # letters of captions and of the title
REFERENCE_PREFIX = "reference "  # the beginning of the name of a picture that stands below the fit's picture
# A font in matplotlib's package, found without importing it; Pillow's own font lacks umlauts
FONT_PATH = "mpl-data/fonts/ttf/DejaVuSans.ttf"
TASK_PICTURE_NAMES = ("reference", "photo", "samples")  # names of pictures that belong to the task, not to a fit


class Tiles(NamedTuple):
    """The pictures of one fit, or of several fits of one task, which form a row of a sheet.

    Attributes:
        pictures: display values [H, W, 3] in [0, 1] by name; a picture "reference X" stands below the picture X.
        name: the name of the task.
        errors: texts about errors by the name of the picture that they stand below; the text of "" follows the name of
            the task.
    """

    pictures: dict[str, np.ndarray]
    name: str
    errors: Mapping[str, str] = MappingProxyType({})


def write_contact_sheet(tasks: Sequence[Tiles], title: str, path: Path, count: int = 0) -> Path:
    """Draw rows of pictures below each other, MAX_SHEET_ROWS at most, and write them as a PNG.

    Pictures of one name form a column, which stays blank in the rows of tasks without this picture.

    Args:
        tasks: the rows, one or more.
        title: the text above the rows.
        path: the file to write.
        count: the number of all tasks, if there are more than `tasks` has. A line says how many of them have no row.

    Returns:
        The file that was written.
    """
    small_font, large_font = _font(SMALL_LETTER_PX), _font(LARGE_LETTER_PX)
    shown_tasks = tasks[:MAX_SHEET_ROWS]
    left, column_lefts = GAP_PX, {}
    for name, width in _column_widths(shown_tasks).items():
        column_lefts[name], left = left, left + width + GAP_PX
    tops, top = [], LARGE_LETTER_PX + 3 * GAP_PX
    tile_row_height = TILE_PX + SMALL_LETTER_PX + 2 * GAP_PX
    for task in shown_tasks:
        tops.append(top)
        has_references = any(name.startswith(REFERENCE_PREFIX) for name in task.pictures)
        top += SMALL_LETTER_PX + 2 * GAP_PX + tile_row_height * (1 + has_references)
    hidden_count = max(count, len(tasks)) - len(shown_tasks)
    sheet_width = max(left, round(large_font.getlength(title)) + 2 * GAP_PX)
    sheet = pil.new("RGB", (sheet_width, top + (LARGE_LETTER_PX + GAP_PX) * (hidden_count > 0)), "white")
    draw = ImageDraw.Draw(sheet)
    draw.text((GAP_PX, GAP_PX), title, "black", large_font)
    for task, row_top in zip(shown_tasks, tops, strict=True):
        heading = ": ".join(filter(None, (task.name, task.errors.get("", ""))))
        draw.text((GAP_PX, row_top), _shorten(heading, sheet_width - 2 * GAP_PX, small_font), "black", small_font)
        for name, picture in task.pictures.items():
            column = name.removeprefix(REFERENCE_PREFIX)
            tile_left = column_lefts[column]
            tile_top = row_top + SMALL_LETTER_PX + GAP_PX + tile_row_height * (column != name)
            tile = _resize_to_tile(picture)
            sheet.paste(tile, (tile_left, tile_top))
            caption = _shorten(f"{name.replace('_', ' ')} {task.errors.get(name, '')}", tile.width, small_font)
            draw.text((tile_left, tile_top + tile.height + 2), caption, "black", small_font)
    if hidden_count > 0:
        draw.text((GAP_PX, top), f"and {hidden_count:,} more task{'s' * (hidden_count > 1)}", "black", large_font)
    write_atomically(path, lambda target: sheet.save(target, "PNG"))
    return path


def write_run_sheet(tiles: Sequence[Tiles], title: str, run_folder: Path) -> Path:
    """Write `pictures.png` in a run's folder: fits of the last command, and how many more fits the folder holds.

    Args:
        tiles: the pictures of the fits, one or more, of which the first MAX_SHEET_ROWS are shown.
        title: the text above the rows.
        run_folder: the folder of the run.

    Returns:
        The file that was written.
    """
    return write_contact_sheet(tiles, title, run_folder / SHEET_FILE_NAME, len(fit_folders(run_folder)))


def _font(letter_px: int) -> ImageFont.FreeTypeFont:
    package = importlib.util.find_spec("matplotlib")
    assert package is not None
    assert package.origin is not None
    return ImageFont.truetype(Path(package.origin).parent / FONT_PATH, letter_px)


def _column_widths(tasks: Sequence[Tiles]) -> dict[str, int]:
    """Return the width of each column in px by name, in order from the left: reference, photo and samples first."""
    widths: dict[str, int] = {}
    for task in tasks:
        for name, picture in task.pictures.items():
            column = name.removeprefix(REFERENCE_PREFIX)
            widths[column] = max(widths.get(column, 0), _tile_size(picture)[1])
    return dict(sorted(widths.items(), key=lambda item: item[0] not in TASK_PICTURE_NAMES))


def _tile_size(picture: np.ndarray) -> tuple[int, int]:
    """Return the height and the width in px that a picture gets in a sheet."""
    height, width = picture.shape[:2]
    scale = min(TILE_PX / height, 2 * TILE_PX / width)
    return max(1, round(height * scale)), max(1, round(width * scale))


def _resize_to_tile(picture: np.ndarray) -> Image:
    height, width = _tile_size(picture)
    return to_8_bit_image(picture).resize((width, height), pil.Resampling.BICUBIC)


def srgb_image(linear: Tensor | np.ndarray) -> Image:
    """Convert linear RGB [H, W, 3], or [H, W, 4] with coverage, which goes on white, to a PIL image in 8-bit sRGB."""
    return to_8_bit_image(composite_to_srgb(linear))


def _shorten(text: str, width: int, font: ImageFont.FreeTypeFont) -> str:
    """Cut a text that is wider than `width` px, and end it with an ellipsis."""
    length = font.getlength
    if length(text) <= width:
        return text
    cut = next(end for end in range(len(text), 0, -1) if end == 1 or length(text[:end] + "…") <= width)
    return text[:cut] + "…"


def to_display_values(pictures: Mapping[str, Tensor | np.ndarray]) -> dict[str, np.ndarray]:
    """Convert linear RGB pictures [H, W, 3 or 4], by name, to display values [H, W, 3] in [0, 1]."""
    return {name: composite_to_srgb(picture) for name, picture in pictures.items()}


def place_side_by_side(images: Sequence[Image], height: int = 0) -> Image:
    """Place images beside each other on white, 4 px apart.

    Args:
        images: the images, from the left.
        height: the height in px that each is resized to; 0 for the height of the first one.
    """
    height = height or images[0].height
    resized = [image.resize((max(1, round(height * image.width / image.height)), height)) for image in images]
    strip = pil.new("RGB", (sum(image.width for image in resized) + 4 * (len(resized) - 1), height), "white")
    left = 0
    for image in resized:
        strip.paste(image, (left, 0))
        left += image.width + 4
    return strip
