"""A ball in a photograph: which direction each of its pixels mirrors, and where each direction is seen.

The ball has radius 1 and its camera looks at it from +z, x to the right, y up, as in `metapp.appearance.latlong`. A
point of its picture is told by its place in a disc of radius 1, which the contour bounds: in the plane through the
ball's centre that faces the camera, seen from there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating]


class Lens(NamedTuple):
    """A pinhole camera: its focal length and where its axis meets the picture, in px."""

    focal: float
    x: float
    y: float


class Ball(NamedTuple):
    """A ball in a photograph; px from the picture's upper left corner, so that the first pixel's centre is (.5, .5).

    Attributes:
        x, y: where its centre is seen.
        radius: of its contour; with a lens, measured in the plane through (x, y) that faces the camera.
        lens: None is one that is far away, whose rays are parallel and to which the contour is a circle.
        score: how much of the contour is there, in [0, 1].
    """

    x: float
    y: float
    radius: float
    lens: Lens | None = None
    score: float = 1.0

    @property
    def angle(self) -> float:
        """Half the angle that it fills, rad; 0 from far away. Directions as close to its back are not seen."""
        if self.lens is None:
            return 0.0
        away = math.sqrt((self.x - self.lens.x) ** 2 + (self.y - self.lens.y) ** 2 + self.lens.focal**2)
        return math.atan(self.radius / away)

    def to_px(self, disc: Floats) -> Floats:
        """Places [2, ...] in the disc (right, up) as px [2, ...] of the photograph (right, down)."""
        if self.lens is None:
            return np.stack([self.x + self.radius * disc[0], self.y - self.radius * disc[1]])
        centre, right, up = self._axes()
        points = centre[:, None] + self.radius * (np.outer(right, disc[0]) + np.outer(up, disc[1]))
        seen = self.lens.focal * points[:2] / points[2] + np.array([[self.lens.x], [self.lens.y]])
        result: Floats = seen.reshape(disc.shape)
        return result

    def _axes(self) -> tuple[Floats, Floats, Floats]:
        """Centre, right and up of the disc for a camera that looks to +z, x right, y down; unit px."""
        assert self.lens is not None
        centre = np.array([self.x - self.lens.x, self.y - self.lens.y, self.lens.focal])
        right = np.cross([0.0, 1.0, 0.0], centre)
        right /= np.linalg.norm(right)
        up = np.cross(right, centre)
        return centre, right, up / np.linalg.norm(up) * (1 if up[1] < 0 else -1)

    def scaled(self, share: float) -> Ball:
        """The same in a picture of another size."""
        lens = self.lens and Lens(*(share * value for value in self.lens))
        return self._replace(x=share * self.x, y=share * self.y, radius=share * self.radius, lens=lens)


def mirrored(disc: Floats, angle: float = 0.0) -> Floats:
    """Directions [3, ...] that places [2, ...] in the disc mirror; beyond the contour those of the contour.

    Args:
        disc: right, up.
        angle: half the angle that the ball fills for its camera, rad.
    """
    reach = np.hypot(disc[0], disc[1])
    inside = np.minimum(reach, 1)
    # the law of sines in the triangle of camera, centre and point; asin(sin(beta) / sin(angle)) from far away
    beta = np.arctan(inside * math.tan(angle))
    ratio = inside if angle == 0 else np.minimum(np.sin(beta) / math.sin(angle), 1)
    psi = 2 * np.arcsin(ratio) - beta  # the angle of incidence twice, less what the ray leans
    across = disc / np.maximum(reach, 1e-12)
    return np.stack([np.sin(psi) * across[0], np.sin(psi) * across[1], np.cos(psi)])


def seen_at(towards: Floats, angle: float = 0.0) -> tuple[Floats, Floats]:
    """Places [2, ...] in the disc where directions are seen, and how fast these move with them [...], 1 / rad.

    The latter is along the radius, where it is least: 1/2 in the middle, 0 at the contour, and 0 for directions that
    the ball hides, whose place is on the contour.

    Args:
        towards: [3, ...], of unit length.
        angle: as of `mirrored`.
    """
    across = np.hypot(towards[0], towards[1])
    psi = np.arctan2(across, towards[2])
    limit = math.pi - angle
    hidden = psi >= limit
    psi = np.minimum(psi, limit)
    reach, speed = (np.sin(psi / 2), np.cos(psi / 2) / 2) if angle == 0 else _reach(psi, angle)
    place = np.stack([towards[0], towards[1]]) / np.maximum(across, 1e-12) * reach
    return place, np.where(hidden, 0.0, np.maximum(speed, 0.0))


def _reach(psi: Floats, angle: float) -> tuple[Floats, Floats]:
    """Distance from the disc's middle of a direction `psi` off the axis, and its derivative, by Newton's method."""
    away = 1 / math.sin(angle)  # of the camera
    most = math.pi / 2 - angle
    phi = psi / (math.pi - angle) * most  # of the normal
    for _ in range(8):
        beta = np.arctan2(np.sin(phi), away - np.cos(phi))
        slope = 2 + (away * np.cos(phi) - 1) / (away * away - 2 * away * np.cos(phi) + 1)
        phi = np.clip(phi - (2 * phi + beta - psi) / slope, 0, most)
    beta = np.arctan2(np.sin(phi), away - np.cos(phi))
    turn = (away * np.cos(phi) - 1) / (away * away - 2 * away * np.cos(phi) + 1)
    speed = turn / np.cos(beta) ** 2 / math.tan(angle) / (2 + turn)
    return np.tan(beta) / math.tan(angle), speed


def sampled(planes: Floats, px: Floats) -> Floats:
    """Values [C, ...] of planes [C, H, W] at px [2, ...], interpolated; beyond the borders those at them."""
    height, width = planes.shape[1:]
    x, y = np.clip(px[0] - 0.5, 0, width - 1.001), np.clip(px[1] - 0.5, 0, height - 1.001)
    column, row = x.astype(int), y.astype(int)
    x, y = x - column, y - row
    upper = planes[:, row, column] * (1 - x) + planes[:, row, column + 1] * x
    lower = planes[:, row + 1, column] * (1 - x) + planes[:, row + 1, column + 1] * x
    result: Floats = upper * (1 - y) + lower * y
    return result
