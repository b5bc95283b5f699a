"""A path tracer that samples directions from a spatial cache of histograms, at every surface that scatters.

It is Mitsuba's `path`, with the same multiple importance sampling of emitters. The difference is how directions are
sampled: from the cache where a surface is diffuse alone, from cache or BSDF at random where it is glossy, too
(one-sample multiple importance sampling), from the BSDF where it is smooth or transmissive; and when paths end. The
mean is that of `path` whatever the cache holds.

A path ends by Russian roulette on its expected further radiance: the root mean square of that of others from
that surface on, over the luminance of the whole path (Vorba & Křivánek 2016 with the mean; Rath et al. 2022).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from metapp.extensions.guided.guide_cache import BounceRecords, GuideCache
from metapp.extensions.guided.vertex import Vertex
from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi
from metapp.rendering.paths.next_event import mis_weight

CERTAIN_SURVIVAL_DIVISOR = (
    1.5  # a path goes on for certain that is expected to bring 1 / WORTH of its luminance yet, or more
)
MIN_SURVIVAL_PROBABILITY, MAX_SURVIVAL_PROBABILITY = (
    0.1,
    0.95,
)  # probability that a path goes on: at least, by the cache; at most, from `rr_depth` on


@dataclass
class _Paths:
    """All paths in the loop, each before its next surface.

    Attributes:
        origin: the point that the ray leaves, by a direction of `density` per solid angle, or of none (`is_delta`).
        eta: relative index of refraction of all surfaces so far.
        hits: where a path met something, a sky at least.
        expected: luminance of the whole path, by the cache at the first surface that it knows; 0 before.
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
    expected: mt.Float


class PathTracer(NamedTuple):
    """Traces paths, as Mitsuba's `path`.

    Attributes:
        max_depth: edges of the longest path.
        rr_depth: edges from which on paths end by chance (Russian roulette).
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
        """Trace paths: their radiance, where they met something (a sky at least), and how many surfaces they met.

        Args:
            scene, sampler, ray: as of `sample` of an integrator.
            cache: of the scene.
            guided: a cache to sample directions from, and to end paths by.
            records: where to record bounces, of as many paths as there are rays.
        """

        def bounce(paths: _Paths) -> tuple[_Paths]:
            si = scene.ray_intersect(paths.ray, mi.RayFlags.All, paths.depth == 0, paths.active)
            paths.radiance += paths.throughput * _emitted(scene, si, paths)
            active = paths.active & (paths.depth + 1 < self.max_depth) & si.is_valid()
            vertex = Vertex(scene, cache, paths.sampler, paths.ray, si, active)
            sample = vertex.by_cache() if guided else vertex.by_bsdf()
            unlit, remaining = mi.luminance(paths.radiance), mi.Float(0)
            if guided:
                paths.expected, remaining = _expected(paths, *vertex.expected(sample))
            paths.radiance += paths.throughput * sample.emitter_radiance
            if records is not None:
                index, density, counts = vertex.recorded(sample)
                path = mi.luminance(paths.throughput), mi.luminance(paths.radiance), unlit
                normal = vertex.location.frame.n
                records.add(paths.depth, (index, density, *path, *si.p, *normal), counts)
            paths.throughput *= sample.weight
            paths.eta *= sample.eta
            paths.hits |= active & ~sample.is_null
            active &= dr.max(paths.throughput) != 0
            survives = self._survival(paths, remaining)
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

    def _survival(self, paths: _Paths, remaining: mt.Float) -> mt.Float:
        """The probability that paths go on: by expected further radiance, or as in `path` if it is not known."""
        late = paths.depth >= self.rr_depth
        most, throughput = dr.select(late, MAX_SURVIVAL_PROBABILITY, 1), dr.max(paths.throughput)
        usual = dr.select(late, dr.minimum(throughput * dr.square(paths.eta), most), 1)
        least = dr.clip(
            throughput, MIN_SURVIVAL_PROBABILITY, most
        )  # or ends of others would brighten a path, by chance without bound
        return dr.select(remaining > 0, dr.clip(CERTAIN_SURVIVAL_DIVISOR * remaining, least, most), usual)


def _expected(paths: _Paths, outgoing: mt.Float, carried: mt.Float) -> tuple[mt.Float, mt.Float]:
    """The luminance of whole paths, and the share of it that they are expected to bring yet; 0 if not known.

    Args:
        paths: before next-event estimation.
        outgoing, carried: expectations of the cache here, as of `GuideCache.expect`.
    """
    throughput, known = mi.luminance(paths.throughput), outgoing > 0
    here = mi.luminance(paths.radiance) + throughput * outgoing
    whole = dr.select((paths.expected == 0) & known, here, paths.expected)
    return whole, dr.select(known, throughput * carried / whole, 0)


def _emitted(scene: mt.Scene, si: mt.Interaction, paths: _Paths) -> mt.Color:
    """Emission of the surface or sky that paths met, by its MIS weight beside emitter sampling."""
    there = mi.DirectionSample3f(scene, si=si, ref=paths.origin)
    light = there.emitter.eval(si, paths.active)
    density = scene.pdf_emitter_direction(paths.origin, there, paths.active & ~paths.is_delta)
    return light * mis_weight(paths.density, density)
