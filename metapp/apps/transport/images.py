"""Fits judged by the pictures that they guide: at equal paths a pixel, and in equal time with everything counted."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor

from metapp.apps.transport.flow import Flow
from metapp.apps.transport.guide import table_of
from metapp.metrics import dssim, mape, smape
from metapp.task import Params, Task

SIZE, SPP = 64, 1024  # px of a side, and paths a pixel as in Fischer & Ritschel 2022, table 2
REFERENCE_SPP = 4096
REGULAR = "regular"
LONGEST = 64  # times as many paths as the guided picture's, at most, where Regular takes as long as fit and picture


class Fit(NamedTuple):
    """A fitted scene and the seconds of inference that it took."""

    theta: Params
    seconds: float


class Shot(NamedTuple):
    """A picture [3, size, size], linear, and the seconds that it took, with all that had to be made for it."""

    picture: Tensor
    seconds: float


class Studio:
    """One scene, to take pictures of.

    Args:
        task: holds the `scene`.
        size: side of the pictures, px.

    Raises:
        ValueError: the task has no scene, or it cannot be traced here.
    """

    def __init__(self, task: Task, size: int = SIZE) -> None:
        if "scene" not in task.data:
            raise ValueError(f"{task.name}: no scene, expected one to take pictures of; make the data anew.")
        self.render = importlib.import_module("data_tools.path_render")
        space, cornell = (importlib.import_module(f"data_tools.{name}") for name in ("path_space", "cornell"))
        self.tracer = space.Tracer(cornell.scene_of(task.data["scene"]))
        self.size = size

    def reference(self, spp: int = REFERENCE_SPP) -> Tensor:
        """The picture itself, with little noise."""
        return self.render.reference(self.tracer, self.size, spp)

    def regular(self, spp: int, seed: int = 0) -> Shot:
        """A picture by the sampling of materials alone."""
        return _timed(lambda: self.render.render(self.tracer, spp, self.size, seed))

    def guided(self, flow: Flow, theta: Params, spp: int, seed: int = 0) -> Shot:
        """A picture guided by a fit; the time includes that of making its table."""

        def shoot() -> Tensor:
            table = table_of(flow, theta)
            guide = self.render.Guide(table.sample, table.density)
            return self.render.render(self.tracer, spp, self.size, seed, guide)

        return _timed(shoot)


def _timed(shoot: Callable[[], Tensor]) -> Shot:
    begin = time.perf_counter()
    picture = shoot()
    return Shot(picture, time.perf_counter() - begin)


def image_rows(
    flow: Flow,
    fits: Mapping[str, Mapping[str, Fit]],
    tasks: Sequence[Task],
    *,
    spp: int = SPP,
    size: int = SIZE,
    reference_spp: int = REFERENCE_SPP,
    report: Callable[[str], None] | None = None,
) -> list[dict[str, Any]]:
    """The table of pictures: Regular, then each paradigm.

    Args:
        flow: the network of the fits.
        fits: by paradigm and task.
        tasks: with their scenes.
        spp: paths a pixel.
        size: side of the pictures, px.
        reference_spp: paths a pixel of what they are compared with.
        report: told the name of each scene that is done.

    Returns:
        Rows of means over scenes: `mape`, `smape` and `dssim` at equal paths; `path_seconds`, of one path over one of
        Regular's; `total_seconds`, of fit and picture; `time_mape`, Regular's in as much time, and `wins`, on how many
        scenes the guided picture's is below; and `scenes`, what there is of each.
    """
    scenes: dict[str, list[dict[str, Any]]] = {name: [] for name in (REGULAR, *fits)}
    for task in tasks:
        studio = Studio(task, size)
        wanted = studio.reference(reference_spp)
        for shoot in (studio.regular, lambda n: studio.guided(flow, fits[next(iter(fits))][task.name].theta, n)):
            if fits:
                shoot(4)  # first calls compile
        plain = studio.regular(spp)
        scenes[REGULAR].append({"name": task.name, **_errors(plain, wanted), "path_seconds": 1.0})
        for name, of in fits.items():
            fit = of[task.name]
            shot = studio.guided(flow, fit.theta, spp)
            total = fit.seconds + shot.seconds
            as_long = min(max(round(spp * total / plain.seconds), 1), LONGEST * spp)
            rival = _errors(studio.regular(as_long, seed=1), wanted)["mape"]
            scenes[name].append(
                {
                    "name": task.name,
                    **_errors(shot, wanted),
                    "path_seconds": shot.seconds / plain.seconds,
                    "total_seconds": total,
                    "time_mape": rival,
                }
            )
        if report:
            report(task.name)
    return [_row(name, each) for name, each in scenes.items()]


def _errors(shot: Shot, wanted: Tensor) -> dict[str, float]:
    pair = shot.picture[None], wanted[None]
    return {name: float(measure(*pair)) for name, measure in (("mape", mape), ("smape", smape), ("dssim", dssim))}


def _row(name: str, scenes: list[dict[str, Any]]) -> dict[str, Any]:
    def mean(key: str) -> float | None:
        return sum(each[key] for each in scenes) / len(scenes) if scenes and key in scenes[0] else None

    measures = ("mape", "smape", "dssim", "path_seconds", "total_seconds", "time_mape")
    wins = None if name == REGULAR else sum(each["mape"] < each["time_mape"] for each in scenes)
    return {"paradigm": name, **{key: mean(key) for key in measures}, "wins": wins, "scenes": scenes}
