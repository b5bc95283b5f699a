"""Fits judged by the pictures that they guide: at equal paths a pixel, and in equal time with everything counted."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

import torch
from torch import Generator, Tensor

from metapp.appearance.metrics import dssim, mape, smape, tone_map_pair
from metapp.appearance.picture_measures import registered_picture_errors
from metapp.appearance.pictures import REFERENCE_ERROR_NAME, PictureComparison, TimedFit
from metapp.apps.transport.app import PICTURE_SPP, REFERENCE_SPP
from metapp.apps.transport.flow import Flow
from metapp.apps.transport.guide import make_guide_table
from metapp.learning.task import Params, Task
from metapp.registry import Entry, registry
from metapp.rendering.paths import path_space
from metapp.rendering.paths.resampling import draw_path_samples
from metapp.rendering.scenes.stored_text import decode_scene

SHOWN_PX = 64  # px of a side, of the pictures that a run leaves
REGULAR, EQUAL_TIME = "regular", "MAPE, equal time"
FIXED_TIME = "fixed time"
REGULAR_NEE = "regular + NEE"  # Mitsuba's path
MAX_WAVE_PATHS = 2**22  # paths of Mitsuba's path at a time


class TimedPicture(NamedTuple):
    """A picture [3, size, size], linear RGB, and the seconds of CPU that it and all that had to be made for it took."""

    picture: Tensor
    seconds: float


class SceneRenderer:
    """One scene, to take pictures of.

    Args:
        scene: its JSON text, UTF-8.
        size: side of the pictures, px.
        next_event: whether paths, guided or not, have next-event estimation from the second surface on.
        spp: paths a pixel of the pictures that are compared with it.
        reference_spp: paths a pixel of the reference, in two halves, which tell its own error.
        wave_paths: paths of Mitsuba's path at a time, as memory asks for.

    Raises:
        ValueError: it cannot be traced here.
    """

    def __init__(
        self,
        scene: bytes,
        size: int,
        next_event: bool = False,
        *,
        spp: int = PICTURE_SPP,
        reference_spp: int = REFERENCE_SPP,
        wave_paths: int = MAX_WAVE_PATHS,
    ) -> None:
        text = torch.frombuffer(bytearray(scene), dtype=torch.uint8)
        self.tracer = path_space.Tracer(decode_scene(text), next_event=next_event)
        self.size, self.spp, self.reference_spp, self.wave_paths = size, spp, reference_spp, wave_paths

    def regular(self, spp: int, seed: int = 0) -> TimedPicture:
        """A picture by the sampling of materials alone."""
        return _timed(lambda: path_space.render_paths(self.tracer, spp, self.size, seed))

    def guided(self, flow: Flow, theta: Params, spp: int, seed: int = 0) -> TimedPicture:
        """A picture guided by a fit, no task axis in theta; the time includes that of making its table."""

        def shoot() -> Tensor:
            table = make_guide_table(flow, theta)
            guide = path_space.Guide(table.sample, table.density)
            return path_space.render_paths(self.tracer, spp, self.size, seed, guide)

        return _timed(shoot)

    def path(self, spp: int, seed: int = 0) -> TimedPicture:
        """A picture by Mitsuba's path, with next-event estimation, in as many waves as memory asks for."""
        most = max(1, self.wave_paths // self.size**2)
        counts = [min(most, spp - first) for first in range(0, spp, most)]
        shots = [self._by("path", count, seed * 2**16 + i) for i, count in enumerate(counts)]
        total = sum(count * shot.picture for count, shot in zip(counts, shots, strict=True))
        return TimedPicture(torch.as_tensor(total) / spp, sum(shot.seconds for shot in shots))

    def by(self, name: str, spp: int, seed: int = 0) -> TimedPicture:
        """The same by an integrator of an extension."""
        registry().plugins[name].load()()
        return self._by(name, spp, seed)

    def _by(self, integrator: str, spp: int, seed: int) -> TimedPicture:
        from metapp.rendering.pictures import render_scene, square_sensor  # imports Mitsuba

        mi, tracer = self.tracer.mi, self.tracer
        sensor = square_sensor(tracer.scene, self.size)
        made = mi.load_dict({"type": integrator, "max_depth": tracer.depth})
        return _timed(lambda: render_scene(tracer.scene, made, spp, seed, sensor).permute(2, 0, 1))

    def sampling(self, samples: Tensor) -> float:
        """Seconds that as many samples [N, 4] of the scene take, and with them the picture that General reads."""
        draw_path_samples(self.tracer, 1, Generator())  # the first call compiles
        begin = time.process_time()
        draw_path_samples(self.tracer, len(samples), Generator())
        return time.process_time() - begin

    @functools.cached_property
    def halves(self) -> Tensor:
        """The picture itself twice, of half the paths each, with other random numbers: [2, 3, size, size]."""
        spp = max(1, self.reference_spp // 2)
        return torch.stack([path_space.render_reference(self.tracer, self.size, spp, seed) for seed in (1, 2)])

    @functools.cached_property
    def reference(self) -> Tensor:
        """The picture itself, with little noise."""
        return self.halves.mean(0)

    @property
    def reference_error(self) -> float:
        """MAPE of the reference, about: a half is as far from the mean of both as that mean is from the truth."""
        return float(mape(self.halves[:1], self.reference[None]))

    @functools.cached_property
    def glance(self) -> Tensor:
        """The same with some noise, in an instant."""
        return path_space.render_reference(self.tracer, self.size, 64)

    @functools.cached_property
    def baseline(self) -> TimedPicture:
        """The one by the sampling of materials that others are compared with."""
        self.regular(1)  # the first call compiles
        return self.regular(self.spp)

    def errors(self, picture: Tensor) -> dict[str, float]:
        """Measures of a picture against the reference."""
        pair = picture[None], self.reference[None]
        errors = {name: float(measure(*pair)) for name, measure in (("MAPE", mape), ("SMAPE", smape), ("DSSIM", dssim))}
        return errors | registered_picture_errors("transport", PictureComparison(*tone_map_pair(*pair)))


def _timed(shoot: Callable[[], Tensor]) -> TimedPicture:
    begin = time.process_time()
    picture = shoot()
    return TimedPicture(picture, time.process_time() - begin)


def renderer_of(
    task: Task, size: int = SHOWN_PX, *, spp: int = PICTURE_SPP, reference_spp: int = REFERENCE_SPP
) -> SceneRenderer:
    """Return the studio of a task's scene, for pictures of a size.

    Raises:
        ValueError: the scene cannot be traced here.
    """
    scene = task.data["scene"].cpu().numpy().tobytes()
    return _studio(scene, size, "next_event" in task.data, spp=spp, reference_spp=reference_spp)


@functools.lru_cache(maxsize=16)  # a reference takes seconds, of 256 px minutes
def _studio(scene: bytes, size: int, next_event: bool, **numbers_of_paths: int) -> SceneRenderer:
    return SceneRenderer(scene, size, next_event, **numbers_of_paths)


def extension_integrators() -> dict[str, Entry[Callable[[], None]]]:
    """Integrators of extensions by name, by whose pictures those that fits guide are judged."""
    return {name: plugin for name, plugin in registry().plugins.items() if plugin.help}


def row_title(integrator: str) -> str:
    """The title of an integrator's row in tables; all have next-event estimation."""
    return f"{integrator.removeprefix('metapp_')} + NEE"


def picture_errors(
    studio: SceneRenderer, flow: Flow, fits: Mapping[str, TimedFit], task: Task
) -> dict[str, dict[str, float]]:
    """Measure the pictures that fits guide, and those of REGULAR, REGULAR_NEE and `extension_integrators`, which have no fit.

    Args:
        studio: of the task's scene.
        flow: the network.
        fits: by name.
        task: holds the `samples` that fits see.

    Returns:
        By name: `MAPE`, `SMAPE` and `DSSIM` at the studio's `spp`; `time`, of the picture over Regular's, the table
        counted; `fixed time`, of the preparation, whatever the paths: the samples that fits see, the fit and its
        table, over Regular's picture; and `MAPE, equal time`, of as many paths as there is time for where all of that
        and the picture may take as long as Regular's `spp`, left out if there is none. REFERENCE has its own `MAPE`.
    """
    regular = studio.errors(studio.baseline.picture)
    errors = {
        REFERENCE_ERROR_NAME: {"MAPE": studio.reference_error},
        REGULAR: {**regular, "time": 1.0, FIXED_TIME: 0.0, EQUAL_TIME: regular["MAPE"]},
    }
    without_fit = {REGULAR_NEE: studio.path}
    without_fit |= {row_title(name): functools.partial(studio.by, name) for name in extension_integrators()}
    for name, shoot in without_fit.items():
        shoot(min(studio.spp, 64), 0)  # the first call compiles
        errors[name] = _errors(studio, shoot)
    sampling = studio.sampling(task.data["samples"]) if fits else 0.0
    for i, (name, fit) in enumerate(fits.items()):
        if not i:
            studio.guided(flow, fit.theta, 4)  # the first call compiles
        table = studio.guided(flow, fit.theta, 1).seconds
        shoot = functools.partial(studio.guided, flow, fit.theta)
        errors[name] = _errors(studio, shoot, fixed=sampling + fit.seconds + table, table=table, seed=1)
    return errors


def _errors(
    studio: SceneRenderer,
    shoot: Callable[[int, int], TimedPicture],
    *,
    fixed: float = 0.0,
    table: float = 0.0,
    seed: int = 0,
) -> dict[str, float]:
    """Measure a picture for `picture_errors`; `shoot` takes paths a pixel and a seed, `seed` that of equal time."""
    plain, shot = studio.baseline.seconds, shoot(studio.spp, 0)
    errors = {**studio.errors(shot.picture), "time": shot.seconds / plain, FIXED_TIME: fixed / plain}
    in_time = int(studio.spp * (plain - fixed) / max(shot.seconds - table, 1e-9))
    if in_time >= 1:
        errors[EQUAL_TIME] = float(mape(shoot(in_time, seed).picture[None], studio.reference[None]))
    return errors
