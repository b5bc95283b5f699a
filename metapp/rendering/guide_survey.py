"""A look at a scene before its picture is made: few paths, which say what places send out, and who sees whom.

What comes to a place from a direction is what the place that is met there sends out. The paths of a small render
estimate the latter, one number for each place; rays from each place find who is met in which cell of directions. This
knows the shapes of a scene, which the sums of `guide_cache` learn only from many more paths.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from metapp.rendering.guide_cache import AXES, CELLS, GRID, PLACES, SIDE, GuideCache, relative, voxels_of
from metapp.rendering.guided_path import RECORDED, Bounce, PathTracer, Records

SEEN = ("arriving", "emitted", "distance", "cosine", "paths")  # features
PROBES = 4  # rays of each cell
FILM = 128  # paths along a side of the film
LEAN = 8.0  # paths that a place's surroundings count as
CHAIN = 6  # mirrors and glass that a ray follows

_HALF = GRID // 2
_BRIGHTEST = 1e4  # luminance; more says no more
_SPACE = 1e-4  # by which rays start off a surface


class Seen(NamedTuple):
    """What is seen from the places of voxels of twice the side.

    Attributes:
        rows: of each such place its number here, or -1, [places].
        voxels: the places, three whole numbers and an axis each, [P, 4].
        features: float32 [P, len(SEEN), SIDE, SIDE]. Over cells of directions: logarithms of the square of what is
            expected to arrive; which part of it emitters send that are met; log(1 + distance); the cosine at what is
            met; and of how many paths it is known what that sends out.
    """

    rows: Tensor
    voxels: Tensor
    features: Tensor

    def find(self, voxels: Tensor) -> tuple[Tensor, Tensor]:
        """Which of these places were seen, as an index into them, and their rows of the features.

        Args:
            voxels: of twice the side, three whole numbers and an axis each, [P, 4].
        """
        row = self.rows[_number(voxels)]
        known = (row >= 0).nonzero()[:, 0]
        return known, row[known]


class Sights(NamedTuple):
    """What rays from places met, [P, PROBES, CELLS] each.

    Attributes:
        place: of the cache; PLACES where nothing was met.
        emitted: luminance of emitters that were met, times its share beside that of joining.
        distance: along the ray.
        cosine: at the surface that was met.
    """

    place: Tensor
    emitted: Tensor
    distance: Tensor
    cosine: Tensor


class Survey(Records):
    """Records that also keep where surfaces were met, and what light a path had before it was joined there."""

    def __init__(self, mi: Any, paths: int) -> None:
        super().__init__(mi, paths)
        self.points = [self.dr.zeros(mi.Float, paths * RECORDED) for _ in range(6)]
        self.shone = self.dr.zeros(mi.Float, paths * RECORDED)
        self.dr.eval(self.points, self.shone)

    def put(self, depth: Any, bounce: Bounce, active: Any) -> None:
        """Note a bounce."""
        super().put(depth, bounce, active)
        at, active = self.lane * RECORDED + depth, active & (depth < RECORDED)
        point, normal = bounce.point, bounce.normal
        values = (point.x, point.y, point.z, normal.x, normal.y, normal.z, bounce.shone)
        for store, value in zip((*self.points, self.shone), values, strict=True):
            self.dr.scatter(store, value, at, active)

    def sent(self, radiance: Any) -> tuple[Tensor, Tensor]:
        """What places send out but for emission, as sums and counts of paths, float64 [PLACES] each."""
        total = _tensor(self.mi.luminance(radiance)).repeat_interleave(RECORDED)
        out = (total - _tensor(self.shone)).clamp_min(0) / _tensor(self.numbers[1]).clamp_min(1e-12)
        # what the camera sees is left out: other surfaces are met by directions that paths chose
        later = torch.arange(len(out)) % RECORDED > 0
        noted = ((self._cells() > 0) & out.isfinite() & later).nonzero()[:, 0]
        place = (self._cells()[noted] - 1) // CELLS
        sums, counts = torch.zeros(PLACES, dtype=torch.float64), torch.bincount(place, minlength=PLACES)
        return sums.index_add_(0, place, out[noted].double()), counts.double()

    def one_of_each(self) -> tuple[Tensor, Tensor]:
        """The places that were met, and the number of a point in each, which `points` holds."""
        noted = (self._cells() > 0).nonzero()[:, 0]
        number = torch.full((PLACES,), -1).scatter_(0, (self._cells()[noted] - 1) // CELLS, noted)
        places = (number >= 0).nonzero()[:, 0]
        return places, number[places]

    def _cells(self) -> Tensor:
        return _tensor(self.cells).long()


def survey(
    tracer: PathTracer, scene: Any, sensor: Any, cache: GuideCache, seed: Any, *, looks: bool
) -> tuple[Seen | None, np.ndarray[Any, Any]]:
    """Look at a scene; the cache learns from the paths, too.

    Args:
        tracer: of the picture.
        scene, sensor: as of `render` of an integrator.
        cache: of the scene.
        seed: of all draws.
        looks: whether to find out what is seen from places.

    Returns:
        what was seen, if asked for, and the luminance of the paths, [FILM, FILM].
    """
    mi, dr = tracer.mi, tracer.dr
    paths = FILM**2
    sampler: Any = mi.load_dict({"type": "independent"})
    sampler.seed(seed, paths)
    index = dr.arange(mi.UInt32, paths)
    film = (mi.Point2f(mi.Float(index % FILM), mi.Float(index // FILM)) + sampler.next_2d()) / FILM
    ray, _ = sensor.sample_ray(sensor.shutter_open(), sampler.next_1d(), film, sampler.next_2d())
    records = Survey(mi, paths)
    light, _ = tracer.trace(scene, sampler, mi.RayDifferential3f(ray), cache, False, records)
    dr.eval(light)
    records.teach(cache, light)
    luminance = mi.luminance(light).numpy().reshape(FILM, FILM)
    return _seen(records, light, scene, cache, sampler) if looks else None, luminance


def _seen(records: Survey, light: Any, scene: Any, cache: GuideCache, sampler: Any) -> Seen:
    places, points = records.one_of_each()
    rows = torch.full((_HALF**3 * AXES,), -1)
    if not len(places):
        return Seen(rows, torch.zeros(0, 4, dtype=torch.long), torch.zeros(0, len(SEEN), SIDE, SIDE))
    voxels, which = _halves(places).unique(dim=0, return_inverse=True)
    rows[_number(voxels)] = torch.arange(len(voxels))
    # a cell's rays start in one or another of the smaller places of each, where a path was
    order, size = which.argsort(stable=True), which.bincount()
    spread = torch.arange(PROBES * CELLS)[None] * 7 + torch.arange(len(voxels))[:, None] * 3
    start = points[order[(size.cumsum(0) - size)[:, None] + spread % size[:, None]]].reshape(-1, PROBES, CELLS)
    sights = _looked(records, start, scene, cache, sampler)
    return Seen(rows, voxels, features(sights, *records.sent(light)))


def _looked(records: Survey, start: Tensor, scene: Any, cache: GuideCache, sampler: Any) -> Sights:
    """What rays from the points of such numbers meet, each in another cell, behind mirrors and glass."""
    mi, dr, count = records.mi, records.dr, start.numel()
    number = mi.UInt32(start.flatten().numpy().astype(np.uint32))
    x, y, z, *normal = (dr.gather(mi.Float, values, number) for values in records.points)
    point, up = mi.Point3f(x, y, z), mi.Vector3f(*normal)
    cell = dr.arange(mi.UInt32, count) % CELLS
    sampler.seed(1, count)
    within = mi.Point2f(mi.Float(cell % SIDE), mi.Float(cell // SIDE)) + sampler.next_2d()
    local = mi.warp.square_to_cosine_hemisphere(within / SIDE)
    away = cache.spot(point, up).frame.to_world(local)
    first = dr.zeros(mi.SurfaceInteraction3f, count)
    first.p, first.n, first.sh_frame = point, up, mi.Frame3f(up)
    density = dr.square(local.z * dr.inv_pi)

    def follow(ray: Any, sight: tuple[Any, ...], depth: Any, sampler: Any, active: Any) -> tuple[Any, ...]:
        place, emitted, distance, cosine = sight
        at = scene.ray_intersect(ray, mi.RayFlags.All, False, active)
        bsdf, met = at.bsdf(ray), active & at.is_valid()
        found = mi.DirectionSample3f(scene, si=at, ref=first)
        joined = dr.square(scene.pdf_emitter_direction(first, found, active))
        share = dr.select(depth == 0, density / (density + joined), 1)
        shines = mi.luminance(found.emitter.eval(at, active)) * dr.select(dr.isfinite(share), share, 0)
        scatters = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        normal = dr.select(at.wi.z < 0, -at.sh_frame.n, at.sh_frame.n)
        place = dr.select(met & scatters, cache.spot(at.p, normal).place, place)
        sight = (
            place,
            dr.select(active, emitted + shines, emitted),
            dr.select(met, distance + at.t, distance),
            dr.select(met, dr.abs(at.wi.z), cosine),
        )
        onwards = met & ~scatters & (depth < CHAIN)
        drawn, _ = bsdf.sample(mi.BSDFContext(), at, sampler.next_1d(), sampler.next_2d(), onwards)
        return at.spawn_ray(at.to_world(drawn.wo)), sight, depth + 1, sampler, onwards

    nothing = (dr.full(mi.UInt32, PLACES, count), mi.Float(0), mi.Float(0), mi.Float(0))
    ray = mi.Ray3f(point + up * _SPACE, away)
    state = (ray, nothing, mi.UInt32(0), sampler, mi.Bool(True))
    sight = dr.while_loop(state, lambda *state: state[-1], follow)[1]
    dr.eval(sight)
    shape = start.shape
    place, *others = (_tensor(each).reshape(shape) for each in sight)
    return Sights(place.long(), *others)


def features(sights: Sights, sums: Tensor, counts: Tensor) -> Tensor:
    """What `Seen` holds of what places send out: sums and counts of paths, float64 [PLACES] each."""
    sent, paths = (each.float() for each in _surrounded(sums, counts))
    emitted = sights.emitted.clamp(max=_BRIGHTEST)
    arriving = (sent[sights.place] + emitted).square().mean(1)
    shines = emitted.square().mean(1)
    part = shines / (shines + arriving.mean(1, keepdim=True) + 1e-12)
    distance, cosine = (each.mean(1) for each in (sights.distance, sights.cosine))
    known = 0.2 * paths[sights.place].mean(1).log1p()
    arrives = relative(arriving.reshape(-1, SIDE, SIDE))
    return torch.stack(
        [arrives, *(each.reshape(-1, SIDE, SIDE) for each in (part, distance.log1p(), cosine, known))], 1
    )


def _surrounded(sums: Tensor, counts: Tensor) -> tuple[Tensor, Tensor]:
    """Means of places that lean on those of voxels of twice the side, and these on all; and counts.

    Both with a last entry for where nothing is met.
    """
    half = _number(_halves(torch.arange(PLACES)))
    total, count = (each.new_zeros(_HALF**3 * AXES).index_add_(0, half, each) for each in (sums, counts))
    mean = sums.sum() / counts.sum().clamp_min(1)
    around = (total + LEAN * mean) / (count + LEAN)
    sent = (sums + LEAN * around[half]) / (counts + LEAN)
    return torch.cat([sent, mean[None]]), torch.cat([counts, counts.new_zeros(1)])


def _halves(places: Tensor) -> Tensor:
    """The voxels of twice the side about places, and their axes, [P, 4]."""
    voxels = voxels_of(places)
    return torch.cat([voxels[:, :3] // 2, voxels[:, 3:]], 1)


def _tensor(values: Any) -> Tensor:
    """An array of Dr.Jit's; whole numbers are below 2**31."""
    array = values.numpy()
    return torch.from_numpy(array.view(np.int32) if array.dtype == np.uint32 else array)


def _number(voxels: Tensor) -> Tensor:
    number = voxels[:, 0]
    for column, sides in ((1, _HALF), (2, _HALF), (3, AXES)):
        number = number * sides + voxels[:, column]
    return number
