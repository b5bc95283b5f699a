"""The marker sheet in a photograph, the plane that it lies in, and the camera.

Nothing here knows of other photographs, except where a focal length is found by several of them.
"""

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
from metapp.extensions.capture.rectified.found_outlines import KeepOutlines, ignore_outlines
from metapp.extensions.capture.rectified.sheet import (
    RULER_CM,
    Floats,
    marker_corners_cm,
    marker_dictionary,
    opening_of_markers,
)

MIN_SEEN_MARKERS = 4

MAX_MARKER_ERROR_SIDES = 1 / 256  # sides of the opening that markers may be off on average: a texel of a fit
_FOCAL_RANGE_MM = (10.0, 150.0)  # in which a focal length is searched
_FOCAL_TEST_RATIO = 1.1  # a focal length so much longer or shorter must fit visibly worse
_REMEDY = "photograph the whole sheet, sharp and well lit"


class Sighting(NamedTuple):
    """The marker sheet in a photograph; px are of pixel centres, from the upper left one.

    Attributes:
        path: the photograph.
        height, width: the size of the upright photograph, in px.
        focal_mm: the focal length, as on 35 mm film; 0 if it is not known.
        opening_cm: the side of the opening; lengths are those printed on the sheet, corrected by its ruler.
        markers: the corners of the markers found, [M, 4, 2] px.
        points_cm, points_px: corners [N, 2] that lie in one plane, on the sheet (x right, y up) and in the photograph.
        to_px: the homography [3, 3] from points of the sheet to the photograph.
        shows_sheet: False without a sheet: then the opening is a square that all photographs show, and lengths are in
            its sides.
        is_reference: whether the other photographs are registered on this one, if there is no sheet.
        matches_cm, matches_px: without a sheet, all matches with the reference, [M, 2] each, of other planes, too:
            where the reference sees them on the plane, and where the photograph shows them.
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
    shows_sheet: bool = True
    is_reference: bool = False
    matches_cm: Floats = np.zeros((0, 2))
    matches_px: Floats = np.zeros((0, 2))

    def camera_matrix(self) -> Floats:
        """Return the matrix [3, 3] from directions, x right, y down, z forward, to px of the photograph."""
        focal = self.focal_mm / FILM_DIAGONAL_MM * math.hypot(self.height, self.width)
        return np.array([[focal, 0, (self.width - 1) / 2], [0, focal, (self.height - 1) / 2], [0, 0, 1]])

    def corners_px(self) -> Floats:
        """Return the corners of the opening in the photograph, [4, 2] px, from the lower left one counter-clockwise."""
        corners_cm = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * self.opening_cm / 2
        corners: Floats = import_opencv().perspectiveTransform(corners_cm[None], self.to_px)[0]
        return corners

    def px_per_cm(self) -> tuple[float, float]:
        """Return the px per cm along the shortest and along the longest side of the opening."""
        corners = self.corners_px()
        sides = np.linalg.norm(corners - np.roll(corners, 1, 0), axis=1) / self.opening_cm
        return float(sides.min()), float(sides.max())


class NoMarkersError(ValueError):
    """An error about a photograph that shows no marker of a sheet."""


class Camera(NamedTuple):
    """The camera of a photograph of the sheet.

    Attributes:
        sighting: the sheet in the photograph.
        place_cm: the place [3] of the camera from the opening's centre: x right, y up on the sheet, z out of it.
        axes: the directions right, down and forward of the photograph, rows [3, 3], in the coordinates of `place_cm`.
        error_px: the root mean square distance of the markers from where this camera sees them.
    """

    sighting: Sighting
    place_cm: Floats
    axes: Floats
    error_px: float

    def offset_place_cm(self, right: float, up: float) -> Floats:
        """Return the place [3] that lies some cm right and up of the camera, as its photograph is shown."""
        place: Floats = self.place_cm + right * self.axes[0] - up * self.axes[1]
        return place

    def projection_matrix(self, height_cm: float = 0.0) -> Floats:
        """Return the matrix [3, 3] from points of the sheet, or of a plane above it, to px of the photograph."""
        place_above_plane = self.place_cm - [0, 0, height_cm]
        projection: Floats = self.sighting.camera_matrix() @ np.column_stack(
            [self.axes[:, :2], -self.axes @ place_above_plane]
        )
        return projection

    @property
    def view_angle_degrees(self) -> float:
        """The angle at the opening's centre between the direction to the camera and the sheet's normal."""
        return math.degrees(math.acos(self.place_cm[2] / float(np.linalg.norm(self.place_cm))))

    @property
    def tilt_degrees(self) -> float:
        """The angle between the camera's axis and the sheet's normal: 0 for a photograph taken from straight above."""
        return math.degrees(math.acos(min(-float(self.axes[2, 2]), 1.0)))


CamerasOf = Callable[[Sequence[Sighting], float], list[Camera]]


def find_sheet(
    path: Path, fov_rad: float = 0.0, ruler_cm: float = RULER_CM, keep_outlines: KeepOutlines = ignore_outlines
) -> Sighting:
    """Find the sheet in a photograph.

    Args:
        path: the photograph.
        fov_rad: the field of view of its camera along the shorter side; 0 if EXIF is to give it, if it does.
        ruler_cm: the measured length of the printed ruler.
        keep_outlines: called with what is found, as far as the search gets.

    Raises:
        ValueError: the photograph cannot be read, shows no sheet, or fewer than MIN_SEEN_MARKERS of its markers, the
            markers do not lie in a plane or are on one side of the opening alone, the opening is not wholly in the
            picture, or OpenCV is not installed.
    """
    cv2, pixels = import_opencv(), read_pixels(path)
    height, width = pixels.values.shape[:2]
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    settings.relativeCornerRefinmentWinSize = 0.4  # of a cell, so that edges of the marker's inner cells do not count
    settings.cornerRefinementWinSize = 100
    green = (display_values(pixels)[..., 1] * 255).round().astype(np.uint8)  # the sharpest channel
    found, numbers, others = cv2.aruco.ArucoDetector(marker_dictionary(), settings).detectMarkers(green)
    numbers = np.ravel(numbers).tolist() if found else []
    opening = opening_of_markers(numbers)
    if opening is None:
        keep_outlines(path, f"{len(others)} outlines looked at, no marker", np.reshape(others, (-1, 4, 2)), "orange")
        raise NoMarkersError(f"{path}: no marker found, expected the markers of a sheet; {_REMEDY}.")
    on_sheet, scale = marker_corners_cm(opening), ruler_cm / RULER_CM
    markers = {number: px[0].astype(float) for number, px in zip(numbers, found, strict=True) if number in on_sheet}
    points_cm = scale * np.concatenate([on_sheet[number] for number in markers])
    marker_corners = np.stack(list(markers.values()))
    keep_outlines(path, f"{len(marker_corners)} marker{'s' * (len(marker_corners) != 1)}", marker_corners, "lime")
    points_px, side = marker_corners.reshape(-1, 2), scale * opening
    _, mask = cv2.findHomography(points_px, points_cm, cv2.RANSAC, 2 * MAX_MARKER_ERROR_SIDES * side)
    is_in_plane = np.zeros(len(points_cm), bool) if mask is None else mask[:, 0].astype(bool)
    if not is_in_plane.all():
        outlier_text = f"{(~is_in_plane).sum()} of {len(is_in_plane)} corners in no plane with the others"
        keep_outlines(path, outlier_text, diamond_outlines(points_px[~is_in_plane], max(height, width)), "red")
    if is_in_plane.mean() < 0.75:
        raise ValueError(
            f"{path}: {is_in_plane.sum()} of {len(is_in_plane)} corners of markers lie in one plane, expected nearly "
            "all of a flat sheet in focus; lay it flat, hold the camera still, or leave this photo out."
        )
    points_cm, points_px = points_cm[is_in_plane], points_px[is_in_plane]
    if len(markers) < MIN_SEEN_MARKERS or cv2.contourArea(cv2.convexHull(points_cm.astype(np.float32))) < side**2:
        found = f"{len(markers)} marker{'s' * (len(markers) != 1)}, on one side of the opening alone or too few"
        raise ValueError(f"{path}: {found}, expected {MIN_SEEN_MARKERS} to 12 all round; {_REMEDY}.")
    to_px, _ = cv2.findHomography(points_cm, points_px)
    sighting = Sighting(
        path, height, width, focal_length_mm(pixels, fov_rad), side, marker_corners, points_cm, points_px, to_px
    )
    corners = sighting.corners_px()
    keep_outlines(path, "the opening", corners[None], "magenta")
    if (corners < -0.5).any() or (corners > np.array([width, height]) - 0.5).any():
        raise ValueError(f"{path}: the opening is not wholly in the picture, expected all of it; {_REMEDY}.")
    return sighting


def diamond_outlines(points: Floats, longer_px: int) -> Floats:
    """Return outlines [N, 4, 2] that mark points [N, 2], in px of a photograph whose longer side is `longer_px`."""
    return np.asarray(points[:, None] + np.array([[-1, 0], [0, -1], [1, 0], [0, 1]]) * longer_px / 250)


def focal_length_mm(pixels: Pixels, fov_rad: float) -> float:
    """Return the focal length, in mm as on 35 mm film, of a photograph.

    Args:
        pixels: the photograph.
        fov_rad: the field of view along the shorter side; 0 if EXIF is to give the focal length.

    Returns:
        The focal length; 0 if it is not known, as of a part of the photograph that EXIF describes.
    """
    height, width = pixels.values.shape[:2]
    # This inverts `data_tools.readers.square_photos.field_of_view_rad`.
    focal_share = min(height, width) / math.hypot(height, width) / 2 / math.tan(fov_rad / 2) if fov_rad else 0
    lens = pixels.picture_lens()
    return FILM_DIAGONAL_MM * focal_share or (0.0 if lens.is_part else lens.focal_mm)


def solve_camera(sighting: Sighting, focal_mm: float) -> Camera:
    """Solve for the pinhole camera that took a photograph of the sheet; its axis meets the photograph's middle.

    Args:
        sighting: the sheet in the photograph.
        focal_mm: the focal length, in mm as on 35 mm film, > 0.
    """
    cv2 = import_opencv()
    sighting = sighting._replace(focal_mm=focal_mm)
    camera_matrix, points = sighting.camera_matrix(), np.pad(sighting.points_cm, ((0, 0), (0, 1)))
    _, rotation_vector, translation = cv2.solvePnP(points, sighting.points_px, camera_matrix, None)
    errors_px = (
        cv2.projectPoints(points, rotation_vector, translation, camera_matrix, None)[0][:, 0] - sighting.points_px
    )
    axes = cv2.Rodrigues(rotation_vector)[0]
    error_px = float(np.sqrt((errors_px**2).sum(-1).mean()))
    return Camera(sighting, -axes.T @ translation[:, 0], axes, error_px)


def cameras_on_sheet(sightings: Sequence[Sighting], focal_mm: float = 0.0) -> list[Camera]:
    """Return the cameras of photographs of the sheet, with a given focal length where they do not state theirs."""
    return [solve_camera(sighting, sighting.focal_mm or focal_mm) for sighting in sightings]


def common_focal_length_mm(sightings: Sequence[Sighting], cameras_of: CamerasOf = cameras_on_sheet) -> float:
    """Find the focal length, in mm as on 35 mm film, by which photographs of one lens fit best.

    Args:
        sightings: the photographs.
        cameras_of: finds the cameras of photographs with a given focal length.

    Raises:
        ValueError: no photograph is tilted enough to tell.
    """

    def focal_error(log_focal: Floats) -> float:
        """Return the mean square error, in fractions of the photograph's diagonal."""
        cameras = cameras_of(sightings, float(np.exp(log_focal).item()))
        return float(np.mean([(camera.error_px / math.hypot(*camera.sighting[1:3])) ** 2 for camera in cameras]))

    best_log_focal = brute(focal_error, [tuple(np.log(_FOCAL_RANGE_MM))], Ns=25)
    neighbour_error = min(
        focal_error(best_log_focal + math.log(_FOCAL_TEST_RATIO)),
        focal_error(best_log_focal - math.log(_FOCAL_TEST_RATIO)),
    )
    if neighbour_error < 2 * focal_error(best_log_focal):
        raise ValueError(
            f"{sightings[0].path}: no focal length in its EXIF, and too little tilt to find it; give the camera's "
            "field of view: --fov DEGREES."
        )
    return float(np.exp(best_log_focal).item())
