"""A survey of a scene before its picture is rendered: few paths, and rays from the cache's entries that they visit.

What it finds is given to the prior as features; nothing here knows of the network.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from metapp.extensions.guided.guide_cache import MAX_RECORDED_BOUNCES, BounceRecords, GuideCache
from metapp.extensions.guided.histogram import (
    CACHE_ENTRIES,
    HISTOGRAM_BINS,
    HISTOGRAM_SIDE_BINS,
    coarse_voxels,
    voxels_of_entries,
)
from metapp.extensions.guided.path_tracer import PathTracer
from metapp.extensions.guided.prior import SURVEY_CHANNELS, FirstHits, entry_features
from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi
from metapp.rendering.paths.next_event import mis_weight

SURVEY_SIDE_PATHS = 128  # paths along a side of the film
RAYS_PER_BIN = 4  # rays that find what is met in the directions of a bin
MAX_SPECULAR_SURFACES = 6  # surfaces of mirror or glass that a ray follows
_RAY_OFFSET = 1e-4  # distance from a surface at which rays start, in units of the scene

Hit = tuple[mt.UInt32, mt.Float, mt.Float, mt.Float]
"""The fields of :class:`FirstHits`, as arrays of Dr.Jit."""
Step = tuple[mt.Ray, Hit, mt.UInt32, mt.Sampler, mt.Mask]
"""A ray, its first hit, the specular surfaces so far, the random numbers, and whether the ray goes on."""


class SurveyRecords(BounceRecords):
    """Records of bounces that also keep the points, and the radiance of paths before the emitter sampled there."""

    numbers = 11

    def outgoing_radiance(self, radiance: mt.Color) -> tuple[Tensor, Tensor]:
        """Return the radiance that entries send out, without emission.

        Args:
            radiance: the radiance of the paths.

        Returns:
            The sums of luminance and the counts of paths, float64 [CACHE_ENTRIES] each.
        """
        path_luminance = _to_tensor(mi.luminance(radiance)).repeat_interleave(MAX_RECORDED_BOUNCES)
        outgoing = (path_luminance - _to_tensor(self.stores[4])).clamp_min(0) / _to_tensor(self.stores[2]).clamp_min(
            1e-12
        )
        # first surfaces are left out, as the camera chose them; later ones are met by directions that paths sampled
        is_later = torch.arange(len(outgoing)) % MAX_RECORDED_BOUNCES > 0
        counted_rows = ((self._indices() > 0) & outgoing.isfinite() & is_later).nonzero()[:, 0]
        entries = (self._indices()[counted_rows] - 1) // HISTOGRAM_BINS
        sums, counts = torch.zeros(CACHE_ENTRIES, dtype=torch.float64), torch.bincount(entries, minlength=CACHE_ENTRIES)
        return sums.index_add_(0, entries, outgoing[counted_rows].double()), counts.double()

    def select_bounce_per_entry(self) -> tuple[Tensor, Tensor]:
        """Return the entries that were visited, and for each the index into the stores of one bounce in it."""
        recorded = (self._indices() > 0).nonzero()[:, 0]
        index = torch.full((CACHE_ENTRIES,), -1).scatter_(
            0, (self._indices()[recorded] - 1) // HISTOGRAM_BINS, recorded
        )
        entries = (index >= 0).nonzero()[:, 0]
        return entries, index[entries]

    def _indices(self) -> Tensor:
        """Return entry * HISTOGRAM_BINS + bin + 1 of all recorded bounces, 0 where there was none."""
        return _to_tensor(self.stores[0]).long()


def survey(
    tracer: PathTracer, scene: mt.Scene, sensor: mt.Sensor, cache: GuideCache, seed: mt.UInt32
) -> tuple[Tensor, Tensor]:
    """Trace a few paths of a scene, and rays from where they were.

    Args:
        tracer: the tracer of the picture's paths.
        scene, sensor: the arguments of an integrator's `render`.
        cache: the cache of the scene, which also learns from the paths.
        seed: the seed of all draws.

    Returns:
        The voxels of twice the side where paths were, with their axes, [P, 4]; and their features, which
        :func:`entry_features` returns.
    """
    paths = SURVEY_SIDE_PATHS**2
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, paths)
    index = dr.arange(mi.UInt32, paths)
    film_places = (
        mi.Point2f(mi.Float(index % SURVEY_SIDE_PATHS), mi.Float(index // SURVEY_SIDE_PATHS)) + sampler.next_2d()
    ) / SURVEY_SIDE_PATHS
    ray, _ = sensor.sample_ray(sensor.shutter_open(), sampler.next_1d(), film_places, sampler.next_2d())
    records = SurveyRecords(paths)
    radiance, *_ = tracer.trace(scene, sampler, mi.RayDifferential3f(ray), cache, False, records)
    dr.eval(radiance)
    records.add_to_cache(cache, radiance)
    entries, bounces = records.select_bounce_per_entry()
    if not len(entries):
        return torch.zeros(0, 4, dtype=torch.long), torch.zeros(
            0, len(SURVEY_CHANNELS), HISTOGRAM_SIDE_BINS, HISTOGRAM_SIDE_BINS
        )
    voxels, parent = coarse_voxels(voxels_of_entries(entries)).unique(dim=0, return_inverse=True)
    # rays start where a path was; the rays of a bin take turns among the entries of a coarse voxel
    entry_order, entry_counts = parent.argsort(stable=True), parent.bincount()
    ray_numbers = torch.arange(RAYS_PER_BIN * HISTOGRAM_BINS)[None] * 7 + torch.arange(len(voxels))[:, None] * 3
    ray_bounces = bounces[
        entry_order[(entry_counts.cumsum(0) - entry_counts)[:, None] + ray_numbers % entry_counts[:, None]]
    ].reshape(-1, RAYS_PER_BIN, HISTOGRAM_BINS)
    hits = _find_first_hits(records, ray_bounces, scene, cache, sampler)
    return voxels, entry_features(hits, *records.outgoing_radiance(radiance))


def _find_first_hits(
    records: SurveyRecords, start: Tensor, scene: mt.Scene, cache: GuideCache, sampler: mt.Sampler
) -> FirstHits:
    """Find the first scattering surface on rays from bounces, each ray in its bin; mirrors and glass are passed.

    Args:
        records: the records of the bounces.
        start: the indices of the bounces, [P, RAYS_PER_BIN, HISTOGRAM_BINS].
        scene: the scene.
        cache: the cache of the scene.
        sampler: the random numbers.
    """
    count = start.numel()
    index = mi.UInt32(start.flatten().numpy().astype(np.uint32))
    x, y, z, *normal_parts = (dr.gather(mi.Float, values, index) for values in records.stores[5:])
    point, normal = mi.Point3f(x, y, z), mi.Vector3f(*normal_parts)
    bins = dr.arange(mi.UInt32, count) % HISTOGRAM_BINS
    sampler.seed(1, count)
    bin_places = (
        mi.Point2f(mi.Float(bins % HISTOGRAM_SIDE_BINS), mi.Float(bins // HISTOGRAM_SIDE_BINS)) + sampler.next_2d()
    )
    local = mi.warp.square_to_cosine_hemisphere(bin_places / HISTOGRAM_SIDE_BINS)
    origin = dr.zeros(mi.SurfaceInteraction3f, count)
    origin.p, origin.n, origin.sh_frame = point, normal, mi.Frame3f(normal)

    def follow_ray(ray: mt.Ray, hit: Hit, depth: mt.UInt32, sampler: mt.Sampler, active: mt.Mask) -> Step:
        """Intersect rays with the scene, record what they meet, and send on those that meet mirrors or glass."""
        entry, emitted, distance, cosine = hit
        si = scene.ray_intersect(ray, mi.RayFlags.All, False, active)
        bsdf, valid = si.bsdf(ray), active & si.is_valid()
        emitter_sample = mi.DirectionSample3f(scene, si=si, ref=origin)
        weight = mis_weight(local.z * dr.inv_pi, scene.pdf_emitter_direction(origin, emitter_sample, active))
        emission = mi.luminance(emitter_sample.emitter.eval(si, active)) * dr.select(depth == 0, weight, 1)
        scatters = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        facing_normal = dr.select(si.wi.z < 0, -si.sh_frame.n, si.sh_frame.n)
        hit = (
            dr.select(valid & scatters, cache.locate(si.p, facing_normal).entry, entry),
            dr.select(active, emitted + emission, emitted),
            dr.select(valid, distance + si.t, distance),
            dr.select(valid, dr.abs(si.wi.z), cosine),
        )
        active = valid & ~scatters & (depth < MAX_SPECULAR_SURFACES)
        bsdf_sample, _ = bsdf.sample(mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d(), active)
        return si.spawn_ray(si.to_world(bsdf_sample.wo)), hit, depth + 1, sampler, active

    ray = mi.Ray3f(point + normal * _RAY_OFFSET, cache.locate(point, normal).frame.to_world(local))
    no_hit = (dr.full(mi.UInt32, CACHE_ENTRIES, count), mi.Float(0), mi.Float(0), mi.Float(0))
    state = (ray, no_hit, mi.UInt32(0), sampler, mi.Bool(True))
    hit = dr.while_loop(state, lambda *state: state[-1], follow_ray)[1]
    dr.eval(hit)
    entry, *other_fields = (_to_tensor(values).reshape(start.shape) for values in hit)
    return FirstHits(entry.long(), *other_fields)


def _to_tensor(values: mt.Float | mt.UInt32) -> Tensor:
    """Return an array of Dr.Jit's as a tensor; whole numbers must be below 2**31."""
    array = values.numpy()
    return torch.from_numpy(array.view(np.int32) if array.dtype == np.uint32 else array)
