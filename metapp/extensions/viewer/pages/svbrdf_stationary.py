"""The page of a stationary svBRDF: its maps under the photograph's flash and under other lights."""

from __future__ import annotations

from metapp.appearance.flash import GAMMA
from metapp.apps.svbrdf_stationary.app import FALLOFF, SvbrdfStationary
from metapp.extensions.viewer.surface import Lit, surface_view
from metapp.extensions.viewer.view import View
from metapp.learning.task import Params, Task


def view(app: SvbrdfStationary, theta: Params, task: Task) -> View:
    """The maps as `pictures` has them, and the photograph where it is at hand."""
    photographed = []
    if "image" in task.data:
        photo = app.exemplar(task.data["image"][None].float() / 255)
        light, part = app.light_of(photo)[0], app.width / app.picture_size[1]
        photographed = [Lit(light, light, photo=photo[0] ** GAMMA, part=part)]
    return surface_view(app.surface(theta, task), photographed, falloff=FALLOFF)
