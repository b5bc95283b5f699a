"""A picture of photographs that could not be rectified, with what was found in each of them.

Functions that search photographs pass what they find to a :data:`KeepOutlines`, and know nothing of the picture.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch
from PIL import Image as image
from PIL import ImageDraw
from PIL import ImageFont as fonts
from PIL.Image import Image
from PIL.ImageFont import FreeTypeFont, ImageFont

from data_tools.readers.image_files import read_pixels
from metapp.extensions.capture.hand_photos import draw_outlines
from metapp.extensions.capture.rectified.sheet import Floats
from metapp.storage.files import to_json_value
from metapp.storage.image_writers import write_png

# A function that takes a photograph, words for what was found in it, closed outlines [N, M, 2] in px from the centre of
# its upper left pixel, and the colour of the outlines in words.
KeepOutlines = Callable[[Path, str, Floats, str], object]

_PICTURE_WIDTH_PX, _MIN_PHOTO_PX, _MAX_PHOTO_PX = 2400, 240, 800  # widths of the picture, and of a photograph in it
_MAX_COLUMNS = 3  # for up to nine photographs; more photographs have more columns
_TEXT_PX, _LINE_PX, _GAP_PX = 16, 22, 12  # height of text, distance of its lines, width of gaps
_BACKGROUND_COLOUR, _TEXT_COLOUR = (40, 40, 40), "white"


def ignore_outlines(path: Path, words: str, outlines: Floats, colour: str) -> None:
    """Drop what was found, where nobody draws a picture of it."""


class FoundOutlines:
    """What was found in photographs so far: for each photograph and colour, the last outlines."""

    def __init__(self) -> None:
        self._found: dict[Path, dict[str, tuple[str, Floats]]] = {}

    def keep_outlines(self, path: Path, words: str, outlines: Floats, colour: str) -> None:
        """Keep outlines to draw into a photograph, in place of earlier ones of the colour; see :data:`KeepOutlines`."""
        self._found.setdefault(path, {})[colour] = words, outlines

    def write(self, paths: Sequence[Path], reason: str, picture: Path) -> bool:
        """Write photographs with what was found in them as one PNG.

        Args:
            paths: the photographs; a grey field stands for one that could not be read.
            reason: why they are not rectified, written above them.
            picture: the file to write.

        Returns:
            Whether the picture was written: it is not if none of the photographs could be read.

        Raises:
            OSError: the picture cannot be written; the message names the folder.
        """
        if not any(path in self._found for path in paths):
            return False
        columns = min(_MAX_COLUMNS, len(paths)) if len(paths) <= _MAX_COLUMNS**2 else math.ceil(math.sqrt(len(paths)))
        side = min(max(_PICTURE_WIDTH_PX // columns, _MIN_PHOTO_PX), _MAX_PHOTO_PX)
        font = fonts.load_default(_TEXT_PX)
        tiles = [self._draw_tile(path, side, font) for path in paths]
        rows = [tiles[i : i + columns] for i in range(0, len(tiles), columns)]
        width = columns * (side + _GAP_PX) + _GAP_PX
        lines = _wrap(reason, font, width - 2 * _GAP_PX)
        top = len(lines) * _LINE_PX + 2 * _GAP_PX
        height = top + sum(max(tile.height for tile in row) + _GAP_PX for row in rows)
        sheet = image.new("RGB", (width, height), _BACKGROUND_COLOUR)
        for number, line in enumerate(lines):
            ImageDraw.Draw(sheet).text((_GAP_PX, _GAP_PX + number * _LINE_PX), line, _TEXT_COLOUR, font)
        for row in rows:
            for column, tile in enumerate(row):
                sheet.paste(tile, (_GAP_PX + column * (side + _GAP_PX), top))
            top += max(tile.height for tile in row) + _GAP_PX
        write_png(torch.from_numpy(np.array(sheet, np.float32) / 255), {"encoding": "sRGB"}, picture)
        return True

    def _draw_tile(self, path: Path, side: int, font: ImageFont | FreeTypeFont) -> Image:
        """Draw a photograph, up to `side` px wide and high, and below it its name and what was found."""
        found = self._found.get(path, {})
        outlines = [(points + 0.5, colour) for colour, (_, polygons) in found.items() for points in polygons]
        if found:
            photo = draw_outlines(read_pixels(path), outlines, side)
        else:
            photo = image.new("RGB", (side, side * 3 // 4), "grey")
        captions = [(path.name, _TEXT_COLOUR)]
        captions += [(words, colour) for colour, (words, _) in found.items()] or [("cannot be read", _TEXT_COLOUR)]
        wrapped = [(line, colour) for words, colour in captions for line in _wrap(words, font, side)]
        tile = image.new("RGB", (side, photo.height + _LINE_PX * len(wrapped) + _GAP_PX), _BACKGROUND_COLOUR)
        tile.paste(photo)
        for number, (line, colour) in enumerate(wrapped):
            ImageDraw.Draw(tile).text((0, photo.height + 4 + number * _LINE_PX), line, colour, font)
        return tile


def _wrap(text: str, font: ImageFont | FreeTypeFont, width: int) -> list[str]:
    """Split a text at its spaces into lines that are at most `width` px wide; a longer word loses its beginning."""
    lines = [""]
    for word in to_json_value(text).split():
        extended_line = f"{lines[-1]} {word}".strip()
        if font.getlength(extended_line) <= width:
            lines[-1] = extended_line
        else:
            while font.getlength(word) > width:
                word = word[1:]
            lines.append(word)
    return [line for line in lines if line]
