"""The page of a scene: a picture that the fit guides, regular paths, the reference; densities without a scene."""

from __future__ import annotations

import torch
from torch import Tensor

from metapp.appearance.metrics import mape
from metapp.appearance.presentation import REFERENCE
from metapp.apps.transport.flow import Flow
from metapp.apps.transport.images import REGULAR, Studio, studio_of
from metapp.apps.transport.presentation import TransportPresentation, picture_of_flow, picture_of_samples
from metapp.extensions.viewer.view import View, pictures_view
from metapp.learning.task import Params, Task

LARGEST = 128  # px of a side
SPP = 32  # paths a pixel
REFERENCE_SECONDS, FIRST = 4.0, 16  # of CPU for each half of the reference; samples a pixel that tell its speed
GUIDED = "guided by the fit"
HALF = 65504.0  # the greatest of float16


def view(presentation: TransportPresentation, theta: Params, task: Task, *, quick: bool) -> View:
    """Pictures of the scene at equal paths; densities where there is no scene, and while a fit runs."""
    app = presentation.app
    if "scene" in task.data and not quick:
        return scene_view(app.flow, theta, task, app.setup.picture)
    return pictures_view(
        {"reference": picture_of_samples(task.data["samples"]), "fit": picture_of_flow(app.flow, theta)}
    )


def scene_view(flow: Flow, theta: Params, task: Task, size: int) -> View:
    """The scene of a task.

    Args:
        flow: the network.
        theta: the fit, no task axis.
        task: holds the `scene`.
        size: side of the pictures that fits are judged by, px.
    """
    studio = studio_of(task, min(size, LARGEST))
    studio.regular(1)
    studio.guided(flow, theta, 1)  # the first calls compile
    shots = {REGULAR: studio.regular(SPP), GUIDED: studio.guided(flow, theta, SPP)}
    halves = _reference_halves(studio)
    reference = halves.mean(0)
    unit = reference.mean().clamp_min(1e-20)  # halves hold radiance of any unit then
    arrays = {REFERENCE: _half(reference / unit)}
    pictures: list[dict[str, str]] = [{"title": REFERENCE, "name": REFERENCE}]
    for name, shot in shots.items():
        arrays[name] = _half(shot.picture / unit)
        error = float(mape(shot.picture[None], reference[None]))
        told = f"{SPP} spp, MAPE {error:.3g}, {shot.seconds:.2f} s"
        pictures.append({"title": name, "name": name, "told": told})
    where = "from the second surface on" if studio.tracer.next_event else "at no surface"
    own_error = float(mape(halves[:1], reference[None]))  # a half is as far from the mean as that is from the truth
    notes = [
        f"{GUIDED}: the fit guides three of four paths, with next-event estimation {where}. {REGULAR}: as many paths, "
        "by the sampling of materials: equal paths, not equal time, for which there is metapp evaluate --which image.",
        f"The reference, by Mitsuba's path, has a MAPE of about {own_error:.2g}. All show the central square of the "
        "scene, rendered when this page was made. spp: samples a pixel; s: seconds of CPU. Radiance is in units of the "
        "reference's mean.",
    ]
    facts = {"pictures": pictures, "compared": [REGULAR, GUIDED], "reference": REFERENCE, "notes": notes}
    return View("pictures", arrays, {}, facts)


def _reference_halves(studio: Studio) -> Tensor:
    """Two pictures by Mitsuba's path, of other random numbers, [2, 3, size, size]."""
    studio.path(FIRST)  # the first call compiles
    rate = studio.path(FIRST).seconds / FIRST
    spp = max(1, round(REFERENCE_SECONDS / max(rate, 1e-9)))
    return torch.stack([studio.path(spp, seed).picture for seed in (1, 2)])


def _half(picture: Tensor) -> Tensor:
    return picture.permute(1, 2, 0).clamp(0, HALF).half()
