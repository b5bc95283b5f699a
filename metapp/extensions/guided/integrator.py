"""An integrator for Mitsuba 3, `metapp_guided_path`: `path`, its directions sampled from a cache of the scene's light.

    {"type": "metapp_guided_path", "max_depth": 8}

Properties: `max_depth`, `rr_depth` and `hide_emitters`, as of `path`. The mean is that of `path`. Where a guide cannot
help, `path` renders instead, and a warning says so once.
"""

from __future__ import annotations

import functools
import math
import warnings
from typing import NoReturn

from metapp.extensions.guided.guided_picture import MIN_SPP_FOR_PARTS, GuidedPicture, sampled_film_size
from metapp.extensions.guided.path_tracer import PathTracer
from metapp.extensions.guided.prior import read_prior
from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi, register_plugin
from metapp.runs.environment import torch_defaults

MIN_LEARNING_PATHS = 3 * 2**18  # paths of a picture; with fewer there is no time to learn
MIN_SURVEYED_PATHS = 2**21  # from which the survey and the prior are a small part of the time
INTEGRATOR_NAME = "metapp_guided_path"
_NO_DERIVATIVES = (
    f"{INTEGRATOR_NAME} has no derivatives, expected an integrator that has; take prb, of the same max_depth."
)


@functools.cache  # once: Mitsuba keeps what is called when its variant changes
def register_guided_path() -> None:
    """Have Mitsuba know the plugin in the variant that is active and in all that will be."""
    register_plugin("integrator", INTEGRATOR_NAME, guided_path_class)


def guided_path_class() -> mt.PluginClass:
    """The class of the plugin in the active variant."""

    class GuidedPath(mi.SamplingIntegrator):  # type: ignore[misc]  # a class of the variant
        """Properties, by default: `max_depth` -1, `rr_depth` 5, `hide_emitters` false."""

        def __init__(self, props: mt.Properties) -> None:
            mi.SamplingIntegrator.__init__(self, props)
            given = {name: props[name] for name in ("max_depth", "rr_depth", "hide_emitters") if name in props}
            self.path = mi.load_dict({"type": "path", **given})  # refuses what is out of range
            depth, rr_depth = int(props.get("max_depth", -1)), int(props.get("rr_depth", 5))  # as of `path`
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
            paths = spp * math.prod(sampled_film_size(film))
            with torch_defaults(single=False):  # the prior is of torch, whose defaults a program may have set
                prior = read_prior() if paths >= MIN_SURVEYED_PATHS else None
            fewest = (
                MIN_LEARNING_PATHS if spp >= MIN_SPP_FOR_PARTS else MIN_SURVEYED_PATHS
            )  # the survey alone may be learned from
            why = _useless(self.tracer, scene, paths, fewest, hides_emitters=self.hide_emitters)
            if why:
                _warn(why)
                return self.path.render(scene, sensor, seed, spp, develop, evaluate)
            with dr.suspend_grad(), torch_defaults(single=False):
                picture = GuidedPicture(self.path, self.tracer, scene, sensor, seed, prior)
                picture.render(spp)
                self.spent = picture.spent
                if not picture.pays:
                    _warn("what was learned of a scene does not lower the noise enough")
                return film.develop() if develop else mi.TensorXf()

        def render_forward(self, *_: object, **__: object) -> NoReturn:
            """Refuse to differentiate: what guides paths is learned of pictures of other parameters."""
            raise NotImplementedError(_NO_DERIVATIVES)

        def render_backward(self, *_: object, **__: object) -> NoReturn:
            """Refuse to differentiate, as `render_forward` does."""
            raise NotImplementedError(_NO_DERIVATIVES)

        def sample(
            self, scene: mt.Scene, sampler: mt.Sampler, ray: mt.Ray, medium: object = None, active: mt.Mask = True
        ) -> tuple[mt.Color, mt.Mask, list[object]]:
            """As `path` does."""
            _warn("another integrator asks it for rays, expected to be asked for a picture")
            return self.path.sample(scene, sampler, ray, medium, active)  # type: ignore[no-any-return]

        def to_string(self) -> str:
            return f"GuidedPath[max_depth = {self.tracer.max_depth}, rr_depth = {self.tracer.rr_depth}]"

    return GuidedPath


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
        warnings.warn(f"{INTEGRATOR_NAME}: {why}; rendered by path.", stacklevel=2)


_WARNED: set[str] = set()
