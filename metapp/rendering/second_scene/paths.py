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

PICTURE_PIXELS = PICTURE_HEIGHT_PX * PICTURE_WIDTH_PX
_FLOOR_CELLS, _SPHERE_CELLS = 64, (24, 48)  # patches: a square grid of the floor, rows and columns of the matte sphere
PATCH_COUNT = _FLOOR_CELLS**2 + _SPHERE_CELLS[0] * _SPHERE_CELLS[1]
MATRIX_ROWS = PICTURE_PIXELS + PATCH_COUNT
_CLOSE = 3.0  # half of the floor's cells lie within this distance of the middle, along x and along z
# roots of primes: the multiples of each fill the unit interval evenly, and independently of the others
_STRIDES = [math.sqrt(prime) % 1 for prime in (2, 3, 5, 7, 11, 13, 17, 19, 23, 29)]


class TransferPaths:
    """Paths from the rows of the matrix, the pixels and then the patches, back to the light.

    Arrays are Dr.Jit's, one entry a path.
    """

    def __init__(self) -> None:
        self.scene = mi.load_dict(second_scene_dict(mi))

    def to_texels(self, height: int, width: int, number: int) -> Tensor:
        """Radiance of the rows by that of the texels above the horizon, which they see or see in the glossy sphere.

        Returns:
            [rows, height / 2 * width], by the path of such a number from each row to each texel of the map.
        """
        texels = height // 2 * width
        lane = dr.arange(mi.UInt32, MATRIX_ROWS * texels)
        texel = lane % texels
        pair = self._draws(lane, dr.opaque(mi.Float, number))  # opaque, or each number would be compiled anew
        si = self._first_hit(lane // texels, pair())
        to_light = _direction(texel // width, texel % width, (height, width), pair())
        radiance = self._lit(si, to_light, si.is_valid()) + self._mirrored(si, to_light, pair())
        solid_angles = latlong.solid_angles(height, width)[: height // 2].expand(-1, width).flatten()
        return torch.from_numpy(radiance.numpy()).view(MATRIX_ROWS, texels) * solid_angles

    def to_patches(self, count: int = 256) -> Tensor:
        """Radiance of the rows by that of the patches, which they see or see in the glossy sphere, by rays of a row.

        Returns:
            [rows, patches], sparse.
        """
        lane = dr.arange(mi.UInt32, MATRIX_ROWS * count)
        pair = self._draws(lane // count, mi.Float(lane % count))
        si, weight = self._first_hit(lane // count, pair()), mi.Float(1)
        for is_glossy in (False, True):
            active = self._is_glossy(si) if is_glossy else si.is_valid()
            sample, value = si.bsdf().sample(mi.BSDFContext(), si, pair().x, pair(), active)
            weight *= dr.select(active, value.x, 1)
            beyond = self.scene.ray_intersect(si.spawn_ray(si.to_world(sample.wo)), active)
            si = dr.select(active, beyond, si)
        weight = dr.select(si.is_valid() & ~self._is_glossy(si), weight / count, 0)
        weights = torch.from_numpy(weight.numpy())
        patch = torch.from_numpy(self._patch(si.p).numpy().astype("int64"))
        ends = weights > 0
        places = torch.stack([torch.arange(MATRIX_ROWS).repeat_interleave(count)[ends], patch[ends]])
        return torch.sparse_coo_tensor(
            places, weights[ends], (MATRIX_ROWS, PATCH_COUNT), check_invariants=False
        ).coalesce()

    def _draws(self, stream: mt.UInt32, step: mt.Float) -> Callable[[], mt.Point2]:
        """Pairs of numbers in [0, 1): random for each stream, evenly spread over the steps of one stream."""
        state, sequence = mi.sample_tea_32(stream, 1)  # neighbouring streams of PCG32 would be alike
        rng, strides = mi.PCG32(initstate=state, initseq=sequence), iter(_STRIDES)

        def draw() -> mt.Float:
            value = rng.next_float32() + step * next(strides)
            return value - dr.floor(value)

        return lambda: mi.Point2f(draw(), draw())

    def _first_hit(self, row: mt.UInt32, place: mt.Point2) -> mt.Interaction:
        """The first hit of a row: through a place in its pixel, or at a place in its patch, seen from above."""
        film = (mi.Point2f(row % PICTURE_WIDTH_PX, row // PICTURE_WIDTH_PX) + place) / mi.Point2f(
            PICTURE_WIDTH_PX, PICTURE_HEIGHT_PX
        )
        view, _ = self.scene.sensors()[0].sample_ray(0, 0, film, mi.Point2f(0))
        patch = dr.select(row < PICTURE_PIXELS, 0, row - PICTURE_PIXELS)
        on_floor = patch < _FLOOR_CELLS**2
        cell = mi.Point2f(patch % _FLOOR_CELLS, patch // _FLOOR_CELLS)
        share = dr.clip((cell + place) * (2 / _FLOOR_CELLS) - 1, -0.995, 0.995)
        floor = _CLOSE * share / (1 - dr.abs(share))
        cell = patch - _FLOOR_CELLS**2
        outwards = _direction(cell // _SPHERE_CELLS[1], cell % _SPHERE_CELLS[1], _SPHERE_CELLS, place)
        normal = dr.select(on_floor, mi.Vector3f(0, 1, 0), outwards)
        point = dr.select(on_floor, mi.Point3f(floor.x, 0, floor.y), mi.Point3f(MATTE_CENTRE) + outwards)
        is_pixel = row < PICTURE_PIXELS
        start = dr.select(is_pixel, view.o, point + 1e-4 * normal)
        return self.scene.ray_intersect(mi.Ray3f(start, dr.select(is_pixel, view.d, -normal)))

    def _patch(self, point: mt.Point3) -> mt.UInt32:
        """The patch in which a point of the floor or of the matte sphere lies."""
        place = mi.Point2f(point.x, point.z)
        cell = dr.clip(mi.Point2i((place / (_CLOSE + dr.abs(place)) + 1) * (_FLOOR_CELLS / 2)), 0, _FLOOR_CELLS - 1)
        rows, columns = _SPHERE_CELLS
        outwards = point - mi.Point3f(MATTE_CENTRE)
        row = mi.Int(dr.safe_acos(outwards.y) * (rows / dr.pi))
        column = mi.Int(dr.atan2(-outwards.x, outwards.z) * (columns / dr.two_pi) + columns / 2)
        on_sphere = dr.clip(row, 0, rows - 1) * columns + dr.clip(column, 0, columns - 1)
        return dr.select(point.y < 1e-4, cell.y * _FLOOR_CELLS + cell.x, _FLOOR_CELLS**2 + on_sphere)

    def _is_glossy(self, si: mt.Interaction) -> mt.Mask:
        return si.is_valid() & mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.GlossyReflection)

    def _lit(self, si: mt.Interaction, to_light: mt.Vector3, active: mt.Mask) -> mt.Float:
        """Radiance of the surface that was hit, in unit light from a direction, per solid angle of the light."""
        value = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(to_light), active).x
        active &= value > 0
        active &= ~self.scene.ray_test(si.spawn_ray(to_light), active)
        return dr.select(active, value, 0)

    def _mirrored(self, si: mt.Interaction, to_light: mt.Vector3, place: mt.Point2) -> mt.Float:
        """The same, of a matte surface that was hit, in light that comes by way of the glossy sphere."""
        centre = mi.Point3f(GLOSSY_CENTRE)
        # The normal that mirrors the light to here lies between both directions; bisection finds it to 0.2 degrees.
        lightwards, hitherwards = to_light, dr.normalize(si.p - centre)
        for _ in range(10):
            normal = dr.normalize(lightwards + hitherwards)
            is_lightwards = dr.dot(normal, to_light) > dr.dot(normal, dr.normalize(si.p - centre - normal))
            lightwards = dr.select(is_lightwards, normal, lightwards)
            hitherwards = dr.select(is_lightwards, hitherwards, normal)
        # About it, the microfacets' distribution, narrower from nearby: there the mirror turns the way here along.
        alpha = GLOSSY_ALPHA / (1 + 0.5 / dr.norm(si.p - centre - normal))
        facets = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, alpha, False)
        turned, density = facets.sample(mi.Vector3f(0, 0, 1), place)
        normal = mi.Frame3f(normal).to_world(turned)
        way = centre + normal - si.p
        distance = dr.norm(way)
        way /= distance
        cosine = -dr.dot(way, normal)
        active = si.is_valid() & ~self._is_glossy(si) & (cosine > 0)
        value = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(way), active).x
        active &= value > 0
        there = self.scene.ray_intersect(si.spawn_ray(way), active)
        active &= self._is_glossy(there)
        value *= self._lit(there, to_light, active) * cosine / (dr.square(distance) * density)
        return dr.select(active, value, 0)


def _direction(row: mt.UInt32, column: mt.UInt32, shape: tuple[int, int], place: mt.Point2) -> mt.Vector3:
    """The direction to a place in [0, 1)^2 of a texel: uniform in solid angle if the place is uniform."""
    above, below = (dr.cos((mi.Float(row) + edge) * (dr.pi / shape[0])) for edge in (0, 1))
    y = dr.lerp(above, below, place.y)
    sine, cosine = dr.sincos((mi.Float(column) + place.x) * (dr.two_pi / shape[1]))
    radius = dr.safe_sqrt(1 - y * y)
    return mi.Vector3f(radius * sine, y, -radius * cosine)
