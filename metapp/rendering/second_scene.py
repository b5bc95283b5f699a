"""The second scene, in which inferred illumination is judged: a matte and a glossy sphere on a floor, by Mitsuba.

All is neutral grey, as the grey and the mirror ball that film sets are lit by: what colour there is in a picture is the
light's. The floor fills the picture and reaches to the horizon, so no pixel shows the map itself, and the lower half of
a map does nothing. Pictures are linear in the map, which makes the scene a matrix: a thousand maps cost one rendering.

The matrix counts paths by where they leave the scene. The last surface before the light is joined to every texel in
turn ("next-event estimation"), unless it is the glossy sphere seen from a matte surface: those few paths are found by
turning the sphere's normal to where it mirrors the texel. Light between matte surfaces goes through patches: rays of
each pixel and of each patch say which patches they see, and the patches' own rows of the matrix follow by iteration.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import save
from torch import Tensor

from metapp.appearance import latlong
from metapp.rendering.variant import load_mitsuba
from metapp.storage.cache import cache_folder
from metapp.storage.files import write_atomically
from metapp.storage.tensors import read_tensors

VERSION = 1  # of the scene and its matrix, in the name of the cached file
HEIGHT, WIDTH = 64, 96  # of the picture, px
SAMPLES = 16384  # paths from each pixel to the light, spread over the texels
FLOOR_ALBEDO, MATTE_ALBEDO, GLOSSY_REFLECTANCE = 0.5, 0.7, 0.9
ALPHA = 0.12  # of the glossy sphere, GGX
MATTE_CENTRE, GLOSSY_CENTRE = (-1.15, 1.0, 0.0), (1.15, 1.0, 0.0)  # both spheres have radius 1; y = 0 is the floor
CAMERA, TARGET, FIELD_DEGREES = (0.0, 4.6, 9.0), (0.0, 0.75, 0.1), 32.0  # field of view across the picture
FINER = 8  # a texel becomes so many, squared, for Mitsuba's `envmap`, which would else blend it with its neighbours

_PIXELS = HEIGHT * WIDTH
_FLOOR_CELLS, _SPHERE_CELLS = 64, (24, 48)  # patches: a square grid of the floor, rows and columns of the matte sphere
_PATCHES = _FLOOR_CELLS**2 + _SPHERE_CELLS[0] * _SPHERE_CELLS[1]
_ROWS = _PIXELS + _PATCHES
_CLOSE = 3.0  # half of the floor's cells lie within this distance of the middle, along x and along z
_BOUNCES = 4  # between patches; what is left out is 0.1 % of the light
# roots of primes: the multiples of each fill the unit interval evenly, and independently of the others
_STRIDES = [math.sqrt(prime) % 1 for prime in (2, 3, 5, 7, 11, 13, 17, 19, 23, 29)]

Report = Callable[[int, int], object]
"""Called with how many passes are done, and how many there are."""


def transfer(height: int = 32, width: int = 64, *, report: Report = lambda done, total: None) -> Tensor:
    """The scene as a matrix, from the cache, or else built now, in about 20 s on one core.

    Args:
        height: rows of the maps, even.
        width: their columns.
        report: told of the progress where it is built.

    Returns:
        [P, N] float32, >= 0, with the pixels P and the texels N in row-major order, the same for each colour:
        picture[p] = sum over t of matrix[p, t] * map[t]. It is kept in memory: do not change it.

    Raises:
        ValueError: an odd height; no Mitsuba that can render here.
    """
    if height < 2 or height % 2 or width < 1:
        raise ValueError(f"second scene: maps of {height} x {width} texels, expected an even number of rows.")
    path = matrix_path(height, width)
    with suppress(OSError, SafetensorError, KeyError):  # not there, or damaged
        return _load(path, path.stat().st_mtime_ns)
    matrix = _build(height, width, report)
    write_atomically(path, lambda partial: partial.write_bytes(save({"matrix": matrix})))
    return matrix


def matrix_path(height: int = 32, width: int = 64) -> Path:
    """Where the cache keeps the matrix for maps of that size."""
    return cache_folder() / f"second-scene-{height}x{width}-v{VERSION}.safetensors"


@functools.lru_cache(maxsize=1)
def _load(path: Path, changed: int) -> Tensor:
    return read_tensors(path)["matrix"]


def relight(maps: Tensor, *, height: int = 32, width: int = 64) -> Tensor:
    """Pictures [B, 3, 64, 96] of the scene, linear RGB radiance, under maps [B, 3, H, W] of any size.

    Args:
        maps: linear RGB radiance; each texel of the matrix's maps takes the mean radiance over its area.
        height: rows of the matrix's maps.
        width: their columns.
    """
    texels = latlong.resample(maps, height, width).flatten(-2)
    result: Tensor = (texels @ transfer(height, width).to(maps).T).unflatten(-1, (HEIGHT, WIDTH))
    return result


def direct(illumination: Tensor, spp: int = 256, *, seed: int = 0) -> Tensor:
    """The picture [3, 64, 96] by Mitsuba's path tracer, under one map [3, H, W] that is constant in each texel."""
    mi = load_mitsuba()
    texels = illumination.repeat_interleave(FINER, -2).repeat_interleave(FINER, -1)
    bitmap = mi.Bitmap(texels.movedim(0, -1).float().cpu().contiguous().numpy())
    scene = mi.load_dict({**_scene(mi), "light": {"type": "envmap", "bitmap": bitmap}})
    return torch.from_numpy(mi.render(scene, spp=spp, seed=seed).numpy()).movedim(-1, 0)


