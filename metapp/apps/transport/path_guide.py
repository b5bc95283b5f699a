"""The density of light paths that fits of light transport answer with, and pictures that it guides."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor
from typing_extensions import override

from metapp.appearance.assets import Asset
from metapp.appearance.pictures import Picture
from metapp.apps.transport import density_pictures, scene_renderer
from metapp.apps.transport.app import Transport
from metapp.learning.task import Params, Task


@dataclass(frozen=True, eq=False)
class PathGuide(Asset):
    """A density of the light paths of a scene over primary sample space.

    Attributes:
        app: the application, with the network and the sizes of pictures.
        theta: the parameters of the network, without a task axis.
        task: the task, with its scene, if it has one.
    """

    kind = "path guide"
    app: Transport
    theta: Params
    task: Task

    @override
    def pictures(self) -> dict[str, Picture]:
        """Return the scene guided by the density and without a guide; {} if there is no scene."""
        if "scene" not in self.task.data:
            return {}
        renderer, spp = scene_renderer.renderer_of(self.task), self.app.shown_spp
        timed_pictures = {
            "guided": renderer.render_guided(self.app.decoder.network, self.theta, spp),
            "regular": renderer.render_regular(spp),
        }
        return {name: Picture(timed.picture.permute(1, 2, 0), "radiance") for name, timed in timed_pictures.items()}

    @override
    def preview(self) -> Tensor:
        """Return the film, and the directions at sixteen parts of it; with a scene, the film has a guided picture."""
        guided = None
        if "scene" in self.task.data:
            renderer = scene_renderer.renderer_of(self.task)
            guided = renderer.render_guided(self.app.decoder.network, self.theta, self.app.overview_spp).picture
        return density_pictures.draw_flow_density(self.app.decoder.network, self.theta, guided)


def make_path_guide(app: Transport, theta: Params, task: Task, size: tuple[int, int] | None) -> PathGuide:
    """Return the density of a fit; see :class:`metapp.application.MakeAsset`."""
    return PathGuide(app, theta, task)
