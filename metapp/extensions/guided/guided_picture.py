"""A picture that the integrator `metapp_guided_path` makes.

It is rendered in parts: a regular one, then guided ones, by a cache that has learned from a survey of the scene and
from the parts before. Every part is a share of the picture that does not depend on samples.
"""

from __future__ import annotations

import math
import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from metapp.extensions.guided.guide_cache import BounceRecords, GuideCache
from metapp.extensions.guided.path_tracer import PathTracer
from metapp.extensions.guided.prior import LearnedPrior
from metapp.extensions.guided.survey import survey
from metapp.learning.task import Params
from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi

MIN_SPP_FOR_PARTS = 4  # samples a pixel, with which a picture has parts
FIRST_GUIDED_PATHS = 2**18  # paths of the first guided part, of which a quarter of the picture is the most
MAX_LEARNING_PATHS = 2**21  # paths after which the cache has learned enough
MAX_GUIDED_ERROR_RATIO = 1.0  # the most that the error of a guided part may be, over that of `path` in the same time
REGULAR_PART_WEIGHT = 0.3  # weight of samples of the regular part beside guided ones, where these pay
GUIDED_BOUNCE_COST_RATIO = 1.25  # of a guided bounce over one of `path`
MIN_NOISE_BLOCK_SAMPLES = 128  # samples of the blocks in which noise is compared, at least
PATHS_PER_VECTOR = 8  # paths that are traced side by side, until the last of them ends

_WAVE = 2**22  # paths at a time
_PROBES = 128  # rays along a side of the film that tell where the scene is


