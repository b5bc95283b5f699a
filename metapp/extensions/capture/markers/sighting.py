"""Finding the marker sheet in a photograph, the plane that it lies in, and the camera."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from data_tools.readers.image_files import Array, Pixels, read_pixels
from data_tools.readers.photos import FRAME_MM
from metapp.extensions.capture.markers.sheet import Floats, corners_cm, dictionary, opening_of
from metapp.extensions.capture.opencv import opencv

LIMIT = 1 / 256  # of the opening's side, that markers may be off on average: a texel of a fit
FEWEST = 4  # markers

_FOCALS_MM = (10.0, 150.0)  # where a lens is looked for
_OFF = 1.1  # a focal length so much longer or shorter must fit visibly worse
_REMEDY = "photograph the whole sheet, sharp and well lit"


class Sighting(NamedTuple):
    """The marker sheet in a photograph; px are of pixel centres, from the upper left one.

    Attributes:
        path: of the photograph.
        height, width: of the upright photograph in px.
        focal_mm: as of 35 mm film; 0 where it is not known.
        opening: its side as printed, cm.
        markers: corners of those found [M, 4, 2], px.
        points_cm, points_px: corners [N, 2] that lie in one plane, on the sheet (x right, y up) and in the photograph.
        to_px: [3, 3], takes points of the sheet to the photograph.
    """

    path: Path
    height: int
    width: int
    focal_mm: float
    opening: int
    markers: Floats
    points_cm: Floats
    points_px: Floats
    to_px: Floats

    def seen(self, points_cm: Floats) -> Floats:
        """Points [N, 2] of the sheet in the photograph, px."""
        result: Floats = opencv().perspectiveTransform(points_cm[None], self.to_px)[0]
        return result

    def corners_px(self) -> Floats:
        """Corners of the opening in the photograph [4, 2], round it from the lower left one."""
        return self.seen(np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * self.opening / 2)

    def scales(self) -> tuple[float, float]:
        """The least and the greatest px per cm within the opening, in any direction."""
        along = np.linspace(-0.5, 0.5, 5) * self.opening
        points = np.array([(x, y) for x in along for y in along])
        step = 1e-3
        columns = [(self.seen(points + shift) - self.seen(points)) / step for shift in step * np.eye(2)]
        values = np.linalg.svd(np.stack(columns, -1), compute_uv=False)
        return float(values.min()), float(values.max())


class Pose(NamedTuple):
    """A camera.

    Attributes:
        place_cm: [3], from the opening's centre: x right, y up on the sheet, z out of it.
        axes: [3, 3], rows: right, down and forward of the photograph, in the same coordinates.
        error_px: root mean square distance of the markers from where this camera sees them.
    """

    place_cm: Floats
    axes: Floats
    error_px: float

    @property
    def tilt(self) -> float:
        """Angle between the direction to the camera and the sheet's normal, degrees."""
        return math.degrees(math.acos(self.place_cm[2] / float(np.linalg.norm(self.place_cm))))


def find_sheet(path: Path) -> Sighting:
    """Find the sheet in a photograph.

    Raises:
        ValueError: as `read_pixels`; no sheet, or fewer than FEWEST markers of it; these do not lie in a plane or on
            one side of the opening alone; the opening is not wholly in the picture; OpenCV is not installed.
    """
    cv2 = opencv()
    pixels = read_pixels(path)
    height, width = pixels.values.shape[:2]
    markers = _markers(_gray(pixels))
    opening = opening_of(markers)
    if opening is None:
        raise ValueError(f"{path}: no marker found, expected those of a marker sheet; {_REMEDY}.")
    on_sheet = corners_cm(opening)
    markers = {number: corners for number, corners in markers.items() if number in on_sheet}
    if len(markers) < FEWEST:
        raise ValueError(
            f"{path}: {len(markers)} marker{'s' * (len(markers) != 1)} found, expected {FEWEST} to 12; {_REMEDY}."
        )
    points_cm = np.concatenate([on_sheet[number] for number in markers])
    points_px = np.concatenate(list(markers.values()))
    _, mask = cv2.findHomography(points_px, points_cm, cv2.RANSAC, 2 * LIMIT * opening)
    kept = np.zeros(len(points_cm), bool) if mask is None else mask[:, 0].astype(bool)
    if kept.mean() < 0.75:
        raise ValueError(
            f"{path}: {kept.sum()} of {len(kept)} corners of markers lie in one plane, expected nearly all of a flat "
            "sheet in focus; lay it flat, hold the camera still, or leave this photo out."
        )
    points_cm, points_px = points_cm[kept], points_px[kept]
    if cv2.contourArea(cv2.convexHull(points_cm.astype(np.float32))) < opening**2:
        raise ValueError(f"{path}: markers on one side of the opening alone, expected them all round; {_REMEDY}.")
    to_px, _ = cv2.findHomography(points_cm, points_px)
    every = np.stack(list(markers.values()))
    sighting = Sighting(path, height, width, pixels.focal_mm, opening, every, points_cm, points_px, to_px)
    corners = sighting.corners_px()
    if (corners < -0.5).any() or (corners > np.array([width, height]) - 0.5).any():
        raise ValueError(f"{path}: the opening is not wholly in the picture, expected all of it; {_REMEDY}.")
    return sighting


