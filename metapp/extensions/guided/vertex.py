"""Vertices of guided paths: how an emitter and the next direction are sampled there."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from metapp.extensions.guided.guide_cache import GuideCache
from metapp.extensions.guided.histogram import HISTOGRAM_BINS
from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi
from metapp.rendering.paths.next_event import mis_weight

MIXED_CACHE_SHARE, GLOSSY_CACHE_SHARE = (
    0.5,
    0.25,
)  # share of directions from the cache where surfaces are diffuse and more, or glossy
LAMBERTIAN_CLASS, TWO_SIDED_CLASS = "SmoothDiffuse", "TwoSidedBRDF"  # Mitsuba's classes


class DirectionSample(NamedTuple):
    """The next direction of paths.

    Attributes:
        wo: the direction, in the surface's frame.
        density: of it, per solid angle.
        weight: the BSDF's value over that, times the cosine.
        eta: relative index of refraction.
        is_delta: whether there was no choice; is_null, whether paths went straight on.
        emitter_radiance: of next-event estimation.
        guide: density over the cosine's, and bin in the cache; None if it was not asked.
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
"""The BSDF's sample and its weight; a direction in the surface's frame; value and density there, and to the emitter."""


class Vertex:
    """Vertices of paths, where an emitter and the next direction are sampled."""

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
        diffuse, glossy = (mi.has_flag(flags, kind) for kind in (kinds.DiffuseReflection, kinds.GlossyReflection))
        transmits = mi.has_flag(flags, kinds.Transmission)
        others = int(kinds.All) & ~int(kinds.DiffuseReflection)
        only_diffuse = diffuse & (flags & mi.UInt32(others) == 0)
        mixed = dr.select(diffuse, MIXED_CACHE_SHARE, dr.select(glossy & ~transmits, GLOSSY_CACHE_SHARE, 0))
        self.share = dr.select(only_diffuse, 1, mixed)  # of directions that the cache samples
        self.location = cache.locate(si.p, dr.select(si.wi.z < 0, -si.sh_frame.n, si.sh_frame.n))

    def by_bsdf(self) -> DirectionSample:
        """Sample directions as the BSDF does."""
        wo = self.si.to_local(self.emitter.d)
        value, density, drawn, weight = self.bsdf.eval_pdf_sample(
            mi.BSDFContext(), self.si, wo, *self.draws, self.active
        )
        is_delta, is_null = (mi.has_flag(drawn.sampled_type, kind) for kind in (mi.BSDFFlags.Delta, mi.BSDFFlags.Null))
        light = self._emitter_radiance(value, density)
        return DirectionSample(drawn.wo, drawn.pdf, weight, drawn.eta, is_delta, is_null, light, None)

    def by_cache(self) -> DirectionSample:
        """Sample a share of the directions from the cache."""
        cache, si, location = self.cache, self.si, self.location
        of_cache = self.draws[0] < self.share
        rest = (self.draws[0] - self.share) / dr.maximum(1 - self.share, 1e-6)
        rest = dr.clip(rest, 0, dr.one_minus_epsilon(mi.Float))
        guided = self.active & (self.share > 0)
        index, local = cache.sample(location.row, self.draws[1], guided & of_cache)
        drawn, weight, wo, value, density, to_emitter = self._evaluated(
            si.to_local(location.frame.to_world(local)), of_cache, rest
        )
        local = dr.select(of_cache, local, location.frame.to_local(si.to_world(wo)))
        index = dr.select(of_cache, index, cache.bin(local))
        mixture, towards = self._mixture(local, index, density, guided), location.frame.to_local(self.emitter.d)
        to_light = self._mixture(towards, cache.bin(towards), to_emitter[1], self.is_lit & (self.share > 0))
        light = self._emitter_radiance(to_emitter[0], to_light)
        is_delta = ~of_cache & mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Delta)
        return DirectionSample(
            wo,
            dr.select(is_delta, drawn.pdf, mixture),
            dr.select(is_delta, weight / (1 - self.share), dr.select(mixture > 0, value / mixture, 0)),
            dr.select(of_cache, 1, drawn.eta),
            is_delta,
            ~of_cache & mi.has_flag(drawn.sampled_type, mi.BSDFFlags.Null),
            light,
            (mixture * dr.pi / dr.maximum(local.z, 1e-6), index),
        )

    def recorded(self, sample: DirectionSample) -> tuple[mt.UInt32, mt.Float, mt.Mask]:
        """The first two numbers that `Records` keep of a sample of this vertex, and where it counts."""
        cache, location = self.cache, self.location
        local = location.frame.to_local(self.si.to_world(sample.wo))
        density, index = sample.guide or (sample.density * dr.pi / dr.maximum(local.z, 1e-6), cache.bin(local))
        active = self.active & (self.share > 0) & ~sample.is_delta & (local.z > 1e-4)
        return location.entry * HISTOGRAM_BINS + index + 1, density, active

    def expected(self, sample: DirectionSample) -> mt.Vector2:
        """The cache's expectations of paths that go on by a sample of this vertex, as of `expect`."""
        return self.cache.expect(self.location.row, self.active & (self.share > 0) & ~sample.is_delta)

    def _evaluated(self, guided: mt.Vector3, of_cache: mt.Mask, draw: mt.Float) -> EmitterAndBsdfSample:
        """Of the cache's direction `guided`, or one of the BSDF."""

        def evaluate(bsdf: mt.Bsdf, si: mt.Interaction, guided: mt.Vector3, to_emitter: mt.Vector3, of_cache: mt.Mask,
                     draw: mt.Float, point: mt.Point2, active: mt.Mask) -> EmitterAndBsdfSample:  # fmt: skip
            if is_lambertian(bsdf):
                lobe = lambertian_functions(bsdf, si, active)
                return dr.zeros(mi.BSDFSample3f), mi.Color3f(0), mi.Vector3f(guided), *lobe(guided), lobe(to_emitter)
            context = mi.BSDFContext()
            drawn, weight = bsdf.sample(context, si, draw, point, active & ~of_cache)
            wo = dr.select(of_cache, guided, drawn.wo)
            value, density = bsdf.eval_pdf(context, si, wo, active)
            return drawn, weight, wo, value, density, bsdf.eval_pdf(context, si, to_emitter, active)

        to_emitter = self.si.to_local(self.emitter.d)
        inputs = (self.si, guided, to_emitter, of_cache, draw, self.draws[1], self.active)
        evaluated: EmitterAndBsdfSample = dr.dispatch(self.bsdf, evaluate, *inputs)
        return evaluated

    def _mixture(self, local: mt.Vector3, index: mt.UInt32, density: mt.Float, active: mt.Mask) -> mt.Float:
        """The density by which cache and BSDF, this by `density`, together sample a direction of a bin."""
        relative = self.cache.density(self.location.row, index, active)
        return dr.lerp(density, relative * dr.maximum(local.z, 0) * dr.inv_pi, self.share)

    def _emitter_radiance(self, value: mt.Color, density: mt.Float) -> mt.Color:
        """Light of the sampled emitter, by its MIS weight beside sampling directions of such a density."""
        weight = dr.select(self.emitter.delta, 1, mis_weight(self.emitter.pdf, density))
        return dr.select(self.is_lit, weight * value * self.emitted, 0)


def is_lambertian(bsdf: mt.Bsdf) -> bool:
    """True if a BSDF is Mitsuba's `diffuse`, on one side or on both."""
    kind = bsdf.class_name()
    both = (f"brdf[{side}] = {LAMBERTIAN_CLASS}[" in str(bsdf) for side in range(2))
    return kind == LAMBERTIAN_CLASS or (kind == TWO_SIDED_CLASS and all(both))


def lambertian_functions(
    bsdf: mt.Bsdf, si: mt.Interaction, active: mt.Mask
) -> Callable[[mt.Vector3], tuple[mt.Color, mt.Float]]:
    """The value, times the cosine, and the density of such a BSDF by direction; its texture is read once."""
    albedo, both = bsdf.eval_diffuse_reflectance(si, active), bsdf.class_name() == TWO_SIDED_CLASS

    def lobe(wo: mt.Vector3) -> tuple[mt.Color, mt.Float]:
        same_side = si.wi.z * wo.z > 0 if both else (si.wi.z > 0) & (wo.z > 0)
        density = dr.select(active & same_side, dr.abs(wo.z) * dr.inv_pi, 0)
        return albedo * density, density

    return lobe
