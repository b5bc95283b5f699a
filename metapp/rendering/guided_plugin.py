"""The integrator `guided_path` of Mitsuba 3: Mitsuba's `path`, its directions drawn where light was found before.

    {"type": "guided_path", "max_depth": 8}

Properties: `max_depth`, `rr_depth` and `hide_emitters` as of `path`; `emitter_sampling` (true), whether surfaces are
joined to emitters as well; and `checkpoint`, the file of the prior, which says what a cache expects before paths teach
it: the one that ships unless given, "none" for none, as without `emitter_sampling`, for which none was trained. The
mean is that of `path`. Where a guide cannot help, `path` renders instead, and a warning says so once. Choose a libLLVM
before this module is imported: `metapp.rendering.variant.choose_llvm`.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi

from metapp.rendering.guide_prior import read_prior, shipped
from metapp.rendering.guided_path import PathTracer, Settings
from metapp.rendering.guided_picture import FEWEST, GuidedPicture, parts_of
from metapp.rendering.plugins import register_plugin

NAME = "guided_path"
NO_PRIOR = "none"
DEPTH, RR_DEPTH = -1, 5  # as of `path`


def register_guided_path() -> None:
    """Have Mitsuba know the plugin, in the variant that is active and in all that will be."""
    register_plugin("integrator", NAME, plugin)


def _path(props: Any) -> Any:
    """Mitsuba's `path` of the same properties."""
    names = ("max_depth", "rr_depth", "hide_emitters")
    return mi.load_dict({"type": "path", **{name: props[name] for name in names if name in props}})


def pixels_of(sensor: Any) -> int:
    """Of a sensor's film."""
    return int(dr.prod(sensor.film().crop_size()))


def _say(why: str) -> None:
    """Tell, once a reason, that there is no guide."""
    if why not in _SAID:
        _SAID.add(why)
        warnings.warn(f"{NAME}: {why}; rendered by path.", stacklevel=2)


_SAID: set[str] = set()


def plugin() -> Any:
    """The class of the plugin in the active variant."""

    class GuidedPath(mi.SamplingIntegrator):  # a class of the variant
        """Properties, by default: `max_depth` -1, `rr_depth` 5, `hide_emitters` false, `emitter_sampling` true."""

        def __init__(self, props: Any) -> None:
            mi.SamplingIntegrator.__init__(self, props)
            depth, rr_depth = int(props.get("max_depth", DEPTH)), int(props.get("rr_depth", RR_DEPTH))
            self.path = _path(props)  # refuses what is out of range
            joins = bool(props.get("emitter_sampling", True))
            if self.hide_emitters and not joins:
                raise ValueError(f"{NAME}: hide_emitters without emitter_sampling, expected one of them; change it.")
            checkpoint = str(props.get("checkpoint", ""))
            none = checkpoint == NO_PRIOR or not joins
            self.prior = None if none else read_prior(Path(checkpoint) if checkpoint else shipped())
            self.spent: dict[str, float] = {}  # seconds of CPU of the last picture's parts
            self.tracer = PathTracer(mi, Settings(depth if depth >= 0 else 2**32 - 1, rr_depth, joins))

        def render(
            self,
            scene: Any,
            sensor: Any = 0,
            seed: Any = 0,
            spp: int = 0,
            develop: bool = True,
            evaluate: bool = True,
        ) -> Any:
            sensor = scene.sensors()[sensor] if isinstance(sensor, int) else sensor
            spp = spp or sensor.sampler().sample_count()
            why = self._useless(scene, spp * pixels_of(sensor))
            if why:
                _say(why)
                return self.path.render(scene, sensor, seed, spp, develop, evaluate)
            film = sensor.film()
            with dr.suspend_grad():
                picture = GuidedPicture(self, self.tracer, scene, sensor, seed, self.prior)
                for part in parts_of(spp, pixels_of(sensor)):
                    picture.add(part)
                self.spent = picture.spent
                film.put_block(picture.block)
                if not picture.pays:
                    _say("what was learned of a scene does not lower the noise enough")
                return film.develop() if develop else mi.TensorXf()

        def sample(self, scene: Any, sampler: Any, ray: Any, medium: Any = None, active: Any = True) -> Any:
            """As `path` does."""
            _say("another integrator asks it for rays, expected to be asked for a picture")
            return self.path.sample(scene, sampler, ray, medium, active)

        def _useless(self, scene: Any, paths: int) -> str:
            settings = self.tracer.settings
            if settings.joins and settings.max_depth <= 2:
                return f"max_depth {settings.max_depth} leaves direct light alone, expected 3 or more"
            if not scene.bbox().valid():
                return "no surfaces to learn of"
            if self.hide_emitters:
                return "hide_emitters, which is not guided"
            few = settings.joins and paths < FEWEST
            return f"{paths:,} paths (samples a pixel times pixels), expected {FEWEST:,} or more" if few else ""

        def to_string(self) -> str:
            settings = self.tracer.settings
            return f"GuidedPath[max_depth = {settings.max_depth}, rr_depth = {settings.rr_depth}]"

    return GuidedPath
