"""The marker sheet: the places and the numbers of its markers."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from metapp.extensions.capture.hand_photos import import_opencv

OPENINGS_CM = range(4, 14)  # sides of the opening; each has markers of its own, so that photos tell it
RULER_CM = 10.0
MARKER_SIDE_CELLS = 7  # of a marker's side: five of its code and a black one on either side
MARKERS_PER_SHEET = 12  # of a sheet, four along each side

_LARGEST_CM = 2.4  # a marker's side
_GAP_CM = 0.6  # from the opening to the markers

Floats = NDArray[np.float64]


def marker_dictionary() -> object:
    """OpenCV's dictionary of the markers: any two differ in six cells or more, however they are turned."""
    aruco = import_opencv().aruco
    return aruco.getPredefinedDictionary(aruco.DICT_5X5_250)


def marker_corners_cm(opening: int) -> dict[int, Floats]:
    """Places of the markers of a sheet.

    Args:
        opening: its side in cm, one of OPENINGS_CM.

    Returns:
        By a marker's number its corners [4, 2] in cm, upper left, upper right, lower right, lower left: x right, y up,
        from the opening's centre.
    """
    side = min(_LARGEST_CM, (opening - 0.5) / 2)  # four and the gaps between fit along a small opening, too
    reach = opening / 2 + _GAP_CM + side / 2
    along = np.linspace(-reach, reach, MARKERS_PER_SHEET // 4 + 1)
    ring = [(x, y) for y in along[::-1] for x in along if max(abs(x), abs(y)) > reach - 1e-9]
    square = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * side / 2
    first = (opening - OPENINGS_CM[0]) * MARKERS_PER_SHEET
    return {first + i: square + centre for i, centre in enumerate(ring)}


def opening_of_markers(numbers: Iterable[int]) -> int | None:
    """The opening in cm of the sheet that most of these markers belong to; None without any of a sheet."""
    sheets = [number // MARKERS_PER_SHEET for number in numbers if number // MARKERS_PER_SHEET < len(OPENINGS_CM)]
    return OPENINGS_CM[max(set(sheets), key=sheets.count)] if sheets else None
