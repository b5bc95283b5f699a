"""Lobes of `metapp.appearance.lobes` in Dr.Jit: directions above the surface, and their exact density."""

from __future__ import annotations

import math

import numpy as np

from metapp.appearance.lobes import LAST_VIEWER_RAD, VIEWER_NODES, LobeMixture
from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi


class MitsubaLobeMixture:
    """Lobes in the active variant.

    Directions of a lobe below the surface are mirrored up, so the density integrates to 1 over the directions above.
    """

    def __init__(self, lobes: LobeMixture) -> None:
        self.alphas, self.turn = lobes.alphas, lobes.turn
        self.shares = [mi.Float(column) for column in lobes.shares.astype(np.float32).T]

    def shares_of(self, viewer: mt.Vector3) -> list[mt.Float]:
        """The share of each lobe, the cosine first, for a viewer's direction; between nodes linearly."""
        place = dr.minimum(dr.safe_acos(viewer.z) * ((VIEWER_NODES - 1) / LAST_VIEWER_RAD), VIEWER_NODES - 1)
        node = mi.UInt32(dr.minimum(place, VIEWER_NODES - 2))
        first, second = ([dr.gather(mi.Float, share, node + i) for share in self.shares] for i in (0, 1))
        return [dr.lerp(a, b, place - node) for a, b in zip(first, second, strict=True)]

    def sample(self, viewer: mt.Vector3, number: mt.Float, point: mt.Point2) -> mt.Vector3:
        """A direction above the surface, of a number and a point in [0, 1)."""
        shares = self.shares_of(viewer)
        viewer = self._into_axes(viewer)
        alpha, end = mi.Vector2f(self.alphas[0]), shares[0] + shares[1]
        for share, other in zip(shares[2:], self.alphas[1:], strict=True):
            alpha = dr.select(number < end, alpha, mi.Vector2f(other))
            end += share
        light = mi.reflect(viewer, sample_visible_normal(viewer, alpha, point))
        light = mi.Vector3f(light.x, light.y, dr.abs(light.z))
        light = turn_about_normal(light, self.turn) if self.turn else light
        return dr.select(number < shares[0], mi.warp.square_to_cosine_hemisphere(point), light)

    def density(self, viewer: mt.Vector3, light: mt.Vector3) -> mt.Float:
        """Density of `sample` for directions above the surface, per solid angle."""
        shares = self.shares_of(viewer)
        viewer, light = self._into_axes(viewer), self._into_axes(light)
        below = mi.Vector3f(light.x, light.y, -light.z)
        total = shares[0] * light.z * dr.inv_pi
        for share, alpha in zip(shares[1:], self.alphas, strict=True):
            total += share * (lobe_density(viewer, light, alpha) + lobe_density(viewer, below, alpha))
        return total

    def _into_axes(self, direction: mt.Vector3) -> mt.Vector3:
        return turn_about_normal(direction, -self.turn) if self.turn else direction


def turn_about_normal(direction: mt.Vector3, angle_rad: float) -> mt.Vector3:
    """A direction turned about the normal."""
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    return mi.Vector3f(
        cosine * direction.x - sine * direction.y, sine * direction.x + cosine * direction.y, direction.z
    )


def sample_visible_normal(viewer: mt.Vector3, alpha: mt.Vector2, point: mt.Point2) -> mt.Vector3:
    """Normals of facets that a viewer sees, of GGX roughness alpha (Dupuy and Benyoub 2023: a spherical cap).

    Mitsuba's own inverts slopes: at grazing angles it draws NaN once in a million times.
    """
    stretched = dr.normalize(mi.Vector3f(alpha.x * viewer.x, alpha.y * viewer.y, viewer.z))
    height = (1 - point.x) * (1 + stretched.z)  # of the sum; written out, it never rounds below 0
    z = height - stretched.z
    sine, (sin_phi, cos_phi) = dr.safe_sqrt(1 - z * z), dr.sincos(2 * math.pi * point.y)
    first, second = sine * cos_phi + stretched.x, sine * sin_phi + stretched.y
    return dr.normalize(mi.Vector3f(alpha.x * first, alpha.y * second, height))


def lobe_density(viewer: mt.Vector3, light: mt.Vector3, alpha: tuple[float, float]) -> mt.Float:
    """Density of a light drawn by mirroring the viewer at a visible facet: D G1 / (4 cos theta of the viewer).

    Args:
        viewer: above the surface.
        light: unit vectors, which may be below.
        alpha: GGX roughness along the two axes.
    """
    half, (first, second) = viewer + light, alpha  # of any length
    spread = dr.square(half.x / first) + dr.square(half.y / second) + dr.square(half.z)
    # where directions are opposite no facet mirrors one into the other, and 0 / 0 should be 0
    distribution = dr.square(dr.squared_norm(half) / dr.maximum(spread, 1e-30)) / (math.pi * first * second)
    slope = dr.square(first * viewer.x) + dr.square(second * viewer.y)
    masking = 2 / (viewer.z + dr.sqrt(slope + dr.square(viewer.z)))  # G1 / cos theta, finite at grazing angles
    return dr.select(half.z > 0, distribution * masking / 4, 0)
