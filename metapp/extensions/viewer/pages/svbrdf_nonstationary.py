"""The page of a non-stationary svBRDF: its maps, in its photographs and under other lights."""

from __future__ import annotations

import torch

from metapp.appearance.flash import unpack
from metapp.apps.svbrdf_nonstationary.app import SvbrdfNonstationary
from metapp.apps.svbrdf_nonstationary.maps import linear
from metapp.extensions.viewer.surface import Lit, surface_view
from metapp.extensions.viewer.view import View
from metapp.learning.task import Params, Task


@torch.no_grad()
def view(app: SvbrdfNonstationary, theta: Params, task: Task) -> View:
    """The maps as `pictures` has them, the photographs, and the true maps where the task has them."""
    flashes = app.flashes(theta, task)
    photos = [task.data["photo"], *task.data.get("others", ())][: len(flashes)]
    taken = app.protocol == "photo"  # else the photo was rendered from the maps
    photographed = [
        Lit(flash.place, flash.eye, float(flash.gain), linear(photo) if taken else None)
        for flash, photo in zip(flashes, photos, strict=True)
    ]
    reference = unpack(task.data["maps"].float()) if "maps" in task.data else None
    return surface_view(app.surface(theta, task), photographed, reference=reference)
