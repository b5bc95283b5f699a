"""A picture that the integrator `metapp_guided_path` makes.

The picture is rendered in parts: a regular one, then guided ones, by a cache that has learned from a survey of the
scene and from the parts before. The share of the picture that a part makes up does not depend on samples, so that the
mean of the picture is right.
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

MIN_SPP_FOR_PARTS = 4  # with fewer samples a pixel a picture has one part
FIRST_GUIDED_PATHS = 2**18  # paths of the first guided part, but at most a quarter of the picture's
MAX_LEARNING_PATHS = 2**21  # paths after which the cache has learned enough
MAX_GUIDED_ERROR_RATIO = 1.0
REGULAR_PART_WEIGHT = 0.3  # weight of samples of the regular part over samples of guided ones, where guiding helps
GUIDED_BOUNCE_COST_RATIO = 1.25  # time of a guided bounce over the time of a bounce of `path`
MIN_NOISE_BLOCK_SAMPLES = 128  # samples of a block of pixels in which noise is compared
PATHS_PER_VECTOR = 8  # paths that are traced side by side, until the last of them ends

_MAX_WAVE_PATHS = 2**22  # paths that are traced at a time
_PROBE_SIDE_RAYS = 128  # rays along a side of the film that find where the scene is


def split_samples(spp: int, pixels: int) -> list[int]:
    """Split the samples a pixel of a picture among its parts.

    The first part is of regular paths; it has half as many samples as the next one, or one if the next one has one. All
    parts but the last are learned from, up to a third of the picture; each of the guided ones has twice as many samples
    as the one before. With fewer than MIN_SPP_FOR_PARTS samples there is one part.

    Args:
        spp: the samples a pixel of the picture.
        pixels: the number of pixels.

    Returns:
        The samples a pixel of each part.
    """
    if spp < MIN_SPP_FOR_PARTS:
        return [spp]
    # powers of two, as Dr.Jit compiles code anew for other numbers of samples
    first_guided = 2 ** int(math.log2(max(1, min(spp // 4, -(-FIRST_GUIDED_PATHS // pixels)))))
    parts = [max(1, first_guided // 2), first_guided]
    while 3 * (sum(parts) + 2 * parts[-1]) <= spp and sum(parts) * pixels < MAX_LEARNING_PATHS:
        parts.append(2 * parts[-1])
    return [*parts, spp - sum(parts)]


def sampled_film_size(film: mt.Film) -> tuple[int, int]:
    """Return the rows and columns of pixels that paths are traced through.

    With `sample_border` these include pixels around the film.
    """
    border = 2 * film.rfilter().border_size() if film.sample_border() else 0
    width, height = film.crop_size()
    return int(height) + border, int(width) + border


class PartCost(NamedTuple):
    """The luminance of a part's paths, and their cost.

    Attributes:
        luminance: the luminance of the samples, [rows, columns, samples].
        bounces: the bounces of the longest of PATHS_PER_VECTOR paths, on average.
    """

    luminance: NDArray[np.float32]
    bounces: float

    def relative_noise(self, samples: int) -> float:
        """Return the mean difference of halves of blocks of pixels, divided by their sum.

        Args:
            samples: how many samples of each pixel are compared.
        """
        side = math.ceil(math.sqrt(MIN_NOISE_BLOCK_SAMPLES / samples))
        rows, columns = (max(1, length // side) for length in self.luminance.shape[:2])
        block_rows, block_columns = (min(side, length) for length in self.luminance.shape[:2])
        blocks = self.luminance[: rows * block_rows, : columns * block_columns, :samples].reshape(
            rows, block_rows, columns, block_columns, samples
        )
        is_first_half = np.indices((block_rows, block_columns, samples)).sum(0) % 2 == 0
        sums = blocks.sum((1, 3, 4), dtype=np.float64)
        first_half_sums = (blocks * is_first_half[:, None]).sum((1, 3, 4), dtype=np.float64)
        return (
            float((np.abs(2 * first_half_sums - sums)[sums > 0] / sums[sums > 0]).mean()) if (sums > 0).any() else 0.0
        )

    def reduces_error(self, regular: PartCost, max_ratio: float = MAX_GUIDED_ERROR_RATIO) -> bool:
        """Return True if this guided part has less error than a regular one in the same time.

        Errors fall with the root of time.

        Args:
            regular: the regular part.
            max_ratio: the error of this part over the error of the regular one, at most.
        """
        samples = min(self.luminance.shape[2], regular.luminance.shape[2])
        time_ratio = GUIDED_BOUNCE_COST_RATIO * self.bounces / regular.bounces
        return self.relative_noise(samples) * math.sqrt(time_ratio) <= max_ratio * regular.relative_noise(samples)


class GuidedPicture:
    """A picture in the making: what was rendered of it so far, and the cache that guides the rest.

    Args:
        integrator: Mitsuba's `path` of the same properties, by which regular paths are traced.
        tracer: the tracer of paths that are guided or learned from.
        scene, sensor, seed: the arguments of an integrator's `render`.
        prior: the parameters of the network that is the cache's prior; None for the voxels around.
        max_error_ratio: the error of a guided part over the error of `path` in the same time, at most; where a part
            has more, the rest of the picture is regular.

    Attributes:
        regular_block: the image of the regular part; None before it is rendered.
        block: the image of the guided parts; None before there is one.
        wave_count: the number of waves of paths that were traced.
        regular_cost: the luminance and the cost of regular paths; None before they were traced.
        cache: the cache.
        guiding_helps: whether guided paths have less error in the same time, as far as is known.
        spent: the seconds of CPU that each kind of work took, by its name.
    """

    def __init__(
        self,
        integrator: mt.Integrator,
        tracer: PathTracer,
        scene: mt.Scene,
        sensor: mt.Sensor,
        seed: mt.UInt32 | int,
        prior: Params | None = None,
        max_error_ratio: float = MAX_GUIDED_ERROR_RATIO,
    ) -> None:
        start = time.process_time()
        self.integrator, self.tracer, self.scene, self.sensor, self.seed = integrator, tracer, scene, sensor, seed
        self.regular_block: mt.ImageBlock = None  # the image of the regular part
        self.block: mt.ImageBlock = None
        self.wave_count = 0
        self.guiding_helps, self.max_error_ratio = True, max_error_ratio
        self.regular_cost: PartCost | None = None
        self.cache = GuideCache(*_find_extent(scene, sensor))
        if prior is not None:
            self.cache.prior = LearnedPrior(prior, *survey(tracer, scene, sensor, self.cache, seed))
        self.spent = {"survey": time.process_time() - start}

    def render(self, spp: int) -> None:
        """Render all parts with so many samples a pixel, and put them on the sensor's film."""
        film = self.sensor.film()
        parts = split_samples(spp, math.prod(sampled_film_size(film)))
        if len(parts) == 1:
            self.cache.update_histograms()  # it learns from the survey alone
        for part in parts[:-1]:
            self.render_part(part, learns=True)
        self.render_part(parts[-1], learns=False)
        for block, weight in (
            (self.regular_block, REGULAR_PART_WEIGHT if self.guiding_helps else 1.0),
            (self.block, 1.0),
        ):
            if block is not None:
                block.tensor()[:] = weight * block.tensor()
                film.put_block(block)

    def render_part(self, spp: int, *, learns: bool) -> None:
        """Render a part, and learn from it if asked to, as long as guiding helps.

        The first part that is learned from is regular.
        """
        learns = learns and self.guiding_helps
        guided = self.guiding_helps and not (learns and self.regular_cost is None)
        start = time.process_time()
        spp_per_wave = max(1, _MAX_WAVE_PATHS // math.prod(sampled_film_size(self.sensor.film())))
        costs = [
            self._render_wave(min(spp_per_wave, spp - first), guided, learns) for first in range(0, spp, spp_per_wave)
        ]
        dr.sync_thread()
        rendering_end = time.process_time()
        if costs[0] is not None:
            if guided and self.regular_cost is not None:
                self.guiding_helps = costs[0].reduces_error(self.regular_cost, self.max_error_ratio)
            else:
                self.regular_cost, self.regular_block, self.block = costs[0], self.block, None
            self.cache.update_histograms()
        name = f"{'guided' if guided else 'regular'} samples{', which are learned from' if learns else ''}"
        for kind, seconds in ((name, rendering_end - start), ("learning", time.process_time() - rendering_end)):
            self.spent[kind] = self.spent.get(kind, 0.0) + seconds

    def _render_wave(self, spp: int, guided: bool, learns: bool) -> PartCost | None:
        """Add samples to the picture, and return the cost of their paths if the cache learns from them."""
        from mitsuba.python.ad.integrators.common import ADIntegrator

        film, path_integrator = self.sensor.film(), self.integrator
        seed = mi.sample_tea_32(mi.UInt32(self.seed), mi.UInt32(self.wave_count))[0]
        sampler, spp = ADIntegrator.prepare(path_integrator, self.sensor, seed, spp, [])
        self.wave_count += 1
        self.block = self.block or film.create_block()  # created when the film is prepared
        ray, weight, film_places = ADIntegrator.sample_rays(path_integrator, self.scene, self.sensor, sampler)
        records = BounceRecords(dr.width(film_places)) if learns else None
        cost = None
        if guided or records is not None:
            radiance, hits, bounces = self.tracer.trace(self.scene, sampler, ray, self.cache, guided, records)
        else:
            radiance, hits, _ = path_integrator.sample(self.scene, sampler, ray)
        if records is not None:
            dr.eval(radiance, hits, film_places, weight, bounces)
            records.add_to_cache(self.cache, radiance)
            shape = *sampled_film_size(film), spp
            path_bounces = bounces.numpy()
            longest = (
                path_bounces[: len(path_bounces) // PATHS_PER_VECTOR * PATHS_PER_VECTOR]
                .reshape(-1, PATHS_PER_VECTOR)
                .max(1)
            )
            cost = PartCost(mi.luminance(radiance).numpy().reshape(shape), float(longest.mean()))
        alpha = dr.select(hits, mi.Float(1), mi.Float(0))
        # the block is of the film's own kind, such as one of spectra
        ADIntegrator._splat_to_block(
            self.block, film, film_places, radiance * weight, mi.Float(1), alpha, [], ray.wavelengths
        )
        dr.eval(self.block.tensor())
        return cost


def _find_extent(
    scene: mt.Scene, sensor: mt.Sensor
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float32]]:
    """Find the box of most surfaces that the camera sees, and of those visible from there.

    Returns:
        The lower and the upper corner of the box, [3] each, and points of both kinds of surfaces, [3, N].
    """
    index = dr.arange(mi.UInt32, _PROBE_SIDE_RAYS**2)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, _PROBE_SIDE_RAYS**2)
    film_places = mi.Point2f(mi.Float(index % _PROBE_SIDE_RAYS), mi.Float(index // _PROBE_SIDE_RAYS)) / _PROBE_SIDE_RAYS
    ray, _ = sensor.sample_ray(sensor.shutter_open(), sampler.next_1d(), film_places, mi.Point2f(0.5))
    first = scene.ray_intersect(ray)
    local = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
    local.z = dr.select(first.wi.z < 0, -local.z, local.z)
    second = scene.ray_intersect(first.spawn_ray(first.to_world(local)), first.is_valid())
    points = np.concatenate([si.p.numpy()[:, si.is_valid().numpy()] for si in (first, second)], 1)
    bounds = scene.bbox()
    low, high = np.array(bounds.min, np.float64), np.array(bounds.max, np.float64)
    if not points.size:
        return low, high, points
    low_percentile, high_percentile = np.percentile(points, (1, 99), axis=1)
    margin = 0.02 * (high_percentile - low_percentile)
    return np.maximum(low_percentile - margin, low), np.minimum(high_percentile + margin, high), points