def split_samples(spp: int, pixels: int) -> list[int]:
    """Samples a pixel of the parts of a picture of `spp` in all.

    The first is of regular paths, and half of the next one, if that has several samples. All but the last are learned
    from, up to a third of the picture; each of the guided ones has twice as many as the one before. There is but one
    if there are fewer than SEVERAL.
    """
    if spp < MIN_SPP_FOR_PARTS:
        return [spp]
    # of powers of two, as Dr.Jit compiles code for other numbers anew
    first = 2 ** int(math.log2(max(1, min(spp // 4, -(-FIRST_GUIDED_PATHS // pixels)))))
    parts = [max(1, first // 2), first]
    while 3 * (sum(parts) + 2 * parts[-1]) <= spp and sum(parts) * pixels < MAX_LEARNING_PATHS:
        parts.append(2 * parts[-1])
    return [*parts, spp - sum(parts)]


def sampled_film_size(film: mt.Film) -> tuple[int, int]:
    """Rows and columns of the pixels that paths are traced through: with `sample_border` those around the film, too."""
    border = 2 * film.rfilter().border_size() if film.sample_border() else 0
    width, height = film.crop_size()
    return int(height) + border, int(width) + border


class PartCost(NamedTuple):
    """The luminance of paths and their cost.

    Attributes:
        luminance: of the samples, [rows, columns, samples].
        bounces: of the longest of LANES paths, on average.
    """

    luminance: NDArray[np.float32]
    bounces: float

    def noise(self, samples: int) -> float:
        """Mean difference of halves of blocks of pixels, relative to their sum; of so many samples of each."""
        side = math.ceil(math.sqrt(MIN_NOISE_BLOCK_SAMPLES / samples))
        rows, columns = (max(1, length // side) for length in self.luminance.shape[:2])
        tall, wide = (min(side, length) for length in self.luminance.shape[:2])
        blocks = self.luminance[: rows * tall, : columns * wide, :samples].reshape(rows, tall, columns, wide, samples)
        own = np.indices((tall, wide, samples)).sum(0) % 2 == 0
        sums = blocks.sum((1, 3, 4), dtype=np.float64)
        first = (blocks * own[:, None]).sum((1, 3, 4), dtype=np.float64)
        return float((np.abs(2 * first - sums)[sums > 0] / sums[sums > 0]).mean()) if (sums > 0).any() else 0.0

    def pays(self, regular: PartCost) -> bool:
        """True if this guided part has less error than a regular one in the same time; errors go by the root of it."""
        samples = min(self.luminance.shape[2], regular.luminance.shape[2])
        time_ratio = GUIDED_BOUNCE_COST_RATIO * self.bounces / regular.bounces
        return self.noise(samples) * math.sqrt(time_ratio) <= MAX_GUIDED_ERROR_RATIO * regular.noise(samples)


class GuidedPicture:
    """A picture in the making.

    Args:
        integrator: Mitsuba's `path` of the same properties, by which regular paths are traced.
        tracer: of paths.
        scene, sensor, seed: as of `render` of an integrator.
        prior: parameters of the network that is the cache's prior; None for none.

    Attributes:
        pays: whether guided paths have less error in the same time, as far as is known.
        spent: seconds of CPU that each kind of work took, by its name.
    """

    def __init__(
        self,
        integrator: mt.Integrator,
        tracer: PathTracer,
        scene: mt.Scene,
        sensor: mt.Sensor,
        seed: mt.UInt32 | int,
        prior: Params | None = None,
    ) -> None:
        begin = time.process_time()
        self.integrator, self.tracer, self.scene, self.sensor, self.seed = integrator, tracer, scene, sensor, seed
        self.first: mt.ImageBlock = None  # of the regular part
        self.block: mt.ImageBlock = None
        self.made = 0
        self.pays = True
        self.regular: PartCost | None = None
        self.cache = GuideCache(*_extent(scene, sensor))
        if prior is not None:
            self.cache.prior = LearnedPrior(prior, *survey(tracer, scene, sensor, self.cache, seed))
        self.spent = {"survey": time.process_time() - begin}

    def render(self, spp: int) -> None:
        """Put all parts of so many samples a pixel on the sensor's film."""
        film = self.sensor.film()
        parts = split_samples(spp, math.prod(sampled_film_size(film)))
        if len(parts) == 1:
            self.cache.learn()  # of the survey alone
        for part in parts[:-1]:
            self.add(part, learns=True)
        self.add(parts[-1], learns=False)
        for block, weight in ((self.first, REGULAR_PART_WEIGHT if self.pays else 1.0), (self.block, 1.0)):
            if block is not None:
                block.tensor()[:] = weight * block.tensor()
                film.put_block(block)

    def add(self, spp: int, *, learns: bool) -> None:
        """Add a part, and learn from it if asked to and as long as that pays; the first of these is regular."""
        learns = learns and self.pays
        guided = self.pays and not (learns and self.regular is None)
        begin = time.process_time()
        wave = max(1, _WAVE // math.prod(sampled_film_size(self.sensor.film())))
        works = [self._wave(min(wave, spp - first), guided, learns) for first in range(0, spp, wave)]
        dr.sync_thread()
        middle = time.process_time()
        if works[0] is not None:
            if guided and self.regular is not None:
                self.pays = works[0].pays(self.regular)
            else:
                self.regular, self.first, self.block = works[0], self.block, None
            self.cache.learn()
        name = f"{'guided' if guided else 'regular'} samples{', which are learned from' if learns else ''}"
        for work, seconds in ((name, middle - begin), ("learning", time.process_time() - middle)):
            self.spent[work] = self.spent.get(work, 0.0) + seconds

    def _wave(self, spp: int, guided: bool, learns: bool) -> PartCost | None:
        """Add samples to the picture; returns their radiance if the cache learns from them."""
        from mitsuba.python.ad.integrators.common import ADIntegrator

        film, own = self.sensor.film(), self.integrator
        seed = mi.sample_tea_32(mi.UInt32(self.seed), mi.UInt32(self.made))[0]
        sampler, spp = ADIntegrator.prepare(own, self.sensor, seed, spp, [])
        self.made += 1
        self.block = self.block or film.create_block()  # of a film that is prepared
        ray, weight, place = ADIntegrator.sample_rays(own, self.scene, self.sensor, sampler)
        records = BounceRecords(dr.width(place)) if learns else None
        work = None
        if guided or records is not None:
            light, hits, bounces = self.tracer.trace(self.scene, sampler, ray, self.cache, guided, records)
        else:
            light, hits, _ = own.sample(self.scene, sampler, ray)
        if records is not None:
            dr.eval(light, hits, place, weight, bounces)
            records.train(self.cache, light)
            rows = *sampled_film_size(film), spp
            steps = bounces.numpy()
            longest = steps[: len(steps) // PATHS_PER_VECTOR * PATHS_PER_VECTOR].reshape(-1, PATHS_PER_VECTOR).max(1)
            work = PartCost(mi.luminance(light).numpy().reshape(rows), float(longest.mean()))
        alpha = dr.select(hits, mi.Float(1), mi.Float(0))
        # of the film's own kind, such as that of spectra
        ADIntegrator._splat_to_block(self.block, film, place, light * weight, mi.Float(1), alpha, [], ray.wavelengths)
        dr.eval(self.block.tensor())
        return work


def _extent(scene: mt.Scene, sensor: mt.Sensor) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float32]]:
    """The box of most surfaces that the camera sees, and of those visible from there; and points of both, [3, N]."""
    index = dr.arange(mi.UInt32, _PROBES**2)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, _PROBES**2)
    film = mi.Point2f(mi.Float(index % _PROBES), mi.Float(index // _PROBES)) / _PROBES
    ray, _ = sensor.sample_ray(sensor.shutter_open(), sampler.next_1d(), film, mi.Point2f(0.5))
    first = scene.ray_intersect(ray)
    local = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
    local.z = dr.select(first.wi.z < 0, -local.z, local.z)
    second = scene.ray_intersect(first.spawn_ray(first.to_world(local)), first.is_valid())
    points = np.concatenate([si.p.numpy()[:, si.is_valid().numpy()] for si in (first, second)], 1)
    bounds = scene.bbox()
    low, high = np.array(bounds.min, np.float64), np.array(bounds.max, np.float64)
    if not points.size:
        return low, high, points
    lower, upper = np.percentile(points, (1, 99), axis=1)
    margin = 0.02 * (upper - lower)
    return np.maximum(lower - margin, low), np.minimum(upper + margin, high), points
