"""The sampling lobes of `metapp.appearance.lobes` in Dr.Jit: directions above the surface, and their exact density.

`neural_brdf` samples a fitted network by them. This module does not know the network: it is given shares and GGX
roughness of lobes that were fitted elsewhere. Vectors are in the local frame of the surface, whose normal is z.
"""

from __future__ import annotations

import math

import numpy as np

from metapp.appearance.lobes import LAST_VIEWER_RAD, VIEWER_NODES, LobeMixture
from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi


class MitsubaLobeMixture:
    """A mixture of a cosine lobe and GGX lobes in Mitsuba's active variant, by which directions are sampled.

    Directions of a lobe below the surface are mirrored up, so the density integrates to 1 over the directions above.

    Attributes:
        alphas: GGX roughness of each GGX lobe along the two axes of the material.
        axes_azimuth_rad: azimuth of the material's axes.
        shares: share of each lobe, the cosine first, at each node of the viewer's angle.
    """

    def __init__(self, lobes: LobeMixture) -> None:
        self.alphas, self.axes_azimuth_rad = lobes.alphas, lobes.azimuth_rad
        self.shares = [mi.Float(column) for column in lobes.shares.astype(np.float32).T]

    def lobe_shares(self, viewer: mt.Vector3) -> list[mt.Float]:
        """Return the share of each lobe for a viewer's direction, the cosine first, interpolated between nodes."""
        place = dr.minimum(dr.safe_acos(viewer.z) * ((VIEWER_NODES - 1) / LAST_VIEWER_RAD), VIEWER_NODES - 1)
        node = mi.UInt32(dr.minimum(place, VIEWER_NODES - 2))
        left, right = ([dr.gather(mi.Float, share, node + i) for share in self.shares] for i in (0, 1))
        return [dr.lerp(a, b, place - node) for a, b in zip(left, right, strict=True)]

    def sample(self, viewer: mt.Vector3, number: mt.Float, point: mt.Point2) -> mt.Vector3:
        """Sample a direction of the light above the surface.

        Args:
            viewer: direction of the viewer, above the surface.
            number: a random number in [0, 1), which chooses the lobe.
            point: a random point in [0, 1)^2, which chooses the direction within the lobe.
        """
        shares = self.lobe_shares(viewer)
        viewer = self._into_axes(viewer)
        alpha, cumulative_share = mi.Vector2f(self.alphas[0]), shares[0] + shares[1]
        for share, next_alpha in zip(shares[2:], self.alphas[1:], strict=True):
            alpha = dr.select(number < cumulative_share, alpha, mi.Vector2f(next_alpha))
            cumulative_share += share
        light = mi.reflect(viewer, sample_visible_normal(viewer, alpha, point))
        light = mi.Vector3f(light.x, light.y, dr.abs(light.z))
        light = turn_about_normal(light, self.axes_azimuth_rad) if self.axes_azimuth_rad else light
        return dr.select(number < shares[0], mi.warp.square_to_cosine_hemisphere(point), light)

    def density(self, viewer: mt.Vector3, light: mt.Vector3) -> mt.Float:
        """Return the density per solid angle with which :meth:`sample` draws a light's direction above the surface."""
        shares = self.lobe_shares(viewer)
        viewer, light = self._into_axes(viewer), self._into_axes(light)
        mirrored_light = mi.Vector3f(light.x, light.y, -light.z)
        density = shares[0] * light.z * dr.inv_pi
        for share, alpha in zip(shares[1:], self.alphas, strict=True):
            density += share * (lobe_density(viewer, light, alpha) + lobe_density(viewer, mirrored_light, alpha))
        return density

    def _into_axes(self, direction: mt.Vector3) -> mt.Vector3:
        return turn_about_normal(direction, -self.axes_azimuth_rad) if self.axes_azimuth_rad else direction


def turn_about_normal(direction: mt.Vector3, angle_rad: float) -> mt.Vector3:
    """Turn a direction about the normal, from x towards y."""
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    return mi.Vector3f(
        cosine * direction.x - sine * direction.y, sine * direction.x + cosine * direction.y, direction.z
    )


def sample_visible_normal(viewer: mt.Vector3, alpha: mt.Vector2, point: mt.Point2) -> mt.Vector3:
    """Sample the normal of a facet that a viewer sees, by a spherical cap (Dupuy and Benyoub 2023).

    Mitsuba's own sampling inverts slopes: at grazing angles it draws NaN once in a million times.

    Args:
        viewer: direction of the viewer, above the surface.
        alpha: GGX roughness along the two axes.
        point: a random point in [0, 1)^2.
    """
    stretched = dr.normalize(mi.Vector3f(alpha.x * viewer.x, alpha.y * viewer.y, viewer.z))
    # the z of cap point + stretched viewer; as a product, and not a sum, it never rounds below 0
    height = (1 - point.x) * (1 + stretched.z)
    z = height - stretched.z
    sine, (sin_phi, cos_phi) = dr.safe_sqrt(1 - z * z), dr.sincos(2 * math.pi * point.y)
    x, y = sine * cos_phi + stretched.x, sine * sin_phi + stretched.y
    return dr.normalize(mi.Vector3f(alpha.x * x, alpha.y * y, height))


def lobe_density(viewer: mt.Vector3, light: mt.Vector3, alpha: tuple[float, float]) -> mt.Float:
    """Return the density of a light drawn by mirroring the viewer at a visible facet: D G1 / (4 cos theta_viewer).

    Args:
        viewer: unit vectors above the surface.
        light: unit vectors, which may be below the surface.
        alpha: GGX roughness along the two axes.
    """
    half, (alpha_x, alpha_y) = viewer + light, alpha  # the half vector at any length: the formulas are homogeneous
    spread = dr.square(half.x / alpha_x) + dr.square(half.y / alpha_y) + dr.square(half.z)
    # where directions are opposite no facet mirrors one into the other, and 0 / 0 should be 0
    distribution = dr.square(dr.squared_norm(half) / dr.maximum(spread, 1e-30)) / (math.pi * alpha_x * alpha_y)
    slope = dr.square(alpha_x * viewer.x) + dr.square(alpha_y * viewer.y)
    masking = 2 / (viewer.z + dr.sqrt(slope + dr.square(viewer.z)))  # G1 / cos theta, finite at grazing angles
    return dr.select(half.z > 0, distribution * masking / 4, 0)
