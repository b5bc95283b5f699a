"""An integrator for Mitsuba 3, `metapp_guided_path`: `path`, its directions sampled from what it learns of the scene.

    {"type": "metapp_guided_path", "max_depth": 8}

It is `guided_path`, too. Public scenes call another integrator so, of Mueller et al. 2017 (Practical Path Guiding for
Efficient Light-Transport Simulation): a scene that gives one of its properties is refused.

Properties: `max_depth`, `rr_depth` and `hide_emitters` as of `path`; `emitter_sampling` (true), whether there is
next-event estimation; and `checkpoint`, the file of the cache's prior: the one that ships unless given, "none" for
none, as without `emitter_sampling`, for which none was trained. The mean is that of `path`. Where a guide cannot help,
`path` renders instead, and a warning says so once.

A picture is rendered in parts, each guided by what a cache has learned from a survey of the scene and from the parts
before. Every part is a share of the picture that does not depend on what was sampled.
"""

from __future__ import annotations

import functools
import math
import time
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from metapp.learning.task import Params
from metapp.rendering import types as mt
from metapp.rendering.guide_cache import GuideCache, Records
from metapp.rendering.guide_prior import LearnedPrior, read_prior, shipped
from metapp.rendering.guide_survey import survey
from metapp.rendering.guided_path import PathTracer
from metapp.rendering.jit import dr, mi, register_plugin
from metapp.rendering.scene_plugins import snake_case

FEWEST = 3 * 2**18  # paths of a picture; with fewer there is no time to learn
FIRST = 2**18  # paths of the first guided part, of which a quarter of the picture is the most
LEARNED = 2**21  # paths after which the cache has learned enough
PAYS = 1.0  # the most that the error of a guided part may be, over that of `path` in the same time
FEWER = 0.3  # weight of samples of the regular part beside guided ones, where these pay
STEP_COST = 1.25  # of a guided bounce over one of `path`
BLOCK = 128  # samples of the blocks in which noise is compared, at least
LANES = 8  # paths that are traced side by side, until the last of them ends

_WAVE = 2**22  # paths at a time
_PROBES = 128  # rays along a side of the film that tell where the scene is


