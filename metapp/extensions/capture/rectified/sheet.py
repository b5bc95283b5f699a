"""The marker sheet: the places and the numbers of its markers.

Nothing here knows of photographs.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from metapp.extensions.capture.hand_photos import import_opencv

OPENINGS_CM = range(4, 14)  # sides of the opening; each has its own markers, so that a photo tells the size
RULER_CM = 10.0
MARKER_SIDE_CELLS = 7  # five cells of the marker's code, and a black one on either side
MARKERS_PER_SHEET = 12  # four along each side

_MAX_MARKER_CM = 2.4  # side of a marker
_MARKER_GAP_CM = 0.6  # from the opening to the markers

Floats = NDArray[np.float64]


def marker_dictionary() -> object:
    """Return OpenCV's dictionary of the markers: any two differ in six cells or more, however they are turned."""
    aruco = import_opencv().aruco
    return aruco.getPredefinedDictionary(aruco.DICT_5X5_250)


def marker_corners_cm(opening: int) -> dict[int, Floats]:
    """Return the places of the markers of a sheet.

    Args:
        opening: the side of the opening in cm, one of OPENINGS_CM.

    Returns:
        For each marker's number its corners [4, 2] in cm, upper left, upper right, lower right, lower left: x right, y
        up, from the opening's centre.
    """
    side = min(
        _MAX_MARKER_CM, (opening - 0.5) / 2
    )  # so small that four markers with gaps fit along a small opening, too
    centre_distance = opening / 2 + _MARKER_GAP_CM + side / 2
    coordinates = np.linspace(-centre_distance, centre_distance, MARKERS_PER_SHEET // 4 + 1)
    ring = [(x, y) for y in coordinates[::-1] for x in coordinates if max(abs(x), abs(y)) > centre_distance - 1e-9]
    square = np.array([[-1, 1], [1, 1], [1, -1], [-1, -1]]) * side / 2
    first = (opening - OPENINGS_CM[0]) * MARKERS_PER_SHEET
    return {first + i: square + centre for i, centre in enumerate(ring)}


def opening_of_markers(numbers: Iterable[int]) -> int | None:
    """Return the opening, in cm, of the sheet that most of the markers belong to; None if none is a sheet's."""
    sheets = [number // MARKERS_PER_SHEET for number in numbers if number // MARKERS_PER_SHEET < len(OPENINGS_CM)]
    return OPENINGS_CM[max(set(sheets), key=sheets.count)] if sheets else None
