"""Photographs taken by hand: their display values, drawings of what was found in them, and the import of OpenCV.

Nothing here knows what is looked for in a photograph.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from types import ModuleType

import numpy as np
import torch
from PIL import Image, ImageDraw

from data_tools.readers.colours import Floats
from data_tools.readers.image_files import Pixels
from metapp.appearance.colour import linear_to_srgb
from metapp.storage.folders import FolderKind, mark_folder
from metapp.storage.image_writers import write_png

_MAX_DRAWING_PX = 1200  # longer side of a drawing


def import_opencv() -> ModuleType:
    """Return the module cv2, which the extra `capture` of the package installs.

    Raises:
        ValueError: OpenCV is not installed.
    """
    try:
        import cv2
    except ImportError:
        raise ValueError('OpenCV: not installed, expected here; install it: pip install "metapp[capture]".') from None
    return cv2


def display_values(pixels: Pixels) -> Floats:
    """Return the display values of a photograph, sRGB [height, width, 3] in [0, 1]."""
    values: Floats = linear_to_srgb(torch.from_numpy(pixels.linear()[..., :3])).numpy()
    return values


def write_outlines(pixels: Pixels, outlines: Iterable[tuple[Floats, str]], path: Path) -> None:
    """Write a photograph with outlines in colours as PNG into a folder of results.

    Args:
        pixels: the photograph.
        outlines: closed outlines, px [N, 2] from the photograph's upper left corner, and their colours in words.
        path: the file to write.

    Raises:
        OSError: the file cannot be written.
    """
    image = draw_outlines(pixels, outlines, _MAX_DRAWING_PX)
    mark_folder(path.parent, FolderKind.RESULTS)
    write_png(torch.from_numpy(np.array(image, np.float32) / 255), {"encoding": "sRGB"}, path)


def draw_outlines(pixels: Pixels, outlines: Iterable[tuple[Floats, str]], longer_px: int) -> Image.Image:
    """Draw a photograph with outlines in colours.

    Args:
        pixels: the photograph.
        outlines: closed outlines, px [N, 2] from the photograph's upper left corner, and their colours in words.
        longer_px: the drawing's longer side, at most.
    """
    image = Image.fromarray((display_values(pixels) * 255).round().astype("uint8"))
    width = image.width
    image.thumbnail((longer_px, longer_px))
    for points, colour in outlines:
        corners = [tuple(point) for point in (points * image.width / width).tolist()]
        ImageDraw.Draw(image).line([*corners, corners[0]], fill=colour, width=2)
    return image
