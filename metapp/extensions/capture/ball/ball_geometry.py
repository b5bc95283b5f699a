"""A ball in a photograph: which direction each of its pixels mirrors, and where each direction is seen.

The ball has radius 1 and its camera looks at it from +z, x to the right, y up, as in `metapp.appearance.latlong`. A
point of its picture is told by its place in a disc of radius 1, which the contour bounds: in the plane through the
ball's centre that faces the camera, seen from there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline

from data_tools.readers.colours import Floats

FAR_CAMERA_ANGLE_RAD = 1e-6  # rad, half the angle that a ball fills for a camera far away
_NODES = 2000  # of the splines through where directions are seen


class PinholeLens(NamedTuple):
    """A pinhole camera: its focal length and its principal point, in px."""

    focal: float
    x: float
    y: float


PARALLEL_LENS = PinholeLens(1e9, 0.0, 0.0)  # rays are parallel, and contours are circles


class Ball(NamedTuple):
    """A ball in a photograph; px from the picture's upper left corner, so that the first pixel's centre is (.5, .5).

    Attributes:
        x, y: the place of its centre.
        radius: of its contour, measured in the plane through (x, y) that faces the camera.
        lens: of the camera.
        score: how much of the contour is there, in [0, 1].
    """

    x: float
    y: float
    radius: float
    lens: PinholeLens = PARALLEL_LENS
    score: float = 1.0

    @property
    def angle(self) -> float:
        """Half the angle that it fills, rad. Directions as close to its back are not seen."""
        return max(FAR_CAMERA_ANGLE_RAD, math.atan(self.radius / float(np.linalg.norm(self._centre()))))

    def _centre(self) -> Floats:
        """Centre of the disc for a camera that looks to +z, x right, y down; unit px."""
        return np.array([self.x - self.lens.x, self.y - self.lens.y, self.lens.focal])

    def to_px(self, disc_places: Floats) -> Floats:
        """Places [2, ...] in the disc (right, up) as px [2, ...] of the photograph (right, down)."""
        centre = self._centre()
        right = np.cross([0.0, 1.0, 0.0], centre)
        up = np.cross(right, centre)
        axes = self.radius * np.stack([right / np.linalg.norm(right), up / np.linalg.norm(up)])
        x, y, z = np.tensordot(centre, np.ones(disc_places.shape[1:]), 0) + np.tensordot(axes, disc_places, (0, 0))
        return np.stack([self.lens.focal * x / z + self.lens.x, self.lens.focal * y / z + self.lens.y])

    def scaled(self, share: float) -> Ball:
        """The same in a picture of another size."""
        x, y, radius, *lens = (share * value for value in (*self[:3], *self.lens))
        return self._replace(x=x, y=y, radius=radius, lens=PinholeLens(*lens))


def disc_places(size: int) -> Floats:
    """Places [2, size, size] of the pixels of a square picture that a ball fills."""
    along = (np.arange(size) + 0.5) * (2 / size) - 1
    return np.stack(np.meshgrid(along, -along))


def disc_to_directions(disc_places: Floats, angle: float = FAR_CAMERA_ANGLE_RAD) -> Floats:
    """Directions [3, ...] that places [2, ...] in the disc mirror; beyond the contour those of the contour.

    Args:
        disc: right, up.
        angle: half the angle that the ball fills for its camera, rad.
    """
    reach = np.hypot(disc_places[0], disc_places[1])
    # the law of sines in the triangle of camera, centre and point
    beta = np.arctan(np.minimum(reach, 1) * math.tan(angle))
    psi = (
        2 * np.arcsin(np.minimum(np.sin(beta) / math.sin(angle), 1)) - beta
    )  # twice the incidence, less the ray's lean
    across = disc_places / np.maximum(reach, 1e-12)
    return np.stack([np.sin(psi) * across[0], np.sin(psi) * across[1], np.cos(psi)])


def directions_to_disc(towards: Floats, angle: float = FAR_CAMERA_ANGLE_RAD) -> tuple[Floats, Floats]:
    """Places [2, ...] in the disc where directions are seen, and how fast these move with them [...], 1 / rad.

    The latter is along the radius, where it is least: 1/2 in the middle, 0 at the contour, and 0 for directions that
    the ball hides, whose place is on the contour.

    Args:
        towards: [3, ...], of unit length.
        angle: as of `disc_to_directions`.
    """
    normals = np.linspace(0, math.pi / 2 - angle, _NODES)
    beta = np.arctan2(np.sin(normals), 1 / math.sin(angle) - np.cos(normals))
    reach_of = CubicSpline(2 * normals + beta, np.tan(beta) / math.tan(angle))
    across = np.hypot(towards[0], towards[1])
    psi = np.minimum(np.arctan2(across, towards[2]), math.pi - angle)
    place = np.stack([towards[0], towards[1]]) / np.maximum(across, 1e-12) * reach_of(psi)
    return place, np.where(psi < math.pi - angle, reach_of(psi, 1).clip(0), 0.0)
