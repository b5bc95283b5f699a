"""The page of a scene: pictures in equal time, for several times, and those that fits guide; densities without one."""

from __future__ import annotations

import functools
from typing import NamedTuple

import torch
from torch import Tensor

from metapp.appearance.metrics import mape
from metapp.apps.transport.flow import Flow
from metapp.apps.transport.images import REGULAR, REGULAR_NEE, Shot, Studio, integrators, studio_of
from metapp.apps.transport.presentation import TransportPresentation, picture_of_flow, picture_of_samples
from metapp.door import Plugin
from metapp.extensions.viewer.view import View, pictures_view
from metapp.learning.task import Params, Task
from metapp.storage import Document

LARGEST = 128  # px of a side
GUIDED_SECONDS = 4.0  # of CPU for all pictures of one kind, about
REFERENCE_SECONDS = 4.0  # of CPU for each half of the reference, about
FEWEST, MOST = 8, 5  # samples a pixel of the first picture; pictures of a kind that are shown, the last ones
TRIES, NEAR = 3, 0.1  # of a picture in the time of another, until it is off by less than this share
SPP = 32  # paths a pixel of the pictures that fits guide
GUIDED_BY_FIT, REFERENCE = "guided by the fit", "reference"


class Counted(NamedTuple):
    """A picture, and its samples a pixel."""

    shot: Shot
    spp: int

    def __str__(self) -> str:
        return f"{self.spp} spp, {self.shot.seconds:.2f} s"


class EqualTime(NamedTuple):
    """Pictures of a scene, none of which has anything to do with a fit.

    Attributes:
        guided: by an integrator of an extension, each with twice the samples of the one before.
        regular: by Mitsuba's `path`, each in the time of its guided one.
        halves: of the reference: by `path`, and by that integrator.
    """

    guided: list[Counted]
    regular: list[Counted]
    halves: tuple[Counted, Counted]

    @property
    def reference(self) -> Tensor:
        """The mean of both halves: neither method is nearer to it by its own noise, [3, size, size]."""
        return torch.stack([half.shot.picture for half in self.halves]).mean(0)


def view(presentation: TransportPresentation, theta: Params, task: Task, *, quick: bool) -> View:
    """Pictures of the scene in equal time, and those that the fit guides.

    Densities where there is no scene, while a fit runs, and without the extension of guided paths.
    """
    app = presentation.app
    if "scene" in task.data and not quick and (plugins := integrators()):
        return scene_view(app.flow, theta, task, app.setup.picture, plugins[0])
    return pictures_view(
        {"reference": picture_of_samples(task.data["samples"]), "fit": picture_of_flow(app.flow, theta)}
    )


def scene_view(flow: Flow, theta: Params, task: Task, size: int, plugin: Plugin) -> View:
    """The scene of a task.

    Args:
        flow: the network.
        theta: the fit, no task axis.
        task: holds the `scene`.
        size: side of the pictures that fits are judged by, px.
        plugin: the integrator that is compared with Mitsuba's `path`.
    """
    studio = studio_of(task, min(size, LARGEST))
    made = equal_time(studio, plugin)
    studio.regular(1)
    studio.guided(flow, theta, 1)  # the first calls compile
    by_fit = [Counted(studio.guided(flow, theta, SPP), SPP)]
    kinds = {
        plugin.row: made.guided,
        REGULAR_NEE: made.regular,
        GUIDED_BY_FIT: by_fit,
        REGULAR: [Counted(studio.regular(SPP), SPP)],
    }
    reference = made.reference
    unit = reference.mean().clamp_min(1e-20)  # halves hold radiance of any unit then
    arrays = {REFERENCE: _half(reference / unit)}
    arrays |= {
        f"{kind} {i}": _half(each.shot.picture / unit)
        for kind, several in kinds.items()
        for i, each in enumerate(several)
    }
    shown: list[Document] = [
        {"title": kind, "names": [f"{kind} {i}" for i in range(len(several))], "told": [str(each) for each in several]}
        for kind, several in kinds.items()
    ]
    facts = {
        "pictures": [{"title": REFERENCE, "names": [REFERENCE]}, *shown],
        "steps": {
            "label": "Seconds of CPU",
            "titles": [f"{each.shot.seconds:.2f} s" for each in made.guided],
        },
        "compared": [plugin.row, REGULAR_NEE],
        "reference": REFERENCE,
        "chart": _chart(made, plugin),
        "notes": _notes(made, studio, plugin),
    }
    return View("pictures", arrays, {}, facts)


