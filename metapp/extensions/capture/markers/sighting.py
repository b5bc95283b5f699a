"""Finding the marker sheet in a photograph, the plane that it lies in, and the camera."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import brute

from data_tools.readers.image_files import Pixels, read_pixels
from data_tools.readers.lenses import FILM_DIAGONAL_MM
from metapp.extensions.capture.hand_photos import display_values, import_opencv
from metapp.extensions.capture.markers.found_outlines import KeepOutlines, ignore_outlines
from metapp.extensions.capture.markers.sheet import (
    RULER_CM,
    Floats,
    marker_corners_cm,
    marker_dictionary,
    opening_of_markers,
)

MIN_SEEN_MARKERS = 4  # markers

MAX_MARKER_ERROR_SIDES = 1 / 256  # of the opening's side, that markers may be off on average: a texel of a fit
_FOCALS_MM = (10.0, 150.0)  # where a lens is looked for
_OFF = 1.1  # a focal length so much longer or shorter must fit visibly worse
_REMEDY = "photograph the whole sheet, sharp and well lit"


class Sighting(NamedTuple):
    """The marker sheet in a photograph; px are of pixel centres, from the upper left one.

    Attributes:
        path: of the photograph.
        height, width: of the upright photograph in px.
        focal_mm: as of 35 mm film; 0 if it is not known.
        opening_cm: its side; lengths are the sheet's own.
        markers: corners of those found [M, 4, 2], px.
        points_cm, points_px: corners [N, 2] that lie in one plane, on the sheet (x right, y up) and in the photograph.
        to_px: [3, 3], takes points of the sheet to the photograph.
        sheet: False without one: the opening is a square that all photographs show, and lengths are in its sides.
        reference: whether the others are registered on this photograph, if there is no sheet.
    """

    path: Path
    height: int
    width: int
    focal_mm: float
    opening_cm: float
    markers: Floats
    points_cm: Floats
    points_px: Floats
    to_px: Floats
    sheet: bool = True
    reference: bool = False

    def lens(self) -> Floats:
        """From directions, x right, y down, z forward, to the photograph, [3, 3]."""
        focal = self.focal_mm / FILM_DIAGONAL_MM * math.hypot(self.height, self.width)
        return np.array([[focal, 0, (self.width - 1) / 2], [0, focal, (self.height - 1) / 2], [0, 0, 1]])

    def corners_px(self) -> Floats:
        """Corners of the opening in the photograph [4, 2], round it from the lower left one."""
        marker_corners_cm = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * self.opening_cm / 2
        result: Floats = import_opencv().perspectiveTransform(marker_corners_cm[None], self.to_px)[0]
        return result

    def scales(self) -> tuple[float, float]:
        """px per cm along the shortest and along the longest side of the opening."""
        corners = self.corners_px()
        sides = np.linalg.norm(corners - np.roll(corners, 1, 0), axis=1) / self.opening_cm
        return float(sides.min()), float(sides.max())


class NoMarkersError(ValueError):
    """A photograph without a marker of a sheet."""


class Camera(NamedTuple):
    """The camera of a photograph of the sheet.

    Attributes:
        sighting: the sheet in the photograph.
        place_cm: [3], from the opening's centre: x right, y up on the sheet, z out of it.
        axes: [3, 3], rows: right, down and forward of the photograph, in the same coordinates.
        error_px: root mean square distance of the markers from where this camera sees them.
    """

    sighting: Sighting
    place_cm: Floats
    axes: Floats
    error_px: float

    def beside_cm(self, right: float, up: float) -> Floats:
        """The place [3] so many cm right and up of the camera as its photograph is shown."""
        result: Floats = self.place_cm + right * self.axes[0] - up * self.axes[1]
        return result

    def to_px(self, height_cm: float = 0.0) -> Floats:
        """From points of the sheet, or of a plane so high above it, to the photograph, [3, 3]."""
        below = self.place_cm - [0, 0, height_cm]
        result: Floats = self.sighting.lens() @ np.column_stack([self.axes[:, :2], -self.axes @ below])
        return result

    @property
    def aside_degrees(self) -> float:
        """The angle at the opening's centre between the direction to the camera and the sheet's normal."""
        return math.degrees(math.acos(self.place_cm[2] / float(np.linalg.norm(self.place_cm))))

    @property
    def tilt_degrees(self) -> float:
        """The angle between the camera's axis and the sheet's normal: 0 if the photograph is taken straight."""
        return math.degrees(math.acos(min(-float(self.axes[2, 2]), 1.0)))


CamerasOf = Callable[[Sequence[Sighting], float], list[Camera]]


def find_sheet(
    path: Path, fov_rad: float = 0.0, ruler_cm: float = RULER_CM, show: KeepOutlines = ignore_outlines
) -> Sighting:
    """Find the sheet in a photograph.

    Args:
        path: the photograph.
        fov_rad: of its camera along the shorter side; 0: as EXIF says, if it does.
        ruler_cm: measured length of the printed ruler.
        show: called with what is found, as far as it gets.

    Raises:
        ValueError: as `read_pixels`; no sheet, or fewer than FEWEST markers of it; these do not lie in a plane or on
            one side of the opening alone; the opening is not wholly in the picture; OpenCV is not installed.
    """
    cv2, pixels = import_opencv(), read_pixels(path)
    height, width = pixels.values.shape[:2]
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    settings.relativeCornerRefinmentWinSize = 0.4  # of a cell: none of its cells' edges
    settings.cornerRefinementWinSize = 100
    green = (display_values(pixels)[..., 1] * 255).round().astype(np.uint8)  # the sharpest channel
    found, numbers, others = cv2.aruco.ArucoDetector(marker_dictionary(), settings).detectMarkers(green)
    numbers = np.ravel(numbers).tolist() if found else []
    opening = opening_of_markers(numbers)
    if opening is None:
        show(path, f"{len(others)} outlines looked at, no marker", np.reshape(others, (-1, 4, 2)), "orange")
        raise NoMarkersError(f"{path}: no marker found, expected those of a marker sheet; {_REMEDY}.")
    on_sheet, scale = marker_corners_cm(opening), ruler_cm / RULER_CM
    markers = {number: px[0].astype(float) for number, px in zip(numbers, found, strict=True) if number in on_sheet}
    points_cm = scale * np.concatenate([on_sheet[number] for number in markers])
    every = np.stack(list(markers.values()))
    show(path, f"{len(every)} marker{'s' * (len(every) != 1)}", every, "lime")
    points_px, side = every.reshape(-1, 2), scale * opening
    _, mask = cv2.findHomography(points_px, points_cm, cv2.RANSAC, 2 * MAX_MARKER_ERROR_SIDES * side)
    kept = np.zeros(len(points_cm), bool) if mask is None else mask[:, 0].astype(bool)
    if not kept.all():
        off = f"{(~kept).sum()} of {len(kept)} corners in no plane with the others"
        show(path, off, diamond_outlines(points_px[~kept], max(height, width)), "red")
    if kept.mean() < 0.75:
        raise ValueError(
            f"{path}: {kept.sum()} of {len(kept)} corners of markers lie in one plane, expected nearly all of a flat "
            "sheet in focus; lay it flat, hold the camera still, or leave this photo out."
        )
    points_cm, points_px = points_cm[kept], points_px[kept]
    if len(markers) < MIN_SEEN_MARKERS or cv2.contourArea(cv2.convexHull(points_cm.astype(np.float32))) < side**2:
        found = f"{len(markers)} marker{'s' * (len(markers) != 1)}, on one side of the opening alone or too few"
        raise ValueError(f"{path}: {found}, expected {MIN_SEEN_MARKERS} to 12 all round; {_REMEDY}.")
    to_px, _ = cv2.findHomography(points_cm, points_px)
    sighting = Sighting(path, height, width, focal_length_mm(pixels, fov_rad), side, every, points_cm, points_px, to_px)
    corners = sighting.corners_px()
    show(path, "the opening", corners[None], "magenta")
    if (corners < -0.5).any() or (corners > np.array([width, height]) - 0.5).any():
        raise ValueError(f"{path}: the opening is not wholly in the picture, expected all of it; {_REMEDY}.")
    return sighting


def diamond_outlines(points: Floats, longer_px: int) -> Floats:
    """Return marks [N, 4, 2] of points [N, 2] in px of a photograph whose longer side is `longer_px`."""
    return np.asarray(points[:, None] + np.array([[-1, 0], [0, -1], [1, 0], [0, 1]]) * longer_px / 250)


def focal_length_mm(pixels: Pixels, fov_rad: float) -> float:
    """The focal length in mm, as of 35 mm film, of a field of view along the shorter side; 0: as EXIF says, if so."""
    height, width = pixels.values.shape[:2]
    # the inverse of `data_tools.readers.square_photos.field_of_view_rad`
    focal = min(height, width) / math.hypot(height, width) / 2 / math.tan(fov_rad / 2) if fov_rad else 0
    return FILM_DIAGONAL_MM * focal or pixels.focal_mm


def solve_camera(sighting: Sighting, focal_mm: float) -> Camera:
    """The pinhole camera, its axis through the middle of the photograph, that sees the sheet so.

    Args:
        sighting: the sheet in the photograph.
        focal_mm: as of 35 mm film, > 0.
    """
    cv2 = import_opencv()
    sighting = sighting._replace(focal_mm=focal_mm)
    lens, points = sighting.lens(), np.pad(sighting.points_cm, ((0, 0), (0, 1)))
    _, turn, shift = cv2.solvePnP(points, sighting.points_px, lens, None)
    off = cv2.projectPoints(points, turn, shift, lens, None)[0][:, 0] - sighting.points_px
    axes = cv2.Rodrigues(turn)[0]
    error_px = float(np.sqrt((off**2).sum(-1).mean()))
    return Camera(sighting, -axes.T @ shift[:, 0], axes, error_px)


def cameras_on_sheet(sightings: Sequence[Sighting], focal_mm: float = 0.0) -> list[Camera]:
    """Cameras of photographs of the sheet, of a focal length where they do not state theirs."""
    return [solve_camera(each, each.focal_mm or focal_mm) for each in sightings]


def common_focal_length_mm(sightings: Sequence[Sighting], cameras_of: CamerasOf = cameras_on_sheet) -> float:
    """The focal length in mm, as of 35 mm film, by which photographs of one lens fit best.

    Raises:
        ValueError: none of them is tilted enough to tell.
    """

    def error(log_focal: Floats) -> float:
        """Mean square error, in fractions of the photograph's diagonal."""
        cameras = cameras_of(sightings, float(np.exp(log_focal).item()))
        return float(np.mean([(each.error_px / math.hypot(*each.sighting[1:3])) ** 2 for each in cameras]))

    found = brute(error, [tuple(np.log(_FOCALS_MM))], Ns=25)
    worse = min(error(found + math.log(_OFF)), error(found - math.log(_OFF)))
    if worse < 2 * error(found):
        raise ValueError(
            f"{sightings[0].path}: no focal length in its EXIF, and too little tilt to find it; give the camera's "
            "field of view: --fov DEGREES."
        )
    return float(np.exp(found).item())
