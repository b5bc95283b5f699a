"""A survey of a scene before its picture is rendered: few paths, and rays from the entries of the cache they visit."""

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
RAYS_PER_BIN = 4  # of each bin
MAX_SPECULAR_SURFACES = 6  # mirrors and glass that a ray follows, at most
_SPACE = 1e-4  # by which rays start off a surface

Hit = tuple[mt.UInt32, mt.Float, mt.Float, mt.Float]
"""The fields of `FirstHits`, in Dr.Jit."""
Step = tuple[mt.Ray, Hit, mt.UInt32, mt.Sampler, mt.Mask]


class SurveyRecords(BounceRecords):
    """Records that also keep the points of bounces, and the radiance of paths before the emitter sampled there."""

    numbers = 11

    def outgoing(self, radiance: mt.Color) -> tuple[Tensor, Tensor]:
        """Radiance of entries but for emission: sums of luminance and counts of paths, float64 [ENTRIES] each."""
        total = _tensor(mi.luminance(radiance)).repeat_interleave(MAX_RECORDED_BOUNCES)
        outgoing = (total - _tensor(self.stores[4])).clamp_min(0) / _tensor(self.stores[2]).clamp_min(1e-12)
        # what the camera sees is left out: other surfaces are met by directions that paths sampled
        later = torch.arange(len(outgoing)) % MAX_RECORDED_BOUNCES > 0
        counted = ((self._indices() > 0) & outgoing.isfinite() & later).nonzero()[:, 0]
        entry = (self._indices()[counted] - 1) // HISTOGRAM_BINS
        sums, counts = torch.zeros(CACHE_ENTRIES, dtype=torch.float64), torch.bincount(entry, minlength=CACHE_ENTRIES)
        return sums.index_add_(0, entry, outgoing[counted].double()), counts.double()

    def one_per_entry(self) -> tuple[Tensor, Tensor]:
        """The entries that were visited, and the index into the stores of a bounce in each."""
        recorded = (self._indices() > 0).nonzero()[:, 0]
        index = torch.full((CACHE_ENTRIES,), -1).scatter_(
            0, (self._indices()[recorded] - 1) // HISTOGRAM_BINS, recorded
        )
        entries = (index >= 0).nonzero()[:, 0]
        return entries, index[entries]

    def _indices(self) -> Tensor:
        return _tensor(self.stores[0]).long()


