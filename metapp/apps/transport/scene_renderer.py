"""Measures of fits by the pictures that they guide: at equal paths a pixel, and in equal time with everything counted.

A scene is rendered with a fit as guide, without one, by Mitsuba's path, and by integrators of extensions, all against
one reference.
"""

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
from metapp.registry import Plugin, registry
from metapp.rendering.paths import path_space
from metapp.rendering.paths.resampling import draw_path_samples
from metapp.rendering.scenes.stored_text import decode_scene

SHOWN_PX = 64  # side of the pictures that a run leaves
REGULAR = "regular"  # the row of pictures by the sampling of materials alone
REGULAR_NEE = "regular + NEE"  # the row of pictures by Mitsuba's path, with next-event estimation
EQUAL_TIME, FIXED_TIME = "MAPE, equal time", "fixed time"  # columns of tables: see `picture_errors`
MAX_WAVE_PATHS = 2**22  # paths that Mitsuba's path traces at a time


class TimedPicture(NamedTuple):
    """A picture, and the seconds of CPU that it and all that had to be made for it took.

    Attributes:
        picture: linear RGB [3, size, size].
        seconds: seconds of CPU.
    """

    picture: Tensor
    seconds: float


class SceneRenderer:
    """A renderer of one scene, which times its pictures and measures them.

    Args:
        scene: the scene's JSON text, UTF-8.
        size: side of the pictures, px.
        next_event: whether paths, guided or not, have next-event estimation from the second surface on.
        spp: paths a pixel of the pictures that are compared with the reference.
        reference_spp: paths a pixel of the reference, in two halves, which tell its own error.
        wave_paths: paths that Mitsuba's path traces at a time, for which there is memory.

    Attributes:
        tracer: the tracer of the scene's paths.

    Raises:
        ValueError: the scene cannot be traced here.
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

    def render_regular(self, spp: int, seed: int = 0) -> TimedPicture:
        """Render a picture by the sampling of materials alone."""
        return _time_render(lambda: path_space.render_paths(self.tracer, spp, self.size, seed))

    def render_guided(self, flow: Flow, theta: Params, spp: int, seed: int = 0) -> TimedPicture:
        """Render a picture guided by a fit; its time includes the time in which the table is made.

        Args:
            flow: the network.
            theta: its parameters for one task, without a task axis.
            spp: paths a pixel.
            seed: seed of the paths.
        """

        def render() -> Tensor:
            table = make_guide_table(flow, theta)
            guide = path_space.Guide(table.sample, table.density)
            return path_space.render_paths(self.tracer, spp, self.size, seed, guide)

        return _time_render(render)

    def render_path(self, spp: int, seed: int = 0) -> TimedPicture:
        """Render a picture by Mitsuba's path, with next-event estimation, in as many waves as memory asks for."""
        wave_spp = max(1, self.wave_paths // self.size**2)
        counts = [min(wave_spp, spp - first) for first in range(0, spp, wave_spp)]
        waves = [self._render("path", count, seed * 2**16 + i) for i, count in enumerate(counts)]
        weighted_sum = sum(count * wave.picture for count, wave in zip(counts, waves, strict=True))
        return TimedPicture(torch.as_tensor(weighted_sum) / spp, sum(wave.seconds for wave in waves))

    def render_with(self, name: str, spp: int, seed: int = 0) -> TimedPicture:
        """Render a picture by an integrator of an extension."""
        registry().plugins[name].load()()
        return self._render(name, spp, seed)

    def _render(self, integrator: str, spp: int, seed: int) -> TimedPicture:
        """Render a picture by an integrator that Mitsuba knows."""
        from metapp.rendering.pictures import render_scene, square_sensor  # imports Mitsuba

        mi, tracer = self.tracer.mi, self.tracer
        sensor = square_sensor(tracer.scene, self.size)
        loaded_integrator = mi.load_dict({"type": integrator, "max_depth": tracer.depth})
        return _time_render(lambda: render_scene(tracer.scene, loaded_integrator, spp, seed, sensor).permute(2, 0, 1))

    def time_sampling(self, samples: Tensor) -> float:
        """Return the seconds of CPU in which as many samples [N, 4] of the scene are drawn.

        They include the picture that General's encoder reads, which comes with the samples.
        """
        draw_path_samples(self.tracer, 1, Generator())  # the first call compiles
        start_seconds = time.process_time()
        draw_path_samples(self.tracer, len(samples), Generator())
        return time.process_time() - start_seconds

    @functools.cached_property
    def reference_halves(self) -> Tensor:
        """The scene rendered twice, by other random numbers, each with half of the reference's paths, [2, 3, S, S]."""
        spp = max(1, self.reference_spp // 2)
        return torch.stack([path_space.render_reference(self.tracer, self.size, spp, seed) for seed in (1, 2)])

    @functools.cached_property
    def reference(self) -> Tensor:
        """The scene with little noise, [3, size, size]."""
        return self.reference_halves.mean(0)

    @property
    def reference_error(self) -> float:
        """The MAPE of the reference, about: a half is as far from the mean of both as that mean is from the truth."""
        return float(mape(self.reference_halves[:1], self.reference[None]))

    @functools.cached_property
    def noisy_reference(self) -> Tensor:
        """The scene with some noise, [3, size, size], rendered at once."""
        return path_space.render_reference(self.tracer, self.size, 64)

    @functools.cached_property
    def regular_picture(self) -> TimedPicture:
        """The picture by the sampling of materials alone that others are compared with."""
        self.render_regular(1)  # the first call compiles
        return self.render_regular(self.spp)

    def errors(self, picture: Tensor) -> dict[str, float]:
        """Measure a picture [3, size, size] against the reference."""
        pair = picture[None], self.reference[None]
        errors = {name: float(measure(*pair)) for name, measure in (("MAPE", mape), ("SMAPE", smape), ("DSSIM", dssim))}
        return errors | registered_picture_errors("transport", PictureComparison(*tone_map_pair(*pair)))


def _time_render(render: Callable[[], Tensor]) -> TimedPicture:
    """Render a picture and take the time, in seconds of CPU."""
    start_seconds = time.process_time()
    picture = render()
    return TimedPicture(picture, time.process_time() - start_seconds)


def renderer_of(
    task: Task, size: int = SHOWN_PX, *, spp: int = PICTURE_SPP, reference_spp: int = REFERENCE_SPP
) -> SceneRenderer:
    """Return the renderer of a task's scene, for pictures of a size; one that was made before is kept.

    Raises:
        ValueError: the scene cannot be traced here.
    """
    scene = task.data["scene"].cpu().numpy().tobytes()
    return _make_renderer(scene, size, "next_event" in task.data, spp=spp, reference_spp=reference_spp)


@functools.lru_cache(maxsize=16)  # a reference takes seconds, of 256 px minutes
def _make_renderer(scene: bytes, size: int, next_event: bool, **numbers_of_paths: int) -> SceneRenderer:
    """Make a renderer, or return the one that was made of the same arguments."""
    return SceneRenderer(scene, size, next_event, **numbers_of_paths)


def extension_integrators() -> dict[str, Plugin]:
    """Return the integrators of extensions by name, whose pictures are measured beside those that fits guide."""
    return {name: plugin for name, plugin in registry().plugins.items() if plugin.integrator}


def row_title(integrator: str) -> str:
    """Return the title of an integrator's row in tables; all such integrators have next-event estimation."""
    return f"{integrator.removeprefix('metapp_')} + NEE"


def picture_errors(
    renderer: SceneRenderer, flow: Flow, fits: Mapping[str, TimedFit], task: Task
) -> dict[str, dict[str, float]]:
    """Measure the pictures that fits guide, and pictures that are rendered without a fit.

    The pictures without a fit are REGULAR, REGULAR_NEE and one by each of :func:`extension_integrators`. All times are
    divided by the time of REGULAR's picture.

    Args:
        renderer: the renderer of the task's scene.
        flow: the network.
        fits: fits by name.
        task: the task, whose `samples` fits see.

    Returns:
        Measures of each picture, by the name of the fit or integrator; REFERENCE_ERROR_NAME has the `MAPE` of the
        reference itself.

        - `MAPE`, `SMAPE` and `DSSIM`: errors of a picture of the renderer's `spp` paths a pixel
        - `time`: the time of this picture; for a guided picture it includes the making of the fit's table
        - `fixed time`: the time of all preparation, which does not depend on the number of paths: sampling what the fit
          sees, the fit, and its table
        - `MAPE, equal time`: the error of a picture that together with its preparation takes as long as REGULAR's;
          left out if that time is too short for one path a pixel
    """
    regular = renderer.errors(renderer.regular_picture.picture)
    errors = {
        REFERENCE_ERROR_NAME: {"MAPE": renderer.reference_error},
        REGULAR: {**regular, "time": 1.0, FIXED_TIME: 0.0, EQUAL_TIME: regular["MAPE"]},
    }
    without_fit = {REGULAR_NEE: renderer.render_path}
    without_fit |= {row_title(name): functools.partial(renderer.render_with, name) for name in extension_integrators()}
    for name, render in without_fit.items():
        render(min(renderer.spp, 64), 0)  # the first call compiles
        errors[name] = _measure_picture(renderer, render)
    sampling_seconds = renderer.time_sampling(task.data["samples"]) if fits else 0.0
    for i, (name, fit) in enumerate(fits.items()):
        if not i:
            renderer.render_guided(flow, fit.theta, 4)  # the first call compiles
        table_seconds = renderer.render_guided(flow, fit.theta, 1).seconds
        render = functools.partial(renderer.render_guided, flow, fit.theta)
        errors[name] = _measure_picture(
            renderer,
            render,
            fixed_seconds=sampling_seconds + fit.seconds + table_seconds,
            table_seconds=table_seconds,
            seed=1,
        )
    return errors


def _measure_picture(
    renderer: SceneRenderer,
    render: Callable[[int, int], TimedPicture],
    *,
    fixed_seconds: float = 0.0,
    table_seconds: float = 0.0,
    seed: int = 0,
) -> dict[str, float]:
    """Measure a picture as :func:`picture_errors` states it.

    Args:
        renderer: the renderer of the task's scene.
        render: renders a picture of given paths a pixel by a given seed.
        fixed_seconds: seconds that the preparation takes, whatever the paths.
        table_seconds: seconds of the preparation that each picture's time includes.
        seed: seed of the picture in equal time.
    """
    regular_seconds, timed_picture = renderer.regular_picture.seconds, render(renderer.spp, 0)
    errors = {
        **renderer.errors(timed_picture.picture),
        "time": timed_picture.seconds / regular_seconds,
        FIXED_TIME: fixed_seconds / regular_seconds,
    }
    equal_time_spp = int(
        renderer.spp * (regular_seconds - fixed_seconds) / max(timed_picture.seconds - table_seconds, 1e-9)
    )
    if equal_time_spp >= 1:
        errors[EQUAL_TIME] = float(mape(render(equal_time_spp, seed).picture[None], renderer.reference[None]))
    return errors
