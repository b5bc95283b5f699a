"""A ball in a photograph: which direction each of its pixels mirrors, and where each direction is seen.

The ball has radius 1 and its camera looks at it from +z, with x to the right and y up, as in
`metapp.appearance.latlong`. A point of the ball's picture is given by its place in a disc of radius 1 that the contour
bounds. The disc lies in the plane through the ball's centre that faces the camera, and points are projected onto it
from the camera.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from data_tools.readers.colours import Floats

FAR_CAMERA_ANGLE_RAD = 1e-6  # half the angle that a ball fills for a camera far away
_SPLINE_NODES = 2000  # of the spline through the places where directions are seen


class PinholeLens(NamedTuple):
    """A pinhole camera, in px of the photograph.

    Attributes:
        focal: the focal length.
        x, y: the principal point.
    """

    focal: float
    x: float
    y: float

    def resize(self, share: float) -> PinholeLens:
        """Return the camera of the photograph resized by `share`."""
        return PinholeLens(*(share * length for length in self))


PARALLEL_LENS = PinholeLens(1e9, 0.0, 0.0)  # rays are parallel, and contours are circles


class Ball(NamedTuple):
    """A ball in a photograph.

    Lengths are in px from the photograph's upper left corner, so that the first pixel's centre is (.5, .5).

    Attributes:
        x, y: the place of the ball's centre.
        radius: the radius of the contour, measured in the plane through (x, y) that faces the camera.
        lens: the lens of the camera.
        score: the share of the contour that lies on edges, in [0, 1].
    """

    x: float
    y: float
    radius: float
    lens: PinholeLens = PARALLEL_LENS
    score: float = 1.0

    @property
    def half_angle_rad(self) -> float:
        """Half the angle that the ball fills, in rad. Directions within this angle of the ball's back are not seen."""
        return max(FAR_CAMERA_ANGLE_RAD, math.atan(self.radius / float(np.linalg.norm(self._centre()))))

    def _centre(self) -> Floats:
        """Return the disc's centre [3], in px, for a camera at the origin that looks to +z, with x right and y down."""
        return np.array([self.x - self.lens.x, self.y - self.lens.y, self.lens.focal])

    def to_px(self, places: Floats) -> Floats:
        """Return the px [2, ...] of the photograph (right, down) of places [2, ...] in the disc (right, up)."""
        centre, axes = self._centre(), self.radius * self._axes()[:2]
        x, y, z = np.tensordot(centre, np.ones(places.shape[1:]), 0) + np.tensordot(axes, places, (0, 0))
        return np.stack([self.lens.focal * x / z + self.lens.x, self.lens.focal * y / z + self.lens.y])

    def to_places(self, px: Floats) -> Floats:
        """Return the places [2, ...] in the disc (right, up) of px [2, ...] of the photograph (right, down)."""
        centre = self._centre()
        rays = np.stack([px[0] - self.lens.x, px[1] - self.lens.y, np.full(px.shape[1:], self.lens.focal)])
        in_disc = rays * (centre @ centre / np.tensordot(centre, rays, 1))
        return np.tensordot(self._axes()[:2], in_disc, 1) / self.radius

    def to_camera(self, directions: Floats) -> Floats:
        """Return directions [3, ...], seen from the ball with z along its ray to the camera, as the picture's.

        In the picture x is right, y is up, and z is opposite to where the camera looks.
        """
        axes = self._axes() * [1.0, -1.0, -1.0]
        return np.tensordot(axes, directions, (0, 0))

    def _axes(self) -> Floats:
        """Return right, up and towards the camera as the ball sees them, [3, 3], in the frame of `_centre`."""
        centre = self._centre()
        right = np.cross([0.0, 1.0, 0.0], centre)
        up = np.cross(right, centre)
        return np.stack([axis / np.linalg.norm(axis) for axis in (right, up, -centre)])

    def resize(self, share: float) -> Ball:
        """Return the ball as it lies in the photograph resized by `share`."""
        x, y, radius = (share * length for length in self[:3])
        return self._replace(x=x, y=y, radius=radius, lens=self.lens.resize(share))


def disc_places(size: int) -> Floats:
    """Return the places [2, size, size] in the disc of the pixels of a square picture that a ball fills."""
    coordinates = (np.arange(size) + 0.5) * (2 / size) - 1
    return np.stack(np.meshgrid(coordinates, -coordinates))


def disc_to_directions(places: Floats, angle: float = FAR_CAMERA_ANGLE_RAD) -> Floats:
    """Return the directions that places in the disc mirror; beyond the contour, those that the contour mirrors.

    Args:
        places: the places (right, up), [2, ...].
        angle: half the angle that the ball fills for its camera, in rad.

    Returns:
        The directions, [3, ...], of unit length.
    """
    radius = np.hypot(places[0], places[1])
    # By the law of sines in the triangle of camera, centre and point: the mirrored direction leans by twice the angle
    # of incidence, less the lean beta of the ray itself.
    beta = np.arctan(np.minimum(radius, 1) * math.tan(angle))
    psi = 2 * np.arcsin(np.minimum(np.sin(beta) / math.sin(angle), 1)) - beta
    azimuth_axis = places / np.maximum(radius, 1e-12)
    return np.stack([np.sin(psi) * azimuth_axis[0], np.sin(psi) * azimuth_axis[1], np.cos(psi)])


def directions_to_disc(directions: Floats, angle: float = FAR_CAMERA_ANGLE_RAD) -> tuple[Floats, Floats]:
    """Return where in the disc directions are seen, and how fast these places move with the directions.

    The speed is along the radius, where it is least: 1/2 in the middle, 0 at the contour. It is 0 for directions that
    the ball hides, whose places are on the contour.

    Args:
        directions: the directions, [3, ...], of unit length.
        angle: half the angle that the ball fills for its camera, in rad.

    Returns:
        The places (right, up), [2, ...], and the speeds, [...], in 1 / rad.
    """
    normals = np.linspace(0, math.pi / 2 - angle, _SPLINE_NODES)
    beta = np.arctan2(np.sin(normals), 1 / math.sin(angle) - np.cos(normals))
    radius_spline = CubicSpline(2 * normals + beta, np.tan(beta) / math.tan(angle))
    sine = np.hypot(directions[0], directions[1])
    psi = np.minimum(np.arctan2(sine, directions[2]), math.pi - angle)
    place = np.stack([directions[0], directions[1]]) / np.maximum(sine, 1e-12) * radius_spline(psi)
    return place, np.where(psi < math.pi - angle, radius_spline(psi, 1).clip(0), 0.0)