def parts_of(spp: int, pixels: int) -> list[int]:
    """Samples a pixel of the parts of a picture of `spp` in all.

    The first is of regular paths, and half of the next one. All but the last are learned from, up to a third of the
    picture; each of the guided ones has twice as many as the one before. There is but one where there are fewer than 8.
    """
    if spp < 8:
        return [spp]
    # of powers of two, as Dr.Jit compiles code for other numbers anew
    first = 2 ** int(math.log2(max(2, min(spp // 4, -(-FIRST // pixels)))))
    parts = [first // 2, first]
    while 3 * (sum(parts) + 2 * parts[-1]) <= spp and sum(parts) * pixels < LEARNED:
        parts.append(2 * parts[-1])
    return [*parts, spp - sum(parts)]


class Work(NamedTuple):
    """What paths brought, and what they took.

    Attributes:
        luminance: of the samples, [rows, columns, samples].
        bounces: of the longest of LANES paths, on average.
    """

    luminance: NDArray[np.float32]
    bounces: float

    def noise(self, samples: int) -> float:
        """How far halves of blocks of pixels differ, relative to their sum, on average; of so many samples of each."""
        side = math.ceil(math.sqrt(BLOCK / samples))
        rows, columns = (max(1, length // side) for length in self.luminance.shape[:2])
        tall, wide = (min(side, length) for length in self.luminance.shape[:2])
        blocks = self.luminance[: rows * tall, : columns * wide, :samples].reshape(rows, tall, columns, wide, samples)
        own = np.indices((tall, wide, samples)).sum(0) % 2 == 0
        sums = blocks.sum((1, 3, 4), dtype=np.float64)
        first = (blocks * own[:, None]).sum((1, 3, 4), dtype=np.float64)
        return float((np.abs(2 * first - sums)[sums > 0] / sums[sums > 0]).mean()) if (sums > 0).any() else 0.0

    def pays(self, regular: Work) -> bool:
        """Whether this guided part has less error than a regular one in the same time; errors go by the root of it."""
        samples = min(self.luminance.shape[2], regular.luminance.shape[2])
        time_ratio = STEP_COST * self.bounces / regular.bounces
        return self.noise(samples) * math.sqrt(time_ratio) <= PAYS * regular.noise(samples)


class GuidedPicture:
    """A picture in the making.

    Args:
        integrator: of Mitsuba, which the picture is for; has the regular one of the same properties as `path`.
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
        self.cache = GuideCache(*_extent(scene, sensor))
        if prior is not None:
            self.cache.prior = LearnedPrior(prior, survey(tracer, scene, sensor, self.cache, seed))
        self.first: mt.ImageBlock = None  # of the regular part
        self.block: mt.ImageBlock = None
        self.made, self.pays = 0, True
        self.regular: Work | None = None
        self.spent = {"survey": time.process_time() - begin}

    def render(self, spp: int) -> None:
        """Put all parts of so many samples a pixel on the sensor's film."""
        film = self.sensor.film()
        *learned, last = parts_of(spp, int(dr.prod(film.crop_size())))
        for part in learned:
            self.add(part, learns=True)
        self.add(last, learns=False)
        for block, weight in ((self.first, FEWER if self.pays else 1.0), (self.block, 1.0)):
            if block is not None:
                block.tensor()[:] = weight * block.tensor()
                film.put_block(block)

    def add(self, spp: int, *, learns: bool) -> None:
        """Add a part, and learn from it if asked to and as long as that pays; the first of these is regular."""
        width, height = self.sensor.film().crop_size()
        learns = learns and self.pays
        guided = self.pays and not (learns and self.regular is None)
        begin = time.process_time()
        wave = max(1, _WAVE // (width * height))
        works = [self._wave(min(wave, spp - first), guided, learns) for first in range(0, spp, wave)]
        dr.sync_thread()
        middle = time.process_time()
        if works[0] is not None:
            self._judge(works[0], guided)
            self.cache.learn()
        name = f"{'guided' if guided else 'regular'} samples{', which are learned from' if learns else ''}"
        for work, seconds in ((name, middle - begin), ("learning", time.process_time() - middle)):
            self.spent[work] = self.spent.get(work, 0.0) + seconds

    def _judge(self, work: Work, guided: bool) -> None:
        """Compare a part with the regular one, which comes first."""
        if guided and self.regular is not None:
            self.pays = work.pays(self.regular)
        else:
            self.regular, self.first, self.block = work, self.block, None

    def _wave(self, spp: int, guided: bool, learns: bool) -> Work | None:
        """Add samples to the picture; what they brought where the cache learns from them."""
        from mitsuba.python.ad.integrators.common import ADIntegrator

        film, own = self.sensor.film(), self.integrator
        seed = mi.sample_tea_32(mi.UInt32(self.seed), mi.UInt32(self.made))[0]
        sampler, spp = ADIntegrator.prepare(own, self.sensor, seed, spp, [])
        self.made += 1
        self.block = self.block or film.create_block()  # of a film that is prepared
        ray, weight, place = ADIntegrator.sample_rays(own, self.scene, self.sensor, sampler)
        records = Records(dr.width(place)) if learns else None
        work = None
        if guided or records is not None:
            light, hits, bounces = self.tracer.trace(self.scene, sampler, ray, self.cache, guided, records)
        else:
            light, hits, _ = own.path.sample(self.scene, sampler, ray)
        if records is not None:
            dr.eval(light, hits, place, weight, bounces)
            records.train(self.cache, light)
            rows = int(film.crop_size()[1]), int(film.crop_size()[0]), spp
            steps = bounces.numpy()
            longest = steps[: len(steps) // LANES * LANES].reshape(-1, LANES).max(1)
            work = Work(mi.luminance(light).numpy().reshape(rows), float(longest.mean()))
        alpha = dr.select(hits, mi.Float(1), mi.Float(0))
        # of the film's own kind, such as that of spectra
        ADIntegrator._splat_to_block(self.block, film, place, light * weight, mi.Float(1), alpha, [], ray.wavelengths)
        dr.eval(self.block.tensor())
        return work


def _extent(scene: mt.Scene, sensor: mt.Sensor) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The box in which most of what the camera sees lies, and most of what is seen from there."""
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
        return low, high
    lower, upper = np.percentile(points, (1, 99), axis=1)
    margin = 0.02 * (upper - lower)
    return np.maximum(lower - margin, low), np.minimum(upper + margin, high)


NAME, SHORT_NAME = "metapp_guided_path", "guided_path"
# properties of the integrator of Mueller et al. that is called guided_path
_OTHERS = {"budget", "budget_type", "bsdf_sampling_fraction", "bsdf_sampling_fraction_loss", "directional_filter",
           "d_tree_threshold", "dump_sdtree", "nee", "s_tree_threshold", "sample_combination", "sd_tree_max_memory",
           "spatial_filter", "spp_per_pass"}  # fmt: skip
NO_PRIOR = "none"
DEPTH, RR_DEPTH = -1, 5  # as of `path`


@functools.cache  # once: Mitsuba keeps what is called when its variant changes
def register_guided_path() -> None:
    """Have Mitsuba know the plugin by both names, in the variant that is active and in all that will be."""
    for name in (NAME, SHORT_NAME):
        register_plugin("integrator", name, plugin)


def plugin() -> mt.PluginClass:
    """The class of the plugin in the active variant."""

    class GuidedPath(mi.SamplingIntegrator):  # type: ignore[misc]  # a class of the variant
        """Properties, by default: `max_depth` -1, `rr_depth` 5, `hide_emitters` false, `emitter_sampling` true."""

        def __init__(self, props: mt.Properties) -> None:
            mi.SamplingIntegrator.__init__(self, props)
            _check_meant(props)
            self.path = _path(props)  # refuses what is out of range
            depth, rr_depth = int(props.get("max_depth", DEPTH)), int(props.get("rr_depth", RR_DEPTH))
            emitter_sampling = bool(props.get("emitter_sampling", True))
            if self.hide_emitters and not emitter_sampling:
                raise ValueError(f"{NAME}: hide_emitters without emitter_sampling, expected one of them; change it.")
            checkpoint = str(props.get("checkpoint", ""))
            none = checkpoint == NO_PRIOR or not emitter_sampling
            self.prior = None if none else read_prior(Path(checkpoint) if checkpoint else shipped())
            self.spent: dict[str, float] = {}  # seconds of CPU of the last picture's parts
            self.tracer = PathTracer(depth if depth >= 0 else 2**32 - 1, rr_depth, emitter_sampling)

        def render(
            self,
            scene: mt.Scene,
            sensor: mt.Sensor | int = 0,
            seed: mt.UInt32 | int = 0,
            spp: int = 0,
            develop: bool = True,
            evaluate: bool = True,
        ) -> mt.Tensorf:
            sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
            spp, film = spp or sensor.sampler().sample_count(), sensor.film()
            paths = spp * int(dr.prod(film.crop_size()))
            why = _useless(self.tracer, scene, paths, hides_emitters=self.hide_emitters)
            if why:
                _warn(why)
                return self.path.render(scene, sensor, seed, spp, develop, evaluate)
            with dr.suspend_grad():
                picture = GuidedPicture(self, self.tracer, scene, sensor, seed, self.prior)
                picture.render(spp)
                self.spent = picture.spent
                if not picture.pays:
                    _warn("what was learned of a scene does not lower the noise enough")
                return film.develop() if develop else mi.TensorXf()

        def sample(
            self, scene: mt.Scene, sampler: mt.Sampler, ray: mt.Ray, medium: object = None, active: mt.Mask = True
        ) -> tuple[mt.Color, mt.Mask, list[object]]:
            """As `path` does."""
            _warn("another integrator asks it for rays, expected to be asked for a picture")
            return self.path.sample(scene, sampler, ray, medium, active)  # type: ignore[no-any-return]

        def to_string(self) -> str:
            return f"GuidedPath[max_depth = {self.tracer.max_depth}, rr_depth = {self.tracer.rr_depth}]"

    return GuidedPath


def _check_meant(props: mt.Properties) -> None:
    """Refuse the properties of another integrator that public scenes call guided_path."""
    others = [name for name in props.keys() if snake_case(name) in _OTHERS]  # noqa: SIM118  (no dictionary)
    if others:
        raise ValueError(
            f"{SHORT_NAME}: '{others[0]}' is a property of the integrator of Mueller et al. 2017, expected {NAME} with "
            "max_depth, rr_depth, hide_emitters, emitter_sampling or checkpoint; change the scene to the one it means."
        )


def _path(props: mt.Properties) -> mt.Integrator:
    """Mitsuba's `path` of the same properties."""
    names = ("max_depth", "rr_depth", "hide_emitters")
    return mi.load_dict({"type": "path", **{name: props[name] for name in names if name in props}})


def _useless(tracer: PathTracer, scene: mt.Scene, paths: int, *, hides_emitters: bool) -> str:
    """Why a guide cannot help, if so."""
    if tracer.emitter_sampling and tracer.max_depth <= 2:
        return f"max_depth {tracer.max_depth} leaves direct light alone, expected 3 or more"
    if not scene.bbox().valid():
        return "no surfaces to learn of"
    if hides_emitters:
        return "hide_emitters, which is not guided"
    few = tracer.emitter_sampling and paths < FEWEST
    return f"{paths:,} paths (samples a pixel times pixels), expected {FEWEST:,} or more" if few else ""


def _warn(why: str) -> None:
    """Warn, once a reason, that `path` renders."""
    if why not in _WARNED:
        _WARNED.add(why)
        warnings.warn(f"{NAME}: {why}; rendered by path.", stacklevel=2)


_WARNED: set[str] = set()