def _gray(pixels: Pixels) -> Array:
    """The green channel, the sharpest one, as uint8 [height, width] in display values."""
    green = pixels.values[..., 1]
    if green.dtype == np.uint16:
        green = green >> 8
    elif green.dtype != np.uint8:
        green = np.nan_to_num(green).clip(0, 1) ** (1 / 2.2) * 255
    return np.ascontiguousarray(green, dtype=np.uint8)


def _markers(gray: Array) -> dict[int, Floats]:
    """Corners [4, 2] in px of all markers in a picture, by number."""
    aruco = opencv().aruco
    settings = aruco.DetectorParameters()
    settings.cornerRefinementMethod = aruco.CORNER_REFINE_SUBPIX
    settings.relativeCornerRefinmentWinSize = 0.4  # of a cell: none of its cells' edges
    settings.cornerRefinementWinSize = 100
    found, numbers, _ = aruco.ArucoDetector(dictionary(), settings).detectMarkers(gray)
    named = zip(np.ravel(numbers), found, strict=True) if found else ()
    return {int(number): corners[0].astype(np.float64) for number, corners in named}


def pose_of(sighting: Sighting, focal_mm: float) -> Pose:
    """The pose of a pinhole camera whose axis goes through the middle of the photograph.

    Args:
        sighting: the sheet in the photograph; lengths are as printed.
        focal_mm: as of 35 mm film, > 0.
    """
    cv2 = opencv()
    height, width = sighting.height, sighting.width
    focal = focal_mm / FRAME_MM * math.hypot(height, width)
    camera = np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]])
    points = np.pad(sighting.points_cm, ((0, 0), (0, 1)))
    _, turn, shift = cv2.solvePnP(points, sighting.points_px, camera, None)
    off = cv2.projectPoints(points, turn, shift, camera, None)[0][:, 0] - sighting.points_px
    axes = cv2.Rodrigues(turn)[0]
    return Pose(-axes.T @ shift[:, 0], axes, float(np.sqrt((off**2).sum(-1).mean())))


def common_focal(sightings: Sequence[Sighting]) -> float:
    """The focal length in mm, as of 35 mm film, by which photographs of one lens fit best.

    Raises:
        ValueError: none of them is tilted enough to tell.
    """
    from scipy.optimize import brute

    def error(log_focal: Floats) -> float:
        """Mean square error, in fractions of the photograph's diagonal."""
        focal_mm = float(np.exp(log_focal).item())
        shares = [pose_of(each, focal_mm).error_px / math.hypot(each.height, each.width) for each in sightings]
        return float(np.mean(np.square(shares)))

    found = brute(error, [tuple(np.log(_FOCALS_MM))], Ns=25)
    worse = min(error(found + math.log(_OFF)), error(found - math.log(_OFF)))
    if worse < 2 * error(found):
        raise ValueError(
            f"{sightings[0].path}: no focal length in its EXIF, and too little tilt to find it; give the camera's "
            "field of view: --fov DEGREES."
        )
    return float(np.exp(found).item())
