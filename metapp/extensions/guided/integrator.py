"""An integrator for Mitsuba 3, `metapp_guided_path`: `path`, its directions sampled from what it learns of the scene.

    {"type": "metapp_guided_path", "max_depth": 8}

It is `guided_path`, too. Public scenes call another integrator so, of Mueller et al. 2017 (Practical Path Guiding for
Efficient Light-Transport Simulation): a scene that gives one of its properties is refused.

Properties: `max_depth`, `rr_depth` and `hide_emitters`, as of `path`. The mean is that of `path`. Where a guide cannot
help, `path` renders instead, and a warning says so once.
"""

from __future__ import annotations

import functools
import warnings

from metapp.extensions.guided.path_tracer import PathTracer
from metapp.extensions.guided.picture import SEVERAL, GuidedPicture
from metapp.extensions.guided.prior import read_prior
from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi, register_plugin
from metapp.rendering.scenes.plugins import snake_case

FEWEST = 3 * 2**18  # paths of a picture; with fewer there is no time to learn
SURVEYED = 2**21  # from which the survey and the prior are a small part of the time
NAME, SHORT_NAME = "metapp_guided_path", "guided_path"
# properties of the integrator of Mueller et al. that is called guided_path
_OTHERS = {"budget", "budget_type", "bsdf_sampling_fraction", "bsdf_sampling_fraction_loss", "directional_filter",
           "d_tree_threshold", "dump_sdtree", "nee", "s_tree_threshold", "sample_combination", "sd_tree_max_memory",
           "spatial_filter", "spp_per_pass"}  # fmt: skip
DEPTH, RR_DEPTH = -1, 5  # as of `path`


@functools.cache  # once: Mitsuba keeps what is called when its variant changes
def register_guided_path() -> None:
    """Have Mitsuba know the plugin by both names, in the variant that is active and in all that will be."""
    for name in (NAME, SHORT_NAME):
        register_plugin("integrator", name, plugin)


def plugin() -> mt.PluginClass:
    """The class of the plugin in the active variant."""

    class GuidedPath(mi.SamplingIntegrator):  # type: ignore[misc]  # a class of the variant
        """Properties, by default: `max_depth` -1, `rr_depth` 5, `hide_emitters` false."""

        def __init__(self, props: mt.Properties) -> None:
            mi.SamplingIntegrator.__init__(self, props)
            _check_meant(props)
            self.path = _path(props)  # refuses what is out of range
            depth, rr_depth = int(props.get("max_depth", DEPTH)), int(props.get("rr_depth", RR_DEPTH))
            self.spent: dict[str, float] = {}  # seconds of CPU of the last picture's parts
            self.tracer = PathTracer(depth if depth >= 0 else 2**32 - 1, rr_depth)

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
            prior = read_prior() if paths >= SURVEYED else None
            fewest = FEWEST if spp >= SEVERAL else SURVEYED  # the survey alone may be learned from
            why = _useless(self.tracer, scene, paths, fewest, hides_emitters=self.hide_emitters)
            if why:
                _warn(why)
                return self.path.render(scene, sensor, seed, spp, develop, evaluate)
            with dr.suspend_grad():
                picture = GuidedPicture(self.path, self.tracer, scene, sensor, seed, prior)
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
            "max_depth, rr_depth or hide_emitters; change the scene to the one it means."
        )


def _path(props: mt.Properties) -> mt.Integrator:
    """Mitsuba's `path` of the same properties."""
    names = ("max_depth", "rr_depth", "hide_emitters")
    return mi.load_dict({"type": "path", **{name: props[name] for name in names if name in props}})


def _useless(tracer: PathTracer, scene: mt.Scene, paths: int, fewest: int, *, hides_emitters: bool) -> str:
    """Why a guide cannot help, if so."""
    if tracer.max_depth <= 2:
        return f"max_depth {tracer.max_depth} leaves direct light alone, expected 3 or more"
    if not scene.bbox().valid():
        return "no surfaces to learn of"
    if hides_emitters:
        return "hide_emitters, which is not guided"
    return f"{paths:,} paths (samples a pixel times pixels), expected {fewest:,} or more" if paths < fewest else ""


def _warn(why: str) -> None:
    """Warn, once a reason, that `path` renders."""
    if why not in _WARNED:
        _WARNED.add(why)
        warnings.warn(f"{NAME}: {why}; rendered by path.", stacklevel=2)


_WARNED: set[str] = set()
