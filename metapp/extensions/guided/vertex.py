"""Vertices of guided paths: how an emitter and the next direction are sampled there.

The cache is read here, and never written.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from metapp.extensions.guided.guide_cache import GuideCache
from metapp.extensions.guided.histogram import HISTOGRAM_BINS
from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi
from metapp.rendering.paths.next_event import mis_weight

# The share of directions that are sampled from the cache: where a surface is diffuse and something else, where glossy.
MIXED_CACHE_SHARE, GLOSSY_CACHE_SHARE = 0.5, 0.25
LAMBERTIAN_CLASS, TWO_SIDED_CLASS = "SmoothDiffuse", "TwoSidedBRDF"  # names of Mitsuba's classes


class DirectionSample(NamedTuple):
    """The next direction of paths.

    Attributes:
        wo: the direction, in the surface's frame.
        density: its density per solid angle.
        weight: the BSDF's value times the cosine, divided by the density.
        eta: the relative index of refraction.
        is_delta: whether the BSDF left no choice of a direction.
        is_null: whether paths went straight on.
        emitter_radiance: the radiance by next-event estimation.
        guide: the density divided by the density of cosine sampling, and the bin in the cache; None if the cache was
            not asked.
    """

    wo: mt.Vector3
    density: mt.Float
    weight: mt.Color
    eta: mt.Float
    is_delta: mt.Mask
    is_null: mt.Mask
    emitter_radiance: mt.Color
    guide: tuple[mt.Float, mt.UInt32] | None


EmitterAndBsdfSample = tuple[mt.BsdfSample, mt.Color, mt.Vector3, mt.Color, mt.Float, tuple[mt.Color, mt.Float]]
"""The BSDF's sample and its weight; a direction in the surface's frame; the BSDF's value and density there, and the two
towards the emitter."""


class Vertex:
    """Vertices of paths, where an emitter and the next direction are sampled.

    Args:
        scene: the scene.
        cache: the cache of the scene.
        sampler: the random numbers.
        ray: the rays that arrive.
        si: where they meet surfaces.
        active: which paths meet one.

    Attributes:
        bsdf: the BSDFs there.
        emitter, emitted: a sampled direction to an emitter, and its radiance over the density of the direction.
        is_lit: whether the emitter was sampled.
        draws: the random numbers of the next direction.
        share: the share of directions that the cache samples, in [0, 1].
        location: where the vertices are in the cache.
    """

    def __init__(
        self,
        scene: mt.Scene,
        cache: GuideCache,
        sampler: mt.Sampler,
        ray: mt.Ray,
        si: mt.Interaction,
        active: mt.Mask,
    ) -> None:
        self.cache, self.si, self.bsdf, self.active = cache, si, si.bsdf(ray), active
        flags, kinds = self.bsdf.flags(), mi.BSDFFlags
        scatters = active & mi.has_flag(flags, kinds.Smooth)
        self.emitter, self.emitted = scene.sample_emitter_direction(si, sampler.next_2d(), True, scatters)
        self.is_lit = scatters & (self.emitter.pdf != 0)
        self.draws = sampler.next_1d(), sampler.next_2d()
        is_diffuse, is_glossy = (mi.has_flag(flags, kind) for kind in (kinds.DiffuseReflection, kinds.GlossyReflection))
        transmits = mi.has_flag(flags, kinds.Transmission)
        other_flags = int(kinds.All) & ~int(kinds.DiffuseReflection)
        is_pure_diffuse = is_diffuse & (flags & mi.UInt32(other_flags) == 0)
        mixed_share = dr.select(is_diffuse, MIXED_CACHE_SHARE, dr.select(is_glossy & ~transmits, GLOSSY_CACHE_SHARE, 0))
        self.share = dr.select(is_pure_diffuse, 1, mixed_share)  # the share of directions that the cache samples
        self.location = cache.locate(si.p, dr.select(si.wi.z < 0, -si.sh_frame.n, si.sh_frame.n))

    def sample_bsdf(self) -> DirectionSample:
        """Sample directions by the BSDF alone."""
        wo = self.si.to_local(self.emitter.d)
        value, density, bsdf_sample, weight = self.bsdf.eval_pdf_sample(
            mi.BSDFContext(), self.si, wo, *self.draws, self.active
        )
        is_delta, is_null = (
            mi.has_flag(bsdf_sample.sampled_type, kind) for kind in (mi.BSDFFlags.Delta, mi.BSDFFlags.Null)
        )
        emitter_radiance = self._emitter_radiance(value, density)
        return DirectionSample(
            bsdf_sample.wo, bsdf_sample.pdf, weight, bsdf_sample.eta, is_delta, is_null, emitter_radiance, None
        )

    def sample_cache(self) -> DirectionSample:
        """Sample a share of the directions from the cache, the others by the BSDF."""
        cache, si, location = self.cache, self.si, self.location
        by_cache = self.draws[0] < self.share
        bsdf_draw = (self.draws[0] - self.share) / dr.maximum(1 - self.share, 1e-6)
        bsdf_draw = dr.clip(bsdf_draw, 0, dr.one_minus_epsilon(mi.Float))
        is_guided = self.active & (self.share > 0)
        bin_index, direction = cache.sample(location.row, self.draws[1], is_guided & by_cache)
        bsdf_sample, weight, wo, value, density, emitter_values = self._evaluate(
            si.to_local(location.frame.to_world(direction)), by_cache, bsdf_draw
        )
        direction = dr.select(by_cache, direction, location.frame.to_local(si.to_world(wo)))
        bin_index = dr.select(by_cache, bin_index, cache.bin_of_direction(direction))
        mixture_density = self._mixture_density(direction, bin_index, density, is_guided)
        emitter_direction = location.frame.to_local(self.emitter.d)
        emitter_density = self._mixture_density(
            emitter_direction,
            cache.bin_of_direction(emitter_direction),
            emitter_values[1],
            self.is_lit & (self.share > 0),
        )
        emitter_radiance = self._emitter_radiance(emitter_values[0], emitter_density)
        is_delta = ~by_cache & mi.has_flag(bsdf_sample.sampled_type, mi.BSDFFlags.Delta)
        return DirectionSample(
            wo,
            dr.select(is_delta, bsdf_sample.pdf, mixture_density),
            dr.select(is_delta, weight / (1 - self.share), dr.select(mixture_density > 0, value / mixture_density, 0)),
            dr.select(by_cache, 1, bsdf_sample.eta),
            is_delta,
            ~by_cache & mi.has_flag(bsdf_sample.sampled_type, mi.BSDFFlags.Null),
            emitter_radiance,
            (mixture_density * dr.pi / dr.maximum(direction.z, 1e-6), bin_index),
        )

    def record_values(self, sample: DirectionSample) -> tuple[mt.UInt32, mt.Float, mt.Mask]:
        """Return the first two numbers that records keep of a sample, and where they are recorded.

        See :class:`metapp.extensions.guided.guide_cache.BounceRecords`.
        """
        cache, location = self.cache, self.location
        direction = location.frame.to_local(self.si.to_world(sample.wo))
        density, bin_index = sample.guide or (
            sample.density * dr.pi / dr.maximum(direction.z, 1e-6),
            cache.bin_of_direction(direction),
        )
        active = self.active & (self.share > 0) & ~sample.is_delta & (direction.z > 1e-4)
        return location.entry * HISTOGRAM_BINS + bin_index + 1, density, active

    def expected_luminances(self, sample: DirectionSample) -> mt.Vector2:
        """Return the luminances that the cache expects paths to bring; see :meth:`GuideCache.row_expectations`.

        They are 0 where no directions are sampled from the cache, and for samples of delta lobes.
        """
        return self.cache.row_expectations(self.location.row, self.active & (self.share > 0) & ~sample.is_delta)

    def _evaluate(self, guided: mt.Vector3, of_cache: mt.Mask, draw: mt.Float) -> EmitterAndBsdfSample:
        """Evaluate the BSDF in a direction of the cache, or in one that the BSDF samples, and towards the emitter.

        Args:
            guided: the directions of the cache, in the surface's frame.
            of_cache: where these are taken.
            draw: the random number that chooses a lobe of the BSDF.
        """

        def evaluate(bsdf: mt.Bsdf, si: mt.Interaction, guided: mt.Vector3, to_emitter: mt.Vector3, of_cache: mt.Mask,
                     draw: mt.Float, point: mt.Point2, active: mt.Mask) -> EmitterAndBsdfSample:  # fmt: skip
            if is_lambertian(bsdf):
                lobe = lambertian_functions(bsdf, si, active)
                return dr.zeros(mi.BSDFSample3f), mi.Color3f(0), mi.Vector3f(guided), *lobe(guided), lobe(to_emitter)
            context = mi.BSDFContext()
            bsdf_sample, weight = bsdf.sample(context, si, draw, point, active & ~of_cache)
            wo = dr.select(of_cache, guided, bsdf_sample.wo)
            value, density = bsdf.eval_pdf(context, si, wo, active)
            return bsdf_sample, weight, wo, value, density, bsdf.eval_pdf(context, si, to_emitter, active)

        to_emitter = self.si.to_local(self.emitter.d)
        inputs = (self.si, guided, to_emitter, of_cache, draw, self.draws[1], self.active)
        evaluated: EmitterAndBsdfSample = dr.dispatch(self.bsdf, evaluate, *inputs)
        return evaluated

    def _mixture_density(self, local: mt.Vector3, index: mt.UInt32, density: mt.Float, active: mt.Mask) -> mt.Float:
        """Return the density by which cache and BSDF together sample a direction.

        Args:
            local: the direction, in the location's frame.
            index: its bin.
            density: the density by which the BSDF samples it.
            active: where the cache samples directions at all.
        """
        relative_density = self.cache.density(self.location.row, index, active)
        return dr.lerp(density, relative_density * dr.maximum(local.z, 0) * dr.inv_pi, self.share)

    def _emitter_radiance(self, value: mt.Color, density: mt.Float) -> mt.Color:
        """Return the light of the sampled emitter, by its MIS weight beside directions sampled with a given density.

        Args:
            value: the BSDF's value times the cosine, towards the emitter.
            density: the density by which that direction is sampled.
        """
        weight = dr.select(self.emitter.delta, 1, mis_weight(self.emitter.pdf, density))
        return dr.select(self.is_lit, weight * value * self.emitted, 0)


def is_lambertian(bsdf: mt.Bsdf) -> bool:
    """Return True if a BSDF is Mitsuba's `diffuse`, on one side or on both."""
    kind = bsdf.class_name()
    sides_are_lambertian = (f"brdf[{side}] = {LAMBERTIAN_CLASS}[" in str(bsdf) for side in range(2))
    return kind == LAMBERTIAN_CLASS or (kind == TWO_SIDED_CLASS and all(sides_are_lambertian))


def lambertian_functions(
    bsdf: mt.Bsdf, si: mt.Interaction, active: mt.Mask
) -> Callable[[mt.Vector3], tuple[mt.Color, mt.Float]]:
    """Return a function of directions that gives a Lambertian BSDF's value, times the cosine, and its density.

    The texture is read once.
    """
    albedo, is_two_sided = bsdf.eval_diffuse_reflectance(si, active), bsdf.class_name() == TWO_SIDED_CLASS

    def evaluate_lobe(wo: mt.Vector3) -> tuple[mt.Color, mt.Float]:
        is_reflection = si.wi.z * wo.z > 0 if is_two_sided else (si.wi.z > 0) & (wo.z > 0)
        density = dr.select(active & is_reflection, dr.abs(wo.z) * dr.inv_pi, 0)
        return albedo * density, density

    return evaluate_lobe
