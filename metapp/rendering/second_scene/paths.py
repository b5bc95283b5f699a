"""Paths of the second scene, counted by the direction in which they leave it.

The last surface before the light is connected to every texel in turn (next-event estimation), unless it is the glossy
sphere seen from a matte surface: those few paths are found by turning the sphere's normal to where it mirrors the
texel. Light between matte surfaces goes through patches: rays of each pixel and of each patch say which patches they
see, and the patches' own rows of the matrix follow by iteration.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import torch
from torch import Tensor

from metapp.appearance import latlong
from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi
from metapp.rendering.second_scene.geometry import (
    GLOSSY_ALPHA,
    GLOSSY_CENTRE,
    MATTE_CENTRE,
    PICTURE_HEIGHT_PX,
    PICTURE_WIDTH_PX,
    second_scene_dict,
)

PICTURE_PIXELS = PICTURE_HEIGHT_PX * PICTURE_WIDTH_PX  # number of pixels
# patches: side of a square grid of the floor; rows and columns of the matte sphere
_FLOOR_CELLS, _SPHERE_CELLS = 64, (24, 48)
PATCH_COUNT = _FLOOR_CELLS**2 + _SPHERE_CELLS[0] * _SPHERE_CELLS[1]
MATRIX_ROWS = PICTURE_PIXELS + PATCH_COUNT  # pixels, then patches
_MEDIAN_FLOOR_DISTANCE = 3.0  # half of the floor's cells lie within this distance of the middle, along x and along z
# roots of primes: the multiples of each fill the unit interval evenly, and independently of the others
_STRIDES = [math.sqrt(prime) % 1 for prime in (2, 3, 5, 7, 11, 13, 17, 19, 23, 29)]


class TransferPaths:
    """The paths from the rows of the matrix, the pixels and then the patches, back to the light.

    Arrays are Dr.Jit's, one entry a path.

    Attributes:
        scene: Mitsuba's object of the second scene, without a light.
    """

    def __init__(self) -> None:
        self.scene = mi.load_dict(second_scene_dict(mi))

    def trace_to_texels(self, height: int, width: int, number: int) -> Tensor:
        """Trace one path from each row to each texel above the horizon, seen directly or in the glossy sphere.

        Args:
            height: rows of the map.
            width: columns of the map.
            number: number of the path; other numbers give other paths.

        Returns:
            Radiance of each row per radiance of each texel, [rows, height / 2 * width].
        """
        texels = height // 2 * width
        lane = dr.arange(mi.UInt32, MATRIX_ROWS * texels)
        texel = lane % texels
        # opaque, or kernels would be compiled anew for each number
        draw_pair = self._make_drawer(lane, dr.opaque(mi.Float, number))
        si = self._first_hit(lane // texels, draw_pair())
        to_light = _texel_direction(texel // width, texel % width, (height, width), draw_pair())
        radiance = self._reflect_light(si, to_light, si.is_valid()) + self._reflect_mirrored_light(
            si, to_light, draw_pair()
        )
        solid_angles = latlong.solid_angles(height, width)[: height // 2].expand(-1, width).flatten()
        return torch.from_numpy(radiance.numpy()).view(MATRIX_ROWS, texels) * solid_angles

    def trace_to_patches(self, count: int = 256) -> Tensor:
        """Trace rays from each row to the patches that it sees, directly or in the glossy sphere.

        Args:
            count: rays of each row.

        Returns:
            Radiance of each row per radiance of each patch, [rows, patches], sparse.
        """
        lane = dr.arange(mi.UInt32, MATRIX_ROWS * count)
        draw_pair = self._make_drawer(lane // count, mi.Float(lane % count))
        si, weight = self._first_hit(lane // count, draw_pair()), mi.Float(1)
        for is_glossy in (False, True):
            active = self._is_glossy(si) if is_glossy else si.is_valid()
            sample, value = si.bsdf().sample(mi.BSDFContext(), si, draw_pair().x, draw_pair(), active)
            weight *= dr.select(active, value.x, 1)
            next_hit = self.scene.ray_intersect(si.spawn_ray(si.to_world(sample.wo)), active)
            si = dr.select(active, next_hit, si)
        weight = dr.select(si.is_valid() & ~self._is_glossy(si), weight / count, 0)
        weights = torch.from_numpy(weight.numpy())
        patch = torch.from_numpy(self._find_patch(si.p).numpy().astype("int64"))
        reaches_patch = weights > 0
        indices = torch.stack([torch.arange(MATRIX_ROWS).repeat_interleave(count)[reaches_patch], patch[reaches_patch]])
        return torch.sparse_coo_tensor(
            indices, weights[reaches_patch], (MATRIX_ROWS, PATCH_COUNT), check_invariants=False
        ).coalesce()

    def _make_drawer(self, stream: mt.UInt32, step: mt.Float) -> Callable[[], mt.Point2]:
        """Return a function that draws pairs of numbers in [0, 1).

        They are random for each stream, and evenly spread over the steps of one stream.
        """
        state, sequence = mi.sample_tea_32(stream, 1)  # neighbouring streams of PCG32 would be alike
        rng, strides = mi.PCG32(initstate=state, initseq=sequence), iter(_STRIDES)

        def draw() -> mt.Float:
            value = rng.next_float32() + step * next(strides)
            return value - dr.floor(value)

        return lambda: mi.Point2f(draw(), draw())

    def _first_hit(self, row: mt.UInt32, place: mt.Point2) -> mt.Interaction:
        """Return the first hit of a row: through a place in its pixel, or at a place in its patch, seen from above."""
        film = (mi.Point2f(row % PICTURE_WIDTH_PX, row // PICTURE_WIDTH_PX) + place) / mi.Point2f(
            PICTURE_WIDTH_PX, PICTURE_HEIGHT_PX
        )
        view, _ = self.scene.sensors()[0].sample_ray(0, 0, film, mi.Point2f(0))
        patch = dr.select(row < PICTURE_PIXELS, 0, row - PICTURE_PIXELS)
        on_floor = patch < _FLOOR_CELLS**2
        cell = mi.Point2f(patch % _FLOOR_CELLS, patch // _FLOOR_CELLS)
        grid_place = dr.clip((cell + place) * (2 / _FLOOR_CELLS) - 1, -0.995, 0.995)
        floor_point = _MEDIAN_FLOOR_DISTANCE * grid_place / (1 - dr.abs(grid_place))
        cell = patch - _FLOOR_CELLS**2
        outwards = _texel_direction(cell // _SPHERE_CELLS[1], cell % _SPHERE_CELLS[1], _SPHERE_CELLS, place)
        normal = dr.select(on_floor, mi.Vector3f(0, 1, 0), outwards)
        point = dr.select(on_floor, mi.Point3f(floor_point.x, 0, floor_point.y), mi.Point3f(MATTE_CENTRE) + outwards)
        is_pixel = row < PICTURE_PIXELS
        start = dr.select(is_pixel, view.o, point + 1e-4 * normal)
        return self.scene.ray_intersect(mi.Ray3f(start, dr.select(is_pixel, view.d, -normal)))

    def _find_patch(self, point: mt.Point3) -> mt.UInt32:
        """Return the number of the patch in which a point of the floor or of the matte sphere lies."""
        place = mi.Point2f(point.x, point.z)
        cell = dr.clip(
            mi.Point2i((place / (_MEDIAN_FLOOR_DISTANCE + dr.abs(place)) + 1) * (_FLOOR_CELLS / 2)), 0, _FLOOR_CELLS - 1
        )
        rows, columns = _SPHERE_CELLS
        outwards = point - mi.Point3f(MATTE_CENTRE)
        row = mi.Int(dr.safe_acos(outwards.y) * (rows / dr.pi))
        column = mi.Int(dr.atan2(-outwards.x, outwards.z) * (columns / dr.two_pi) + columns / 2)
        on_sphere = dr.clip(row, 0, rows - 1) * columns + dr.clip(column, 0, columns - 1)
        return dr.select(point.y < 1e-4, cell.y * _FLOOR_CELLS + cell.x, _FLOOR_CELLS**2 + on_sphere)

    def _is_glossy(self, si: mt.Interaction) -> mt.Mask:
        """Return whether the surface that was hit is the glossy sphere."""
        return si.is_valid() & mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.GlossyReflection)

    def _reflect_light(self, si: mt.Interaction, to_light: mt.Vector3, active: mt.Mask) -> mt.Float:
        """Return radiance of the surface that was hit, in unit light from a direction, per solid angle of the light."""
        value = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(to_light), active).x
        active &= value > 0
        active &= ~self.scene.ray_test(si.spawn_ray(to_light), active)
        return dr.select(active, value, 0)

    def _reflect_mirrored_light(self, si: mt.Interaction, to_light: mt.Vector3, place: mt.Point2) -> mt.Float:
        """Return radiance of a matte surface that was hit, in unit light that the glossy sphere mirrors to it.

        Args:
            si: the hit.
            to_light: direction of the light.
            place: numbers in [0, 1)^2 for the direction of a microfacet.
        """
        centre = mi.Point3f(GLOSSY_CENTRE)
        # The normal that mirrors the light to the hit lies between both directions; bisection finds it to 0.2 degrees.
        lightwards, hitwards = to_light, dr.normalize(si.p - centre)
        for _ in range(10):
            normal = dr.normalize(lightwards + hitwards)
            is_lightwards = dr.dot(normal, to_light) > dr.dot(normal, dr.normalize(si.p - centre - normal))
            lightwards = dr.select(is_lightwards, normal, lightwards)
            hitwards = dr.select(is_lightwards, hitwards, normal)
        # Microfacets are drawn about it, by a narrower distribution from nearby, where the way turns with the normal.
        alpha = GLOSSY_ALPHA / (1 + 0.5 / dr.norm(si.p - centre - normal))
        facets = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, alpha, False)
        facet_normal, density = facets.sample(mi.Vector3f(0, 0, 1), place)
        normal = mi.Frame3f(normal).to_world(facet_normal)
        to_sphere = centre + normal - si.p
        distance = dr.norm(to_sphere)
        to_sphere /= distance
        cosine = -dr.dot(to_sphere, normal)
        active = si.is_valid() & ~self._is_glossy(si) & (cosine > 0)
        value = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(to_sphere), active).x
        active &= value > 0
        sphere_hit = self.scene.ray_intersect(si.spawn_ray(to_sphere), active)
        active &= self._is_glossy(sphere_hit)
        value *= self._reflect_light(sphere_hit, to_light, active) * cosine / (dr.square(distance) * density)
        return dr.select(active, value, 0)


def _texel_direction(row: mt.UInt32, column: mt.UInt32, shape: tuple[int, int], place: mt.Point2) -> mt.Vector3:
    """Return the direction to a place in a texel: uniform in solid angle if the place is uniform.

    Args:
        row: row of the texel.
        column: column of the texel.
        shape: rows and columns of the map.
        place: place in the texel, in [0, 1)^2.
    """
    above, below = (dr.cos((mi.Float(row) + edge) * (dr.pi / shape[0])) for edge in (0, 1))
    y = dr.lerp(above, below, place.y)
    sine, cosine = dr.sincos((mi.Float(column) + place.x) * (dr.two_pi / shape[1]))
    radius = dr.safe_sqrt(1 - y * y)
    return mi.Vector3f(radius * sine, y, -radius * cosine)
