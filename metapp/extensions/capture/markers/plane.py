"""The plane of a material without markers: the places of cameras and the square that all photographs show."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import brute, linprog

from data_tools.readers.lenses import FILM_DIAGONAL_MM
from metapp.extensions.capture.markers.registration import apply_homography
from metapp.extensions.capture.markers.sheet import Floats
from metapp.extensions.capture.markers.sighting import Camera, Sighting, solve_camera

_TRIED = 25  # matches of a photograph by which the plane is looked for
_SLOPE = 0.6  # of the plane to the reference, at most
_ABOVE = 0.003  # weight of these slopes squared: two photographs fit two planes
MIN_LARGEST_SQUARE_SHARE = (
    0.99  # share of the largest square's side that a square below the straightest camera has, at least
)


def cameras_on_plane(sightings: Sequence[Sighting], focal_mm: float = 0.0) -> list[Camera]:
    """Cameras above the plane by which photographs fit best; lengths are in distances of the first from it.

    Args:
        sightings: as `register` returns them.
        focal_mm: as of 35 mm film, of photographs that do not state it.
    """
    known = [each._replace(focal_mm=each.focal_mm or focal_mm) for each in sightings]
    few = [each._replace(points_cm=each.points_cm[:_TRIED], points_px=each.points_px[:_TRIED]) for each in known]

    def error(slopes: Floats) -> float:
        """Mean error, in fractions of the photograph's diagonal; a little more of a tilted reference."""
        seen = _on_plane(few[1:], _to_plane(slopes, few[0].focal_mm))
        shares = [camera.error_px / math.hypot(camera.sighting.height, camera.sighting.width) for camera in seen]
        return float(np.mean(shares) + _ABOVE * np.square(slopes).sum())

    slopes = brute(error, [(-_SLOPE, _SLOPE)] * 2, Ns=5)
    return _on_plane(known, _to_plane(slopes, known[0].focal_mm))


def cameras_on_square(cameras: Sequence[Camera]) -> list[Camera]:
    """Return cameras above the square along the plane's axes that all photographs show; lengths are in its sides.

    Squares that are as large as the largest one, or nearly, may lie far apart, where photographs share an oblong. The
    square is the one nearest to below the straightest camera, so that this camera is from nearest to straight above.

    Raises:
        ValueError: there is none.
    """
    rows = []
    for sighting, *_ in cameras:
        to_px = sighting.to_px * np.sign(sighting.to_px[2] @ [*sighting.points_cm[0], 1.0])
        for row, size in zip(to_px[:2], (sighting.width, sighting.height), strict=True):
            rows += [row, (size - 1) * to_px[2] - row]
    edges, free = np.stack(rows), (None, None)
    # unknowns: the middle, half a side, and how far the middle is at most from below the camera along either axis
    inside = np.column_stack([-edges[:, :2], np.abs(edges[:, :2]).sum(1), np.zeros(len(edges))])
    largest = linprog([0, 0, -1, 0], inside, edges[:, 2], bounds=[free, free, (0, None), (0, None)])
    if not largest.success or largest.x[2] <= 0:
        raise ValueError(
            f"{cameras[0].sighting.path}: no part is in all {len(cameras)} photos, expected one; aim at one place."
        )
    x, y = min(cameras, key=lambda camera: camera.tilt_degrees).place_cm[:2]
    near = np.array([[1, 0, 0, -1], [-1, 0, 0, -1], [0, 1, 0, -1], [0, -1, 0, -1]])
    limits, smallest = [*edges[:, 2], x, -x, y, -y], MIN_LARGEST_SQUARE_SHARE * largest.x[2]
    nearest = linprog([0, 0, 0, 1], np.vstack([inside, near]), limits, bounds=[free, free, (smallest, None), (0, None)])
    x, y, reach, _ = nearest.x if nearest.success else largest.x
    to_square = np.array([[1, 0, -x], [0, 1, -y], [0, 0, 2 * reach]])
    return _on_plane([camera.sighting for camera in cameras], to_square)


def cameras_on_part(cameras: Sequence[Camera], middle: Sequence[float], side: float, turn_rad: float) -> list[Camera]:
    """Return cameras above a smaller square; lengths are in its sides.

    Args:
        cameras: as :func:`cameras_on_square` returns them.
        middle: of the smaller square, x right and y up from that of the square, in its sides.
        side: of the smaller square, in sides of the square.
        turn_rad: by which it is turned counter-clockwise.
    """
    cos, sin = math.cos(turn_rad), math.sin(turn_rad)
    to_axes = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, side]])
    to_middle = np.array([[1, 0, -middle[0]], [0, 1, -middle[1]], [0, 0, 1]])
    return _on_plane([camera.sighting for camera in cameras], to_axes @ to_middle)


def _to_plane(slopes: Floats, focal_mm: float) -> Floats:
    """From points of the reference, [3, 3], to a plane of such slopes at distance 1, below the camera its origin."""
    normal = np.array([*slopes, 1.0]) / math.hypot(*slopes, 1.0)
    right = np.array([normal[2], 0.0, -normal[0]]) / math.hypot(normal[0], normal[2])
    return np.stack([right, np.cross(normal, right), -normal]) @ np.diag([1.0, 1.0, -focal_mm / FILM_DIAGONAL_MM])


def _on_plane(sightings: Sequence[Sighting], to_plane: Floats) -> list[Camera]:
    """The cameras by which photographs are seen when their points are moved so, and the homographies of these."""
    cameras = []
    for sighting in sightings:
        camera = solve_camera(
            sighting._replace(points_cm=apply_homography(to_plane, sighting.points_cm)), sighting.focal_mm
        )
        cameras.append(camera._replace(sighting=camera.sighting._replace(to_px=camera.to_px())))
    return cameras