@functools.lru_cache(maxsize=16)
def equal_time(studio: Studio, plugin: Plugin) -> EqualTime:
    """Pictures in equal time, about 30 seconds of CPU in all; the same for all fits of a scene."""
    for shoot in (functools.partial(studio.by, plugin), studio.path):
        shoot(FEWEST)  # the first call compiles
    rate = studio.path(FEWEST).seconds / FEWEST
    guided, regular, spp = [], [], FEWEST
    while True:
        guided.append(Counted(studio.by(plugin, spp, 1), spp))
        seconds = guided[-1].shot.seconds
        regular.append(_within(studio, seconds, rate, 1))
        rate = regular[-1].shot.seconds / regular[-1].spp
        if sum(each.shot.seconds for each in guided) + 2 * seconds > GUIDED_SECONDS:
            break
        spp *= 2
    last = guided[-1]
    spp = max(1, round(last.spp * REFERENCE_SECONDS / max(last.shot.seconds, 1e-9)))
    halves = _within(studio, REFERENCE_SECONDS, rate, 2, tries=1), Counted(studio.by(plugin, spp, 2), spp)
    return EqualTime(guided[-MOST:], regular[-MOST:], halves)


def _within(studio: Studio, seconds: float, rate: float, seed: int, tries: int = TRIES) -> Counted:
    """A picture by `path` in so many seconds, at a rate of seconds for a sample of each pixel, which others disturb."""
    while True:
        spp = max(1, round(seconds / max(rate, 1e-9)))
        shot, tries = studio.path(spp, seed), tries - 1
        if not tries or abs(shot.seconds - seconds) < NEAR * seconds:
            return Counted(shot, spp)
        rate = shot.seconds / spp


def _half(picture: Tensor) -> Tensor:
    return picture.permute(1, 2, 0).clamp(0, 65504).half()


def _error(picture: Tensor, reference: Tensor) -> float:
    return float(mape(picture[None], reference[None]))


def _chart(made: EqualTime, plugin: Plugin) -> Document:
    """MAPE over seconds, and the reference's own."""
    lines = [
        {
            "title": title,
            "points": [[each.shot.seconds, _error(each.shot.picture, made.reference)] for each in several],
        }
        for title, several in ((plugin.row, made.guided), (REGULAR_NEE, made.regular))
    ]
    error, ends = _own_error(made), [made.guided[0].shot.seconds, made.guided[-1].shot.seconds]
    lines.append({"title": "reference's own", "points": [[seconds, error] for seconds in ends]})
    return {"x": "seconds of CPU", "y": "MAPE", "lines": lines}


def _own_error(made: EqualTime) -> float:
    """Of the reference: a half is as far from the mean of both as that mean is from the truth."""
    return _error(made.halves[0].shot.picture, made.reference)


def _notes(made: EqualTime, studio: Studio, plugin: Plugin) -> list[str]:
    by_path, by_guided = made.halves
    where = "from the second surface on" if studio.tracer.next_event else "at no surface"
    return [
        f"{plugin.row}: {plugin.name}, with next-event estimation, which does not see the fit: {plugin.note}. "
        f"{REGULAR_NEE}: Mitsuba's path, in the same seconds of CPU.",
        f"{GUIDED_BY_FIT}: the fit guides three of four paths, with next-event estimation {where}. {REGULAR}: as many "
        "paths, by the sampling of materials: equal paths, not equal time.",
        f"{REFERENCE}: the mean of {by_path.spp} samples a pixel by path and {by_guided.spp} by {plugin.name}; "
        f"its own MAPE is about {_own_error(made):.2g}.",
        "All show the central square of the scene, rendered when this page was made. spp: samples a pixel; s: seconds "
        "of CPU. Radiance is in units of the reference's mean.",
    ]
