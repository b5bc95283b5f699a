"""A path tracer that samples directions from a spatial cache of histograms, at every surface that scatters.

It traces paths as Mitsuba's `path` does, with the same multiple importance sampling of emitters. The difference is when
paths end, and how directions are sampled: from the cache where a surface is purely diffuse, from cache or BSDF at
random where it is also glossy (one-sample multiple importance sampling), from the BSDF where it is smooth or
transmissive. The mean is the mean of `path` whatever the cache holds.

A path ends by Russian roulette on its expected further radiance: the root mean square of the radiance that other paths
brought from that surface on, divided by the luminance of the whole path (Vorba & Křivánek 2016 with the mean; Rath et
al. 2022).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from metapp.extensions.guided.guide_cache import BounceRecords, GuideCache
from metapp.extensions.guided.vertex import Vertex
from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi
from metapp.rendering.paths.next_event import mis_weight

# A path goes on for certain if it is expected yet to bring the luminance of the whole path divided by this, or more.
CERTAIN_SURVIVAL_DIVISOR = 1.5
# The probability that a path goes on: the least by the cache, and the greatest from `rr_depth` on.
MIN_SURVIVAL_PROBABILITY, MAX_SURVIVAL_PROBABILITY = 0.1, 0.95


@dataclass
class _Paths:
    """All paths in the loop, each before its next surface.

    Attributes:
        sampler, ray, active: the random numbers, the next ray, and whether the path goes on.
        depth: the number of surfaces so far.
        radiance, throughput: what the path has brought so far, and what further radiance is multiplied by.
        eta: the relative index of refraction of all surfaces so far.
        origin: the point that the ray leaves.
        density, is_delta: the density of the ray's direction per solid angle, or whether it has none.
        hits: whether the path met something, at least a sky.
        whole_luminance: the luminance that the whole path is expected to bring, by the first surface on it that the
            cache knows; 0 before that surface.
    """

    sampler: mt.Sampler
    ray: mt.Ray
    depth: mt.UInt32
    radiance: mt.Color
    throughput: mt.Color
    eta: mt.Float
    origin: mt.Interaction
    density: mt.Float
    is_delta: mt.Mask
    hits: mt.Mask
    active: mt.Mask
    whole_luminance: mt.Float


class PathTracer(NamedTuple):
    """A tracer of paths with the depths of Mitsuba's `path`.

    Attributes:
        max_depth: the edges of the longest path.
        rr_depth: the edges from which on paths end by chance (Russian roulette).
    """

    max_depth: int
    rr_depth: int

    def trace(
        self,
        scene: mt.Scene,
        sampler: mt.Sampler,
        ray: mt.Ray,
        cache: GuideCache,
        guided: bool,
        records: BounceRecords | None,
    ) -> tuple[mt.Color, mt.Mask, mt.UInt32]:
        """Trace paths through a scene.

        Args:
            scene, sampler, ray: the arguments of an integrator's `sample`.
            cache: the cache of the scene.
            guided: whether directions are sampled from the cache, and paths end by it.
            records: where to record bounces, for as many paths as there are rays; None for nowhere.

        Returns:
            The radiance of the paths, whether they met something (at least a sky), and how many surfaces they met.
        """

        def bounce(paths: _Paths) -> tuple[_Paths]:
            """Move all paths on to their next surface."""
            si = scene.ray_intersect(paths.ray, mi.RayFlags.All, paths.depth == 0, paths.active)
            paths.radiance += paths.throughput * _weigh_emission(scene, si, paths)
            active = paths.active & (paths.depth + 1 < self.max_depth) & si.is_valid()
            vertex = Vertex(scene, cache, paths.sampler, paths.ray, si, active)
            sample = vertex.sample_cache() if guided else vertex.sample_bsdf()
            unlit_luminance, remaining = mi.luminance(paths.radiance), mi.Float(0)
            if guided:
                paths.whole_luminance, remaining = _expect_luminance(paths, *vertex.expected_luminances(sample))
            paths.radiance += paths.throughput * sample.emitter_radiance
            if records is not None:
                index, density, is_recorded = vertex.record_values(sample)
                luminances = mi.luminance(paths.throughput), mi.luminance(paths.radiance), unlit_luminance
                normal = vertex.location.frame.n
                records.record_bounce(paths.depth, (index, density, *luminances, *si.p, *normal), is_recorded)
            paths.throughput *= sample.weight
            paths.eta *= sample.eta
            paths.hits |= active & ~sample.is_null
            active &= dr.max(paths.throughput) != 0
            survives = self._survival_probability(paths, remaining)
            paths.throughput /= survives
            paths.active = active & (paths.sampler.next_1d(active & (survives < 1)) < survives)
            paths.ray = mi.RayDifferential3f(si.spawn_ray(si.to_world(sample.wo)))
            paths.depth += 1
            paths.origin = mi.Interaction3f(si.t, si.time, si.wavelengths, si.p, si.n)
            paths.density, paths.is_delta = sample.density, sample.is_delta
            return (paths,)

        paths = _Paths(
            sampler, mi.RayDifferential3f(ray), mi.UInt32(0), mi.Color3f(0), mi.Color3f(1), mi.Float(1),
            dr.zeros(mi.Interaction3f), mi.Float(1), mi.Bool(True), mi.Bool(scene.environment() is not None),
            mi.Bool(True), mi.Float(0),
        )  # fmt: skip
        (paths,) = dr.while_loop((paths,), lambda paths: paths.active, bounce)
        return paths.radiance, paths.hits, paths.depth

    def _survival_probability(self, paths: _Paths, remaining: mt.Float) -> mt.Float:
        """Return the probability that paths go on.

        It depends on the expected further radiance; where that is not known, it is the probability of `path`.
        """
        is_late = paths.depth >= self.rr_depth
        max_probability, throughput = dr.select(is_late, MAX_SURVIVAL_PROBABILITY, 1), dr.max(paths.throughput)
        path_probability = dr.select(is_late, dr.minimum(throughput * dr.square(paths.eta), max_probability), 1)
        # without a least probability, the ends of other paths could brighten a path without bound
        min_probability = dr.clip(throughput, MIN_SURVIVAL_PROBABILITY, max_probability)
        return dr.select(
            remaining > 0,
            dr.clip(CERTAIN_SURVIVAL_DIVISOR * remaining, min_probability, max_probability),
            path_probability,
        )


def _expect_luminance(paths: _Paths, outgoing: mt.Float, continuation: mt.Float) -> tuple[mt.Float, mt.Float]:
    """Return the expected luminance of whole paths, and the share of it that they will bring after this surface.

    Both are 0 where the cache knows neither this surface nor one before it; the share also where it does not know this
    one.

    Args:
        paths: the paths, before next-event estimation at this surface.
        outgoing, continuation: the cache's expectations at this surface; see :meth:`GuideCache.row_expectations`.
    """
    throughput, is_known = mi.luminance(paths.throughput), outgoing > 0
    expected_here = mi.luminance(paths.radiance) + throughput * outgoing
    whole_luminance = dr.select((paths.whole_luminance == 0) & is_known, expected_here, paths.whole_luminance)
    return whole_luminance, dr.select(is_known, throughput * continuation / whole_luminance, 0)


def _weigh_emission(scene: mt.Scene, si: mt.Interaction, paths: _Paths) -> mt.Color:
    """Return the emission of the surface or sky that paths met, by its MIS weight beside emitter sampling."""
    emitter_sample = mi.DirectionSample3f(scene, si=si, ref=paths.origin)
    emission = emitter_sample.emitter.eval(si, paths.active)
    density = scene.pdf_emitter_direction(paths.origin, emitter_sample, paths.active & ~paths.is_delta)
    return emission * mis_weight(paths.density, density)
