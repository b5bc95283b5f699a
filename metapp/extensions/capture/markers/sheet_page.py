"""The page of a marker sheet, to print."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from metapp.extensions.capture.hand_photos import import_opencv
from metapp.extensions.capture.markers.sheet import MARKER_SIDE_CELLS, RULER_CM, marker_corners_cm, marker_dictionary
from metapp.storage.files import write_atomically

PAGES_CM = {"a4": (21.0, 29.7), "letter": (21.59, 27.94)}

_CUT_CM = 0.15  # from the opening to the line to cut along: an uneven cut leaves no paper in the picture
_INCH_CM = 2.54
_FINE = 40  # px of a cell, so that viewers that smooth pictures keep edges
_TOP_CM = 1.0  # margin that printers leave blank

_STEPS = (
    'metapp marker sheet, opening {0} x {0} cm. Print at 100 % ("actual size"), on matt paper.',
    "1. Measure the ruler. If it is not 10 cm long, add its length in step 4: --ruler CM",
    "2. Cut out the square. Lay the sheet flat on the flat material; let neither of them move.",
    "3. Take 3 to 10 photos, flash on, in a dark room, with the whole sheet in view and sharp:",
    "    one from straight above, the others from other places and distances, up to 40 degrees aside.",
    "4. metapp data rectify PHOTOS --out FOLDER",
    "5. metapp meta svbrdf_nonstationary FOLDER",
)


def write_marker_sheet(path: Path, opening: int = 10, page: str = "a4") -> None:
    """Write the page as PDF, true to scale, the same bytes each time.

    Args:
        path: the file.
        opening: its side in cm, one of OPENINGS_CM.
        page: the paper, one of PAGES_CM.

    Raises:
        ValueError: OpenCV is not installed.
        OSError: it cannot be written; names the folder.
    """
    with rc_context({"pdf.fonttype": 42}):
        figure = draw_marker_sheet(opening, page)
        save = functools.partial(figure.savefig, format="pdf", metadata={"CreationDate": None})
        write_atomically(path, save)


def draw_marker_sheet(opening: int = 10, page: str = "a4") -> Figure:
    """Draw the page, as `write_marker_sheet` writes it: as large as the paper, its axes in cm from the opening's centre."""
    (width, height), corners_by_number = PAGES_CM[page], marker_corners_cm(opening)
    outer, cut, left = max(map(np.max, corners_by_number.values())), opening + 2 * _CUT_CM, -RULER_CM / 2
    figure = Figure(figsize=(width / _INCH_CM, height / _INCH_CM))
    figure.suppressComposite = True  # a picture of each marker, as sharp as it is
    ends: dict[str, Any] = {"xlim": (-width / 2, width / 2), "ylim": (outer + _TOP_CM - height, outer + _TOP_CM)}
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(**ends)
    axes.set_axis_off()
    for number, corners in corners_by_number.items():
        (x0, y1), _, (x1, y0), _ = corners
        picture = import_opencv().aruco.generateImageMarker(marker_dictionary(), number, MARKER_SIDE_CELLS * _FINE)
        axes.imshow(picture, cmap="gray", extent=(x0, x1, y0, y1), interpolation="none", aspect="auto")
    dashes: dict[str, Any] = {"edgecolor": "0.45", "linewidth": 0.6, "linestyle": (0, (6, 4))}
    axes.add_patch(Rectangle((-cut / 2, -cut / 2), cut, cut, fill=False, **dashes))
    axes.text(0, 0, "Cut this square out\nalong the dashed line.", ha="center", va="center", color="0.45", size=9)
    line: dict[str, Any] = {"color": "black", "linewidth": 0.8, "solid_capstyle": "butt"}
    top = -outer - 1.2
    axes.plot([left, -left], [top, top], **line)
    for mark in range(int(RULER_CM) + 1):
        axes.plot([left + mark] * 2, [top, top + 0.25], **line)
        axes.text(left + mark, top + 0.32, str(mark), ha="center", va="bottom", size=7)
    axes.text(-left + 0.3, top, "cm", ha="left", va="center", size=8)
    for i, words in enumerate(_STEPS):
        size = 8.5 if i else 9
        axes.text(left - 2.0, top - 0.8 - 0.5 * i, words.format(opening), ha="left", va="center", size=size)
    return figure
