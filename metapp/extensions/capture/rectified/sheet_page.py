"""The page of a marker sheet, to print: markers around an opening, a ruler, and instructions.

Which markers a sheet has, and where, is decided in `sheet`, by which photographs are read, too.
"""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from metapp.extensions.capture.hand_photos import import_opencv
from metapp.extensions.capture.rectified.sheet import MARKER_SIDE_CELLS, RULER_CM, marker_corners_cm, marker_dictionary
from metapp.storage.files import write_atomically

PAGES_CM = {"a4": (21.0, 29.7), "letter": (21.59, 27.94)}

_CUT_MARGIN_CM = 0.15  # from the opening to the line to cut along, so that an uneven cut leaves no paper in the picture
_INCH_CM = 2.54
_CELL_PX = 40  # side of a marker's cell: viewers that smooth pictures keep edges
_TOP_MARGIN_CM = 1.0  # printers leave it blank

_INSTRUCTIONS = (
    'metapp marker sheet, opening {0} x {0} cm. Print at 100 % ("actual size"), on matt paper.',
    "1. Measure the ruler. If it is not 10 cm long, add its length in step 4: --ruler CM",
    "2. Cut out the square. Lay the sheet flat on the flat material; let neither of them move.",
    "3. Take 3 to 10 photos, flash on, in a dark room, with the whole sheet in view and sharp:",
    "    one from straight above, the others from other places and distances, up to 40 degrees aside.",
    "4. metapp data rectify PHOTOS --out FOLDER",
    "5. metapp meta svbrdf_nonstationary FOLDER",
)


def write_marker_sheet(path: Path, opening: int = 10, page: str = "a4") -> None:
    """Write the page as PDF, true to scale, with the same bytes each time.

    Args:
        path: the file to write.
        opening: the side of the opening in cm, one of OPENINGS_CM.
        page: the paper, one of PAGES_CM.

    Raises:
        ValueError: OpenCV is not installed.
        OSError: the file cannot be written; the message names the folder.
    """
    with rc_context({"pdf.fonttype": 42}):
        figure = draw_marker_sheet(opening, page)
        save = functools.partial(figure.savefig, format="pdf", metadata={"CreationDate": None})
        write_atomically(path, save)


def draw_marker_sheet(opening: int = 10, page: str = "a4") -> Figure:
    """Draw the page at the size of the paper, with axes in cm from the opening's centre.

    Args:
        opening: the side of the opening in cm, one of OPENINGS_CM.
        page: the paper, one of PAGES_CM.
    """
    (width, height), corners_by_number = PAGES_CM[page], marker_corners_cm(opening)
    outer_cm, cut_cm, ruler_start = (
        max(map(np.max, corners_by_number.values())),
        opening + 2 * _CUT_MARGIN_CM,
        -RULER_CM / 2,
    )
    figure = Figure(figsize=(width / _INCH_CM, height / _INCH_CM))
    figure.suppressComposite = True  # each marker stays a picture of its own, with sharp edges
    limits: dict[str, Any] = {
        "xlim": (-width / 2, width / 2),
        "ylim": (outer_cm + _TOP_MARGIN_CM - height, outer_cm + _TOP_MARGIN_CM),
    }
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set(**limits)
    axes.set_axis_off()
    for number, corners in corners_by_number.items():
        (x0, y1), _, (x1, y0), _ = corners
        picture = import_opencv().aruco.generateImageMarker(marker_dictionary(), number, MARKER_SIDE_CELLS * _CELL_PX)
        axes.imshow(picture, cmap="gray", extent=(x0, x1, y0, y1), interpolation="none", aspect="auto")
    dash_style: dict[str, Any] = {"edgecolor": "0.45", "linewidth": 0.6, "linestyle": (0, (6, 4))}
    axes.add_patch(Rectangle((-cut_cm / 2, -cut_cm / 2), cut_cm, cut_cm, fill=False, **dash_style))
    axes.text(0, 0, "Cut this square out\nalong the dashed line.", ha="center", va="center", color="0.45", size=9)
    line_style: dict[str, Any] = {"color": "black", "linewidth": 0.8, "solid_capstyle": "butt"}
    ruler_y = -outer_cm - 1.2
    axes.plot([ruler_start, -ruler_start], [ruler_y, ruler_y], **line_style)
    for tick in range(int(RULER_CM) + 1):
        axes.plot([ruler_start + tick] * 2, [ruler_y, ruler_y + 0.25], **line_style)
        axes.text(ruler_start + tick, ruler_y + 0.32, str(tick), ha="center", va="bottom", size=7)
    axes.text(-ruler_start + 0.3, ruler_y, "cm", ha="left", va="center", size=8)
    for i, words in enumerate(_INSTRUCTIONS):
        size = 8.5 if i else 9
        axes.text(ruler_start - 2.0, ruler_y - 0.8 - 0.5 * i, words.format(opening), ha="left", va="center", size=size)
    return figure
