"""Practical path guiding (Mueller, Gross & Novak 2017), a peer of `metapp_guided_path` in the same renderer.

    {"type": "practical_path_guiding", "max_depth": 8}

An SD-tree is learned from the incident radiance of one iteration and guides the next one, of twice the samples. At
surfaces that are not smooth it samples half of the directions, the BSDF the others (one-sample multiple importance
sampling); next-event estimation is on. Samples of all iterations count, weighted by their inverse variance (Mueller
2019, in "Path Guiding in Production"), here the relative one of blocks of pixels; the last iteration, from which
nothing is learned, has the weight of the one before.
"""

from __future__ import annotations

import functools
import math
import time
from typing import Any

from benchmarks.sd_tree import SDTree
from metapp.extensions.guided.cache import Bounce
from metapp.extensions.guided.integrator import DEPTH, RR_DEPTH
from metapp.extensions.guided.path_tracer import PathTracer
from metapp.extensions.guided.picture import _WAVE, GuidedPicture, _extent
from metapp.extensions.guided.vertex import Evaluated, Sampled, Vertex, is_lambertian, lambertian
from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi, register_plugin

NAME = "practical_path_guiding"
FIRST = 2**14  # paths of the first iteration
FRACTION = 0.5  # of directions that the tree samples


class TreeVertex(Vertex):
    """Vertices of paths that an SD-tree guides."""

    def __init__(self, scene: mt.Scene, sampler: mt.Sampler, *args: Any, emitter_sampling: bool) -> None:
        super().__init__(scene, sampler, *args, emitter_sampling=emitter_sampling)
        self.share = dr.select(mi.has_flag(self.bsdf.flags(), mi.BSDFFlags.Smooth), FRACTION, mi.Float(0))
        self.choice = sampler.next_1d()

    def by_cache(self, cache: SDTree) -> Sampled:  # type: ignore[override]
        """Sample FRACTION of the directions from the tree."""
        si, tree = self.si, cache.tree(self.si.p)
        of_tree = self.draws[0] < self.share
        rest = (self.draws[0] - self.share) / (1 - self.share)
        guided = self.active & (self.share > 0)
        leaf, direction = cache.sample(tree, self.choice, self.draws[1], guided & of_tree)
        evaluated = self._evaluated(si.to_local(direction), of_tree, rest)
        leaf = dr.select(of_tree, leaf, cache.leaf(tree, si.to_world(evaluated.wo), guided & ~of_tree))
        mixture = dr.lerp(evaluated.density, cache.density(leaf, guided), self.share)
        is_lit = self.is_lit & guided
        there = cache.density(cache.leaf(tree, self.emitter.d, is_lit), is_lit)
        value, density = evaluated.to_emitter
        light = self._emitter_radiance(value, dr.lerp(density, there, self.share))
        return self._sampled(evaluated, of_tree, mixture, light, (mixture, leaf))

    def recorded(  # type: ignore[override]
        self, cache: SDTree, sample: Sampled, throughput: mt.Float, radiance: mt.Float, unlit: mt.Float
    ) -> tuple[Bounce, mt.Mask]:
        """The bounce as `Records` keep it, with its weight in the density, and where it counts."""
        weight = mi.luminance(sample.weight)
        active = self.active & (self.share > 0) & ~sample.is_delta & (weight > 0)
        if sample.guide:
            density, leaf = sample.guide
        else:
            density = sample.density
            leaf = cache.leaf(cache.tree(self.si.p), self.si.to_world(sample.wo), active)
        return Bounce(leaf + 1, density * weight, throughput, radiance, unlit, self.si.p, self.si.n), active

    def expected(self, cache: SDTree, sample: Sampled) -> mt.Vector2:  # type: ignore[override]
        """Nothing: paths end as those of `path`."""
        return mi.Vector2f(0)

    def _evaluated(self, guided: mt.Vector3, of_cache: mt.Mask, draw: mt.Float) -> Evaluated:
        """Of the tree's direction `guided`, or one of the BSDF; textures of diffuse ones are read once."""

        def evaluate(bsdf: mt.Bsdf, si: mt.Interaction, guided: mt.Vector3, to_emitter: mt.Vector3, of_cache: mt.Mask,
                     draw: mt.Float, point: mt.Point2, active: mt.Mask) -> tuple[Any, ...]:  # fmt: skip
            if is_lambertian(bsdf):
                lobe = lambertian(bsdf, si, active)
                wo = mi.warp.square_to_cosine_hemisphere(point)
                wo.z = dr.select(si.wi.z < 0, -wo.z, wo.z)
                wo = dr.select(of_cache, guided, wo)
                return dr.zeros(mi.BSDFSample3f), mi.Color3f(0), wo, *lobe(wo), lobe(to_emitter)
            context = mi.BSDFContext()
            drawn, weight = bsdf.sample(context, si, draw, point, active & ~of_cache)
            wo = dr.select(of_cache, guided, drawn.wo)
            value, density = bsdf.eval_pdf(context, si, wo, active)
            return drawn, weight, wo, value, density, bsdf.eval_pdf(context, si, to_emitter, active)

        to_emitter = self.si.to_local(self.emitter.d)
        return Evaluated(
            *dr.dispatch(self.bsdf, evaluate, self.si, guided, to_emitter, of_cache, draw, self.draws[1], self.active)
        )


