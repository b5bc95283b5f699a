"""The style of all figures: matplotlib's rcParams, colours that colour-blind readers can tell apart, and labels.

The module knows no data: functions that draw figures pass their points and words.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from metapp.storage.files import write_atomically

PARADIGM_COLOURS = {  # sRGB, from the palette of Okabe and Ito (2008)
    "general": "#E69F00",
    "overfit": "#0072B2",
    "finetune": "#56B4E9",
    "quickft": "#CC79A7",
    "meta": "#D55E00",
}
MUTED_COLOUR = "#666666"
HALF_MARKER_PX = 5  # px, half the side of a square that covers the marker of a point
LABEL_DISTANCES_POINTS = (7, 16, 26, 36)  # typographic points from a marker to its label
LABEL_ANGLES_RAD = [math.radians(degrees) for degrees in (35, -35, 145, -145, 90, -90, 0, 180)]
FIGURE_STYLE: Any = {
    "axes.axisbelow": True,
    "axes.grid": True,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "figure.constrained_layout.use": True,
    "font.size": 9,
    "grid.color": "#d9d9d9",
    "legend.frameon": False,
    "pdf.fonttype": 42,  # TrueType: text in a PDF can be selected and searched
    "savefig.dpi": 160,
}


def save_figure(figure: Figure, path: Path) -> Path:
    """Save a figure in the format of the path's suffix, and return the path.

    Files of equal figures are equal, since no date is written.
    """
    metadata = {"CreationDate": None} if path.suffix == ".pdf" else {"Software": None}
    with rc_context(FIGURE_STYLE):
        write_atomically(path, functools.partial(figure.savefig, metadata=metadata))
    return path


def place_labels(axis: Axes, labels: Sequence[tuple[str, tuple[float, float], Mapping[str, Any]]]) -> None:
    """Write labels beside markers, each as near as it covers neither a marker nor another label.

    A label that is far from its marker is joined to it by a line.

    Args:
        axis: the axes, whose limits must be final.
        labels: for each label its text, the marker's place in data coordinates, and keyword arguments of
            `Axes.annotate` for its text style.
    """
    figure = axis.get_figure(root=True)
    assert figure is not None
    figure.draw_without_rendering()
    marker_centres = [axis.transData.transform(place) for _, place, _ in labels]
    covered_boxes = [
        Bbox.from_extents(*(centre - HALF_MARKER_PX), *(centre + HALF_MARKER_PX)) for centre in marker_centres
    ]
    for name, place, text_style in labels:
        for distance, angle in itertools.product(LABEL_DISTANCES_POINTS, LABEL_ANGLES_RAD):
            x, y = distance * math.cos(angle), distance * math.sin(angle)
            line = (
                {"arrowstyle": "-", "linewidth": 0.4, "color": MUTED_COLOUR}
                if distance > LABEL_DISTANCES_POINTS[0]
                else None
            )
            alignment = "center" if abs(x) < 1 else "left" if x > 0 else "right"
            options: Any = {"textcoords": "offset points", "ha": alignment, "va": "center", "arrowprops": line} | dict(
                text_style
            )
            annotation = axis.annotate(name, place, (x, y), **options)
            annotation.get_window_extent()  # moves the text to its place; the extent it returns includes the line
            box = Text.get_window_extent(annotation)
            is_inside = axis.bbox.x0 <= box.x0 and box.x1 <= axis.bbox.x1 and box.y1 <= axis.bbox.y1
            if is_inside and not any(box.overlaps(covered_box) for covered_box in covered_boxes):
                break
            annotation.remove()
        else:
            annotation = axis.annotate(
                name, place, (LABEL_DISTANCES_POINTS[0], 0), textcoords="offset points", **text_style
            )
        covered_boxes.append(box)