def survey(
    tracer: PathTracer, scene: mt.Scene, sensor: mt.Sensor, cache: GuideCache, seed: mt.UInt32
) -> tuple[Tensor, Tensor]:
    """Trace a few paths of a scene, and rays from where they were.

    Args:
        tracer: of the picture.
        scene, sensor: as of `render` of an integrator.
        cache: of the scene, which learns from the paths, too.
        seed: of all draws.

    Returns:
        voxels of twice the side where paths were, as of `voxels_of_entries`, [P, 4]; and their features, as of `entry_features`.
    """
    paths = SURVEY_SIDE_PATHS**2
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, paths)
    index = dr.arange(mi.UInt32, paths)
    film = (
        mi.Point2f(mi.Float(index % SURVEY_SIDE_PATHS), mi.Float(index // SURVEY_SIDE_PATHS)) + sampler.next_2d()
    ) / SURVEY_SIDE_PATHS
    ray, _ = sensor.sample_ray(sensor.shutter_open(), sampler.next_1d(), film, sampler.next_2d())
    records = SurveyRecords(paths)
    light, *_ = tracer.trace(scene, sampler, mi.RayDifferential3f(ray), cache, False, records)
    dr.eval(light)
    records.train(cache, light)
    entries, points = records.one_per_entry()
    if not len(entries):
        return torch.zeros(0, 4, dtype=torch.long), torch.zeros(
            0, len(SURVEY_CHANNELS), HISTOGRAM_SIDE_BINS, HISTOGRAM_SIDE_BINS
        )
    voxels, parent = coarse_voxels(voxels_of_entries(entries)).unique(dim=0, return_inverse=True)
    # a bin's rays start in one or another of the entries of each coarse voxel, where a path was
    order, size = parent.argsort(stable=True), parent.bincount()
    spread = torch.arange(RAYS_PER_BIN * HISTOGRAM_BINS)[None] * 7 + torch.arange(len(voxels))[:, None] * 3
    start = points[order[(size.cumsum(0) - size)[:, None] + spread % size[:, None]]].reshape(
        -1, RAYS_PER_BIN, HISTOGRAM_BINS
    )
    hits = _first_hits(records, start, scene, cache, sampler)
    return voxels, entry_features(hits, *records.outgoing(light))


def _first_hits(
    records: SurveyRecords, start: Tensor, scene: mt.Scene, cache: GuideCache, sampler: mt.Sampler
) -> FirstHits:
    """First hits of rays from the bounces of indices [P, RAYS, BINS], each in its bin, behind mirrors and glass."""
    count = start.numel()
    index = mi.UInt32(start.flatten().numpy().astype(np.uint32))
    x, y, z, *up = (dr.gather(mi.Float, values, index) for values in records.stores[5:])
    point, normal = mi.Point3f(x, y, z), mi.Vector3f(*up)
    bins = dr.arange(mi.UInt32, count) % HISTOGRAM_BINS
    sampler.seed(1, count)
    within = mi.Point2f(mi.Float(bins % HISTOGRAM_SIDE_BINS), mi.Float(bins // HISTOGRAM_SIDE_BINS)) + sampler.next_2d()
    local = mi.warp.square_to_cosine_hemisphere(within / HISTOGRAM_SIDE_BINS)
    first = dr.zeros(mi.SurfaceInteraction3f, count)
    first.p, first.n, first.sh_frame = point, normal, mi.Frame3f(normal)

    def follow(ray: mt.Ray, hit: Hit, depth: mt.UInt32, sampler: mt.Sampler, active: mt.Mask) -> Step:
        entry, emitted, distance, cosine = hit
        si = scene.ray_intersect(ray, mi.RayFlags.All, False, active)
        bsdf, valid = si.bsdf(ray), active & si.is_valid()
        there = mi.DirectionSample3f(scene, si=si, ref=first)
        weight = mis_weight(local.z * dr.inv_pi, scene.pdf_emitter_direction(first, there, active))
        light = mi.luminance(there.emitter.eval(si, active)) * dr.select(depth == 0, weight, 1)
        scatters = mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        facing = dr.select(si.wi.z < 0, -si.sh_frame.n, si.sh_frame.n)
        hit = (
            dr.select(valid & scatters, cache.locate(si.p, facing).entry, entry),
            dr.select(active, emitted + light, emitted),
            dr.select(valid, distance + si.t, distance),
            dr.select(valid, dr.abs(si.wi.z), cosine),
        )
        active = valid & ~scatters & (depth < MAX_SPECULAR_SURFACES)
        drawn, _ = bsdf.sample(mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d(), active)
        return si.spawn_ray(si.to_world(drawn.wo)), hit, depth + 1, sampler, active

    ray = mi.Ray3f(point + normal * _SPACE, cache.locate(point, normal).frame.to_world(local))
    nothing = (dr.full(mi.UInt32, CACHE_ENTRIES, count), mi.Float(0), mi.Float(0), mi.Float(0))
    state = (ray, nothing, mi.UInt32(0), sampler, mi.Bool(True))
    hit = dr.while_loop(state, lambda *state: state[-1], follow)[1]
    dr.eval(hit)
    entry, *others = (_tensor(values).reshape(start.shape) for values in hit)
    return FirstHits(entry.long(), *others)


def _tensor(values: mt.Float | mt.UInt32) -> Tensor:
    """An array of Dr.Jit's; whole numbers are below 2**31."""
    array = values.numpy()
    return torch.from_numpy(array.view(np.int32) if array.dtype == np.uint32 else array)
