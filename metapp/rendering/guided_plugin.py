"""The integrator `guided_path` of Mitsuba 3: Mitsuba's `path`, its directions sampled from what it learns of the scene.

    {"type": "guided_path", "max_depth": 8}

Properties: `max_depth`, `rr_depth` and `hide_emitters` as of `path`; `emitter_sampling` (true), whether there is
next-event estimation; and `checkpoint`, the file of the cache's prior: the one that ships unless given, "none" for
none, as without `emitter_sampling`, for which none was trained. The mean is that of `path`. Where a guide cannot help,
`path` renders instead, and a warning says so once.
"""

from __future__ import annotations

import warnings
from pathlib import Path

from metapp.rendering import types as mt
from metapp.rendering.guide_prior import read_prior, shipped
from metapp.rendering.guided_path import PathTracer, Settings
from metapp.rendering.guided_picture import FEWEST, GuidedPicture, parts_of
from metapp.rendering.jit import dr, mi
from metapp.rendering.plugins import register_plugin

NAME = "guided_path"
NO_PRIOR = "none"
DEPTH, RR_DEPTH = -1, 5  # as of `path`


def register_guided_path() -> None:
    """Have Mitsuba know the plugin, in the variant that is active and in all that will be."""
    register_plugin("integrator", NAME, plugin)


def plugin() -> mt.PluginClass:
    """The class of the plugin in the active variant."""

    class GuidedPath(mi.SamplingIntegrator):  # type: ignore[misc]  # a class of the variant
        """Properties, by default: `max_depth` -1, `rr_depth` 5, `hide_emitters` false, `emitter_sampling` true."""

        def __init__(self, props: mt.Properties) -> None:
            mi.SamplingIntegrator.__init__(self, props)
            self.path = _path(props)  # refuses what is out of range
            settings = _settings(props)
            if self.hide_emitters and not settings.emitter_sampling:
                raise ValueError(f"{NAME}: hide_emitters without emitter_sampling, expected one of them; change it.")
            checkpoint = str(props.get("checkpoint", ""))
            none = checkpoint == NO_PRIOR or not settings.emitter_sampling
            self.prior = None if none else read_prior(Path(checkpoint) if checkpoint else shipped())
            self.spent: dict[str, float] = {}  # seconds of CPU of the last picture's parts
            self.tracer = PathTracer(settings)

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
            pixels = int(dr.prod(film.crop_size()))
            why = _useless(self.tracer.settings, scene, spp * pixels, hides_emitters=self.hide_emitters)
            if why:
                _warn(why)
                return self.path.render(scene, sensor, seed, spp, develop, evaluate)
            with dr.suspend_grad():
                picture = GuidedPicture(self, self.tracer, scene, sensor, seed, self.prior)
                for part in parts_of(spp, pixels):
                    picture.add(part)
                self.spent = picture.spent
                film.put_block(picture.block)
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
            settings = self.tracer.settings
            return f"GuidedPath[max_depth = {settings.max_depth}, rr_depth = {settings.rr_depth}]"

    return GuidedPath


def _path(props: mt.Properties) -> mt.Integrator:
    """Mitsuba's `path` of the same properties."""
    names = ("max_depth", "rr_depth", "hide_emitters")
    return mi.load_dict({"type": "path", **{name: props[name] for name in names if name in props}})


def _settings(props: mt.Properties) -> Settings:
    depth = int(props.get("max_depth", DEPTH))
    emitter_sampling = bool(props.get("emitter_sampling", True))
    return Settings(depth if depth >= 0 else 2**32 - 1, int(props.get("rr_depth", RR_DEPTH)), emitter_sampling)


def _useless(settings: Settings, scene: mt.Scene, paths: int, *, hides_emitters: bool) -> str:
    """Why a guide cannot help, if so."""
    if settings.emitter_sampling and settings.max_depth <= 2:
        return f"max_depth {settings.max_depth} leaves direct light alone, expected 3 or more"
    if not scene.bbox().valid():
        return "no surfaces to learn of"
    if hides_emitters:
        return "hide_emitters, which is not guided"
    few = settings.emitter_sampling and paths < FEWEST
    return f"{paths:,} paths (samples a pixel times pixels), expected {FEWEST:,} or more" if few else ""


def _warn(why: str) -> None:
    """Warn, once a reason, that `path` renders."""
    if why not in _WARNED:
        _WARNED.add(why)
        warnings.warn(f"{NAME}: {why}; rendered by path.", stacklevel=2)


_WARNED: set[str] = set()
