"""An integrator for Mitsuba 3, `metapp_guided_path`: `path`, its directions sampled from a cache of the scene's light.

    {"type": "metapp_guided_path", "max_depth": 8}

The properties `max_depth`, `rr_depth` and `hide_emitters` are those that `path` has, and so is the mean of pictures.
Where a guide cannot help, `path` renders instead, and a warning says so once.
"""

from __future__ import annotations

import functools
import math
import warnings
from typing import NoReturn

from metapp.extensions.guided.guided_picture import (
    MAX_GUIDED_ERROR_RATIO,
    MIN_SPP_FOR_PARTS,
    GuidedPicture,
    sampled_film_size,
)
from metapp.extensions.guided.path_tracer import PathTracer
from metapp.extensions.guided.prior import read_prior
from metapp.rendering import types as mt
from metapp.rendering.jit import dr, mi, register_plugin
from metapp.runs.environment import torch_defaults

MIN_LEARNING_PATHS = 3 * 2**18  # a picture of fewer paths has no time to learn
MIN_SURVEYED_PATHS = 2**21  # in a picture of so many paths survey and prior take a small part of the time
INTEGRATOR_NAME = "metapp_guided_path"
_NO_DERIVATIVES = (
    f"{INTEGRATOR_NAME} has no derivatives, expected an integrator that has; take prb, of the same max_depth."
)


@functools.cache  # registered once: Mitsuba keeps the functions that it calls when its variant changes
def register_guided_path() -> None:
    """Register the plugin with Mitsuba in the active variant and in all variants that will be set."""
    register_plugin("integrator", INTEGRATOR_NAME, guided_path_class)


def guided_path_class() -> mt.PluginClass:
    """Return the class of the plugin in the active variant."""

    class GuidedPath(mi.SamplingIntegrator):  # type: ignore[misc]  # the base class depends on the variant
        """The plugin; its properties are, by default, `max_depth` -1, `rr_depth` 5, `hide_emitters` false.

        Attributes:
            min_learning_paths: the fewest paths of a picture that is guided; a program may set it before it renders.
            min_surveyed_paths: the fewest paths of a picture that begins with a survey.
            max_error_ratio: see :class:`GuidedPicture`.
        """

        def __init__(self, props: mt.Properties) -> None:
            mi.SamplingIntegrator.__init__(self, props)
            given_properties = {
                name: props[name] for name in ("max_depth", "rr_depth", "hide_emitters") if name in props
            }
            self.path = mi.load_dict({"type": "path", **given_properties})  # it refuses values that are out of range
            depth, rr_depth = int(props.get("max_depth", -1)), int(props.get("rr_depth", 5))  # defaults of `path`
            self.min_learning_paths, self.min_surveyed_paths = MIN_LEARNING_PATHS, MIN_SURVEYED_PATHS
            self.max_error_ratio = MAX_GUIDED_ERROR_RATIO
            self.spent: dict[str, float] = {}  # seconds of CPU of the last picture's parts, by name
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
            with torch_defaults(single=False):  # the prior is read by torch, whose defaults a program may have set
                prior = read_prior() if paths >= self.min_surveyed_paths else None
            # a picture of one part learns from the survey alone
            min_paths = self.min_learning_paths if spp >= MIN_SPP_FOR_PARTS else self.min_surveyed_paths
            reason = _find_obstacle(self.tracer, scene, paths, min_paths, hides_emitters=self.hide_emitters)
            if reason:
                _warn(reason)
                return self.path.render(scene, sensor, seed, spp, develop, evaluate)
            with dr.suspend_grad(), torch_defaults(single=False):
                picture = GuidedPicture(self.path, self.tracer, scene, sensor, seed, prior, self.max_error_ratio)
                picture.render(spp)
                self.spent = picture.spent
                if not picture.guiding_helps:
                    _warn("what was learned of a scene does not lower the noise enough")
                return film.develop() if develop else mi.TensorXf()

        def render_forward(self, *_: object, **__: object) -> NoReturn:
            """Refuse to differentiate: the guide is learned from pictures of other parameters."""
            raise NotImplementedError(_NO_DERIVATIVES)

        def render_backward(self, *_: object, **__: object) -> NoReturn:
            """Refuse to differentiate, for the reason of `render_forward`."""
            raise NotImplementedError(_NO_DERIVATIVES)

        def sample(
            self, scene: mt.Scene, sampler: mt.Sampler, ray: mt.Ray, medium: object = None, active: mt.Mask = True
        ) -> tuple[mt.Color, mt.Mask, list[object]]:
            """Return the radiance of rays by `path`, and warn that it is not guided."""
            _warn("another integrator asks it for rays, expected to be asked for a picture")
            return self.path.sample(scene, sampler, ray, medium, active)  # type: ignore[no-any-return]

        def to_string(self) -> str:
            return f"GuidedPath[max_depth = {self.tracer.max_depth}, rr_depth = {self.tracer.rr_depth}]"

    return GuidedPath


def _find_obstacle(tracer: PathTracer, scene: mt.Scene, paths: int, min_paths: int, *, hides_emitters: bool) -> str:
    """Return why a guide cannot help, "" if it can."""
    if tracer.max_depth <= 2:
        return f"max_depth {tracer.max_depth} leaves direct light alone, expected 3 or more"
    if not scene.bbox().valid():
        return "no surfaces to learn of"
    if hides_emitters:
        return "hide_emitters, which is not guided"
    return (
        f"{paths:,} paths (samples a pixel times pixels), expected {min_paths:,} or more" if paths < min_paths else ""
    )


def _warn(reason: str) -> None:
    """Warn that `path` renders instead, once for each reason."""
    if reason not in _WARNED:
        _WARNED.add(reason)
        warnings.warn(f"{INTEGRATOR_NAME}: {reason}; rendered by path.", stacklevel=2)


_WARNED: set[str] = set()
