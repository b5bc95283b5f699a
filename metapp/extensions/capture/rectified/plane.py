"""The plane of a material without markers: the places of cameras and the square that all photographs show.

Photographs are registered already; nothing here looks at their pixels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.optimize import brute, linprog

from data_tools.readers.lenses import FILM_DIAGONAL_MM
from metapp.extensions.capture.rectified.features import apply_homography
from metapp.extensions.capture.rectified.sheet import Floats
from metapp.extensions.capture.rectified.sighting import Camera, Sighting, solve_camera

_TRIED_MATCHES = 25  # matches of a photograph by which the plane is searched
_MAX_SLOPE = 0.6  # of the plane against the picture plane of the reference
_SLOPE_PENALTY = 0.003  # for each squared slope: two photographs fit two planes, of which the flatter one is chosen
MIN_LARGEST_SQUARE_SHARE = 0.99  # side of the chosen square over the side of the largest one, at least


def cameras_on_plane(sightings: Sequence[Sighting], focal_mm: float = 0.0) -> list[Camera]:
    """Find the cameras above the plane by which photographs fit best; lengths are in distances of the first from it.

    Args:
        sightings: the photographs, which :func:`metapp.extensions.capture.rectified.registration.register_photos`
            placed on the first one.
        focal_mm: the focal length, as on 35 mm film, of photographs that do not state it.
    """
    sightings_with_focal = [sighting._replace(focal_mm=sighting.focal_mm or focal_mm) for sighting in sightings]
    reduced_sightings = [
        sighting._replace(
            points_cm=sighting.points_cm[:_TRIED_MATCHES],
            points_px=sighting.points_px[:_TRIED_MATCHES],
            matches_cm=sighting.matches_cm[:0],
        )
        for sighting in sightings_with_focal
    ]

    def slope_error(slopes: Floats) -> float:
        """Return the mean error in fractions of the photograph's diagonal, with a penalty on tilted references."""
        cameras = _on_plane(reduced_sightings[1:], _to_plane(slopes, reduced_sightings[0].focal_mm))
        shares = [camera.error_px / math.hypot(camera.sighting.height, camera.sighting.width) for camera in cameras]
        return float(np.mean(shares) + _SLOPE_PENALTY * np.square(slopes).sum())

    slopes = brute(slope_error, [(-_MAX_SLOPE, _MAX_SLOPE)] * 2, Ns=5)
    return _on_plane(sightings_with_focal, _to_plane(slopes, sightings_with_focal[0].focal_mm))


def cameras_on_square(cameras: Sequence[Camera]) -> list[Camera]:
    """Return cameras above the square, along the plane's axes, that all photographs show; lengths are in its sides.

    Squares that are as large as the largest one, or nearly, may lie far apart, where photographs share an oblong. Of
    these the square is taken that is nearest to the point below the straightest camera, so that this camera is from
    nearest to straight above.

    Args:
        cameras: the cameras that :func:`cameras_on_plane` found.

    Raises:
        ValueError: there is no square that all photographs show.
    """
    half_planes = []
    for sighting, *_ in cameras:
        to_px = sighting.to_px * np.sign(sighting.to_px[2] @ [*sighting.points_cm[0], 1.0])
        for row, size in zip(to_px[:2], (sighting.width, sighting.height), strict=True):
            half_planes += [row, (size - 1) * to_px[2] - row]
    constraints, free = np.stack(half_planes), (None, None)
    # unknowns: the middle, half a side, and the distance of the middle from the point below the camera along an axis
    inside = np.column_stack([-constraints[:, :2], np.abs(constraints[:, :2]).sum(1), np.zeros(len(constraints))])
    largest = linprog([0, 0, -1, 0], inside, constraints[:, 2], bounds=[free, free, (0, None), (0, None)])
    if not largest.success or largest.x[2] <= 0:
        raise ValueError(
            f"{cameras[0].sighting.path}: no part is in all {len(cameras)} photos, expected one; aim at one place."
        )
    x, y = min(cameras, key=lambda camera: camera.tilt_degrees).place_cm[:2]
    distance_rows = np.array([[1, 0, 0, -1], [-1, 0, 0, -1], [0, 1, 0, -1], [0, -1, 0, -1]])
    limits, smallest = [*constraints[:, 2], x, -x, y, -y], MIN_LARGEST_SQUARE_SHARE * largest.x[2]
    nearest = linprog(
        [0, 0, 0, 1], np.vstack([inside, distance_rows]), limits, bounds=[free, free, (smallest, None), (0, None)]
    )
    x, y, half_side, _ = nearest.x if nearest.success else largest.x
    to_square = np.array([[1, 0, -x], [0, 1, -y], [0, 0, 2 * half_side]])
    return _on_plane([camera.sighting for camera in cameras], to_square)


def cameras_on_part(cameras: Sequence[Camera], middle: Sequence[float], side: float, turn_rad: float) -> list[Camera]:
    """Return cameras above a smaller square; lengths are in its sides.

    Args:
        cameras: the cameras that :func:`cameras_on_square` found.
        middle: the middle of the smaller square from the middle of the square, x right and y up, in sides of the
            square.
        side: the side of the smaller square, in sides of the square.
        turn_rad: the angle by which the smaller square is turned counter-clockwise.
    """
    cos, sin = math.cos(turn_rad), math.sin(turn_rad)
    to_axes = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, side]])
    to_middle = np.array([[1, 0, -middle[0]], [0, 1, -middle[1]], [0, 0, 1]])
    return _on_plane([camera.sighting for camera in cameras], to_axes @ to_middle)


def _to_plane(slopes: Floats, focal_mm: float) -> Floats:
    """Return the homography [3, 3] from points of the reference to a plane of given slopes.

    The plane lies at distance 1 from the camera, and its origin is below the camera.
    """
    normal = np.array([*slopes, 1.0]) / math.hypot(*slopes, 1.0)
    right = np.array([normal[2], 0.0, -normal[0]]) / math.hypot(normal[0], normal[2])
    return np.stack([right, np.cross(normal, right), -normal]) @ np.diag([1.0, 1.0, -focal_mm / FILM_DIAGONAL_MM])


def _on_plane(sightings: Sequence[Sighting], to_plane: Floats) -> list[Camera]:
    """Return the cameras of photographs whose points are moved to a plane by a homography, with homographies to px."""
    cameras = []
    for sighting in sightings:
        on_plane = sighting._replace(
            points_cm=apply_homography(to_plane, sighting.points_cm),
            matches_cm=apply_homography(to_plane, sighting.matches_cm),
        )
        camera = solve_camera(on_plane, sighting.focal_mm)
        cameras.append(camera._replace(sighting=camera.sighting._replace(to_px=camera.projection_matrix())))
    return cameras
