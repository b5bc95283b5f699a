"""Camera poses of photographs of the marker sheet."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from data_tools.readers.photos import FRAME_MM
from metapp.extensions.capture.markers import opencv
from metapp.extensions.capture.markers.sheet import Floats
from metapp.extensions.capture.markers.sighting import Sighting

_FOCALS_MM = (10.0, 150.0)  # where a lens is looked for
_OFF = 1.1  # a focal length so much longer or shorter must fit visibly worse


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


def focal_of(fov_rad: float, height: int, width: int) -> float:
    """The focal length in mm as of 35 mm film: the inverse of `data_tools.readers.photos.field_of_view`."""
    return FRAME_MM * min(height, width) / math.hypot(height, width) / 2 / math.tan(fov_rad / 2)


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
    points, seen = np.pad(sighting.points_cm[sighting.kept], ((0, 0), (0, 1))), sighting.points_px[sighting.kept]
    turn, shift = cv2.solvePnPRefineLM(
        points, seen, camera, None, *_first_guess(np.linalg.inv(camera) @ sighting.to_px)
    )
    off = cv2.projectPoints(points, turn, shift, camera, None)[0][:, 0] - seen
    axes = cv2.Rodrigues(turn)[0]
    return Pose(-axes.T @ shift[:, 0], axes, float(np.sqrt((off**2).sum(-1).mean())))


def _first_guess(homography: Floats) -> tuple[Floats, Floats]:
    """Rotation vector and translation [3, 1] of a camera by the homography to directions (Zhang 2000).

    OpenCV's IPPE is not used: with these points it is tens of pixels off at some focal lengths, or NaN.
    """
    scaled = homography / math.sqrt(np.linalg.norm(homography[:, 0]) * np.linalg.norm(homography[:, 1]))
    scaled *= np.sign(scaled[2, 2])  # the sheet is in front
    left, _, right = np.linalg.svd(np.column_stack([scaled[:, :2], np.cross(scaled[:, 0], scaled[:, 1])]))
    return opencv().Rodrigues(left @ right)[0], scaled[:, 2:].copy()


def common_focal(sightings: Sequence[Sighting]) -> float:
    """The focal length in mm, as of 35 mm film, by which photographs of one lens fit best.

    Raises:
        ValueError: none of them is tilted enough to tell.
    """
    from scipy.optimize import minimize_scalar

    def error(log_focal: float) -> float:
        """Mean square error, in fractions of the photograph's diagonal."""
        diagonals = [math.hypot(sighting.height, sighting.width) for sighting in sightings]
        errors = [pose_of(sighting, math.exp(log_focal)).error_px for sighting in sightings]
        return float(np.mean(np.square(np.divide(errors, diagonals))))

    low, high = map(math.log, _FOCALS_MM)
    step = (high - low) / 24
    best = min((low + i * step for i in range(25)), key=error)
    found = minimize_scalar(error, bounds=(best - step, best + step), method="bounded", options={"xatol": 1e-4}).x
    worse = min(error(found + math.log(_OFF)), error(found - math.log(_OFF)))
    if worse < 2 * error(found):
        raise ValueError(
            f"{sightings[0].path}: no focal length in its EXIF, and too little tilt to find it; give the camera's "
            "field of view: --fov DEGREES."
        )
    return math.exp(found)
