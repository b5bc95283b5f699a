"""The style of figures: matplotlib's rcParams, colours that the colour-blind tell apart (Okabe & Ito 2008)."""

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

PARADIGM_COLOURS = {
    "general": "#E69F00",
    "overfit": "#0072B2",
    "finetune": "#56B4E9",
    "quickft": "#CC79A7",
    "meta": "#D55E00",
}
MUTED_COLOUR = "#666666"
HALF_MARKER_PX = 5  # px, half the side of a place
LABEL_DISTANCES_POINTS = (7, 16, 26, 36)  # points from a place to its name
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
    "pdf.fonttype": 42,  # text stays text
    "savefig.dpi": 160,
}


def save_figure(figure: Figure, path: Path) -> Path:
    """Write a figure in the format of the suffix, without a date, so that files of equal figures are equal."""
    metadata = {"CreationDate": None} if path.suffix == ".pdf" else {"Software": None}
    with rc_context(FIGURE_STYLE):
        write_atomically(path, functools.partial(figure.savefig, metadata=metadata))
    return path


def place_labels(axis: Axes, names: Sequence[tuple[str, tuple[float, float], Mapping[str, Any]]]) -> None:
    """Write names beside places, each as near as it covers neither a place nor another name; far ones have a line.

    Args:
        axis: whose limits are final.
        names: each with its place, in data coordinates, and its look, as of `Axes.annotate`.
    """
    figure = axis.get_figure(root=True)
    assert figure is not None
    figure.draw_without_rendering()
    centres = [axis.transData.transform(place) for _, place, _ in names]
    taken = [Bbox.from_extents(*(centre - HALF_MARKER_PX), *(centre + HALF_MARKER_PX)) for centre in centres]
    for name, place, look in names:
        for reach, angle in itertools.product(LABEL_DISTANCES_POINTS, LABEL_ANGLES_RAD):
            x, y = reach * math.cos(angle), reach * math.sin(angle)
            line = (
                {"arrowstyle": "-", "linewidth": 0.4, "color": MUTED_COLOUR}
                if reach > LABEL_DISTANCES_POINTS[0]
                else None
            )
            side = "center" if abs(x) < 1 else "left" if x > 0 else "right"
            options: Any = {"textcoords": "offset points", "ha": side, "va": "center", "arrowprops": line} | dict(look)
            note = axis.annotate(name, place, (x, y), **options)
            note.get_window_extent()  # which moves the text, and is of text and line
            box = Text.get_window_extent(note)
            is_inside = axis.bbox.x0 <= box.x0 and box.x1 <= axis.bbox.x1 and box.y1 <= axis.bbox.y1
            if is_inside and not any(box.overlaps(other) for other in taken):
                break
            note.remove()
        else:
            note = axis.annotate(name, place, (LABEL_DISTANCES_POINTS[0], 0), textcoords="offset points", **look)
        taken.append(box)