def _scene(mi: Any) -> dict[str, Any]:
    frame = mi.ScalarTransform4f()
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 16},
        "sensor": {
            "type": "perspective",
            "fov": FIELD_DEGREES,
            "to_world": frame.look_at(origin=CAMERA, target=TARGET, up=[0, 1, 0]),
            "film": {
                "type": "hdrfilm",
                "width": WIDTH,
                "height": HEIGHT,
                "pixel_format": "rgb",
                "rfilter": {"type": "box"},
            },
        },
        "floor": {
            "type": "rectangle",
            "to_world": frame.rotate([1, 0, 0], -90).scale(1000),
            "bsdf": {"type": "diffuse", "reflectance": FLOOR_ALBEDO},
        },
        "matte": {
            "type": "sphere",
            "center": MATTE_CENTRE,
            "bsdf": {"type": "diffuse", "reflectance": MATTE_ALBEDO},
        },
        "glossy": {
            "type": "sphere",
            "center": GLOSSY_CENTRE,
            "bsdf": {
                "type": "roughconductor",
                "material": "none",
                "distribution": "ggx",
                "alpha": ALPHA,
                "specular_reflectance": GLOSSY_REFLECTANCE,
            },
        },
    }


def _build(height: int, width: int, report: Report) -> Tensor:
    """The matrix of `transfer`: what the map lights, and what sees patches that are lit."""
    paths = _Paths()
    passes = math.ceil(SAMPLES / (height // 2 * width))
    lit = torch.zeros(_ROWS, height // 2 * width)
    for number in range(passes):
        lit += paths.to_texels(height, width, number) / passes
        report(number + 1, passes)
    seen, total = paths.to_patches(), lit
    for _ in range(_BOUNCES):
        total = lit + torch.sparse.mm(seen, total[_PIXELS:])
    upper = total[:_PIXELS]
    return torch.cat([upper, torch.zeros_like(upper)], dim=1)  # the floor hides all below the horizon


class _Paths:
    """Paths from the rows of the matrix, the pixels and then the patches, back to the light.

    Arrays are Dr.Jit's, one entry a path; `at` is where the paths are on a surface, a SurfaceInteraction3f of Mitsuba.
    """

    def __init__(self) -> None:
        import drjit

        self.mi, self.dr = load_mitsuba(), drjit
        self.scene = self.mi.load_dict(_scene(self.mi))

    def to_texels(self, height: int, width: int, number: int) -> Tensor:
        """Radiance of the rows by that of the texels above the horizon, which they see or see in the glossy sphere.

        Args:
            height: rows of the map.
            width: its columns.
            number: of the path from each row to each texel that this is.

        Returns:
            [rows, height / 2 * width].
        """
        mi, dr = self.mi, self.dr
        texels = height // 2 * width
        lane = dr.arange(mi.UInt32, _ROWS * texels)
        texel = lane % texels
        pair = self._draws(lane, dr.opaque(mi.Float, number))  # opaque, or each number would be compiled anew
        at = self._first_hit(lane // texels, pair())
        to_light = _direction(mi, dr, texel // width, texel % width, (height, width), pair())
        radiance = self._lit(at, to_light, at.is_valid()) + self._mirrored(at, to_light, pair())
        solid_angles = latlong.solid_angles(height, width)[: height // 2].expand(-1, width).flatten()
        return torch.from_numpy(radiance.numpy()).view(_ROWS, texels) * solid_angles

    def to_patches(self, count: int = 256) -> Tensor:
        """Radiance of the rows by that of the patches, which they see or see in the glossy sphere.

        Args:
            count: rays of a row.

        Returns:
            [rows, patches], sparse.
        """
        mi, dr = self.mi, self.dr
        lane = dr.arange(mi.UInt32, _ROWS * count)
        pair = self._draws(lane // count, mi.Float(lane % count))
        at, weight = self._first_hit(lane // count, pair()), mi.Float(1)
        tests: tuple[Callable[[Any], Any], ...] = (lambda at: at.is_valid(), self._is_glossy)
        for onwards in tests:
            active = onwards(at)
            sample, value = at.bsdf().sample(mi.BSDFContext(), at, pair().x, pair(), active)
            weight *= dr.select(active, value.x, 1)
            beyond = self.scene.ray_intersect(at.spawn_ray(at.to_world(sample.wo)), active)
            at = dr.select(active, beyond, at)
        weight = dr.select(at.is_valid() & ~self._is_glossy(at), weight / count, 0)
        found = torch.from_numpy(weight.numpy())
        patch = torch.from_numpy(self._patch(at.p).numpy().astype("int64"))
        ends = found > 0
        places = torch.stack([torch.arange(_ROWS).repeat_interleave(count)[ends], patch[ends]])
        return torch.sparse_coo_tensor(places, found[ends], (_ROWS, _PATCHES), check_invariants=False).coalesce()

    def _draws(self, stream: Any, step: Any) -> Callable[[], Any]:
        """Pairs of numbers in [0, 1): random for each stream, evenly spread over the steps of one stream."""
        mi, dr = self.mi, self.dr
        state, sequence = mi.sample_tea_32(stream, 1)  # neighbouring streams of PCG32 would be alike
        rng, strides = mi.PCG32(initstate=state, initseq=sequence), iter(_STRIDES)

        def draw() -> Any:
            value = rng.next_float32() + step * next(strides)
            return value - dr.floor(value)

        return lambda: mi.Point2f(draw(), draw())

    def _first_hit(self, row: Any, place: Any) -> Any:
        """What a row looks at: the scene through a place in its pixel, or a place in its patch, seen from above it."""
        mi, dr = self.mi, self.dr
        film = (mi.Point2f(row % WIDTH, row // WIDTH) + place) / mi.Point2f(WIDTH, HEIGHT)
        view, _ = self.scene.sensors()[0].sample_ray(0, 0, film, mi.Point2f(0))
        patch = dr.select(row < _PIXELS, 0, row - _PIXELS)
        on_floor = patch < _FLOOR_CELLS**2
        cell = mi.Point2f(patch % _FLOOR_CELLS, patch // _FLOOR_CELLS)
        share = dr.clip((cell + place) * (2 / _FLOOR_CELLS) - 1, -0.995, 0.995)
        floor = _CLOSE * share / (1 - dr.abs(share))
        cell = patch - _FLOOR_CELLS**2
        outwards = _direction(mi, dr, cell // _SPHERE_CELLS[1], cell % _SPHERE_CELLS[1], _SPHERE_CELLS, place)
        normal = dr.select(on_floor, mi.Vector3f(0, 1, 0), outwards)
        point = dr.select(on_floor, mi.Point3f(floor.x, 0, floor.y), mi.Point3f(MATTE_CENTRE) + outwards)
        is_pixel = row < _PIXELS
        start = dr.select(is_pixel, view.o, point + 1e-4 * normal)
        return self.scene.ray_intersect(mi.Ray3f(start, dr.select(is_pixel, view.d, -normal)))

    def _patch(self, point: Any) -> Any:
        """The patch in which a point of the floor or of the matte sphere lies."""
        mi, dr = self.mi, self.dr
        place = mi.Point2f(point.x, point.z)
        cell = dr.clip(mi.Point2i((place / (_CLOSE + dr.abs(place)) + 1) * (_FLOOR_CELLS / 2)), 0, _FLOOR_CELLS - 1)
        rows, columns = _SPHERE_CELLS
        outwards = point - mi.Point3f(MATTE_CENTRE)
        row = mi.Int(dr.safe_acos(outwards.y) * (rows / dr.pi))
        column = mi.Int(dr.atan2(-outwards.x, outwards.z) * (columns / dr.two_pi) + columns / 2)
        on_sphere = dr.clip(row, 0, rows - 1) * columns + dr.clip(column, 0, columns - 1)
        return dr.select(point.y < 1e-4, cell.y * _FLOOR_CELLS + cell.x, _FLOOR_CELLS**2 + on_sphere)

    def _is_glossy(self, at: Any) -> Any:
        return at.is_valid() & self.mi.has_flag(at.bsdf().flags(), self.mi.BSDFFlags.GlossyReflection)

    def _lit(self, at: Any, to_light: Any, active: Any) -> Any:
        """Radiance of what was hit, in unit light from a direction, per solid angle of the light."""
        value = at.bsdf().eval(self.mi.BSDFContext(), at, at.to_local(to_light), active).x
        active &= value > 0
        active &= ~self.scene.ray_test(at.spawn_ray(to_light), active)
        return self.dr.select(active, value, 0)

    def _mirrored(self, at: Any, to_light: Any, place: Any) -> Any:
        """The same, of what was hit if it is matte, in light that comes by way of the glossy sphere."""
        mi, dr = self.mi, self.dr
        centre = mi.Point3f(GLOSSY_CENTRE)
        # The normal that mirrors the light to here lies between both directions; bisection finds it to 0.2 degrees.
        lightwards, hitherwards = to_light, dr.normalize(at.p - centre)
        for _ in range(10):
            normal = dr.normalize(lightwards + hitherwards)
            is_lightwards = dr.dot(normal, to_light) > dr.dot(normal, dr.normalize(at.p - centre - normal))
            lightwards = dr.select(is_lightwards, normal, lightwards)
            hitherwards = dr.select(is_lightwards, hitherwards, normal)
        # About it, the microfacets' distribution, narrower from nearby: there the mirror turns the way here along.
        alpha = ALPHA / (1 + 0.5 / dr.norm(at.p - centre - normal))
        facets = mi.MicrofacetDistribution(mi.MicrofacetType.GGX, alpha, alpha, False)
        turned, density = facets.sample(mi.Vector3f(0, 0, 1), place)
        normal = mi.Frame3f(normal).to_world(turned)
        way = centre + normal - at.p
        distance = dr.norm(way)
        way /= distance
        cosine = -dr.dot(way, normal)
        active = at.is_valid() & ~self._is_glossy(at) & (cosine > 0)
        value = at.bsdf().eval(mi.BSDFContext(), at, at.to_local(way), active).x
        active &= value > 0
        there = self.scene.ray_intersect(at.spawn_ray(way), active)
        active &= self._is_glossy(there)
        value *= self._lit(there, to_light, active) * cosine / (dr.square(distance) * density)
        return dr.select(active, value, 0)


def _direction(mi: Any, dr: Any, row: Any, column: Any, shape: tuple[int, int], place: Any) -> Any:
    """The direction to a place in [0, 1)^2 of a texel: uniform in solid angle where the place is uniform."""
    above, below = (dr.cos((mi.Float(row) + edge) * (dr.pi / shape[0])) for edge in (0, 1))
    y = dr.lerp(above, below, place.y)
    sine, cosine = dr.sincos((mi.Float(column) + place.x) * (dr.two_pi / shape[1]))
    radius = dr.safe_sqrt(1 - y * y)
    return mi.Vector3f(radius * sine, y, -radius * cosine)