def iterations(spp: int, pixels: int) -> list[int]:
    """Samples a pixel of the iterations of a picture of `spp` in all: each has twice as many, the last one the rest."""
    parts = [min(spp, 2 ** max(0, math.ceil(math.log2(FIRST / pixels))))]
    while sum(parts) < spp:
        rest, following = spp - sum(parts), 2 * parts[-1]
        parts.append(following if rest >= 3 * following else rest)
    return parts


class PracticalPicture(GuidedPicture):
    """A picture in the making, of which each part is an iteration."""

    def __init__(self, integrator: mt.Integrator, tracer: PathTracer, scene: mt.Scene, sensor: mt.Sensor, seed: int):
        # not super's, which makes another cache
        begin = time.process_time()
        self.integrator, self.tracer, self.scene, self.sensor, self.seed = integrator, tracer, scene, sensor, seed
        self.cache: SDTree = SDTree(*_extent(scene, sensor)[:2])  # type: ignore[assignment]
        self.block, self.made = None, 0
        self.spent = {"start": time.process_time() - begin, "samples": 0.0, "learning": 0.0}

    def render(self, spp: int) -> None:
        """Put all iterations of so many samples a pixel on the sensor's film."""
        film, variance = self.sensor.film(), 1.0
        pixels = int(dr.prod(film.crop_size()))
        parts, wave = iterations(spp, pixels), max(1, _WAVE // pixels)
        for number, part in enumerate(parts):
            begin, learns = time.process_time(), number + 1 < len(parts)
            works = [self._wave(min(wave, part - at), number > 0, learns) for at in range(0, part, wave)]
            dr.sync_thread()
            middle = time.process_time()
            if works[0] is not None:
                variance = max(works[0].noise(parts[0]), 1e-6) ** 2
                self.cache.learn(part)
            self.block.tensor()[:] = self.block.tensor() / variance
            film.put_block(self.block)
            self.block = None
            self.spent["samples"] += middle - begin
            self.spent["learning"] += time.process_time() - middle


@functools.cache
def register() -> None:
    """Have Mitsuba know the integrator, in the variant that is active and in all that will be."""
    register_plugin("integrator", NAME, _plugin)


def _plugin() -> mt.PluginClass:
    class PracticalPathGuiding(mi.SamplingIntegrator):  # type: ignore[misc]  # a class of the variant
        """Properties `max_depth` and `rr_depth`, as of `path`."""

        def __init__(self, props: mt.Properties) -> None:
            mi.SamplingIntegrator.__init__(self, props)
            depths = int(props.get("max_depth", DEPTH)), int(props.get("rr_depth", RR_DEPTH))
            self.path = mi.load_dict({"type": "path", "max_depth": depths[0], "rr_depth": depths[1]})
            self.tracer = PathTracer(*depths, vertex=TreeVertex)
            self.spent: dict[str, float] = {}  # seconds of CPU of the last picture's parts

        def render(self, scene: mt.Scene, sensor: Any = 0, seed: Any = 0, spp: int = 0, **_: bool) -> mt.Tensorf:
            sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
            with dr.suspend_grad():
                picture = PracticalPicture(self.path, self.tracer, scene, sensor, seed)
                picture.render(spp or sensor.sampler().sample_count())
            self.spent = picture.spent
            return sensor.film().develop()

    return PracticalPathGuiding
