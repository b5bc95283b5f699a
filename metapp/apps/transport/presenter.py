"""Presentation of fitted densities of light paths: pictures that fits guide, the densities themselves, and remarks.

Scenes are rendered by `scene_renderer` and densities drawn by `density_pictures`; here it is chosen what is shown.
"""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor
from typing_extensions import override

from metapp.appearance.pictures import TimedFit
from metapp.appearance.presenter import Presenter
from metapp.apps.transport import density_pictures, scene_renderer
from metapp.apps.transport.app import Transport
from metapp.apps.transport.path_guide import PathGuide
from metapp.learning.task import Params, Task

NEXT_EVENT_NOTE = (
    "paths have next-event estimation from the second surface on, since few or none meet a light without it"
)


class TransportPresenter(Presenter[Transport]):
    """The presenter of the fitted density of a scene's light paths: pictures, their measures, and remarks."""

    @property
    @override
    def picture_measure(self) -> str:
        notes = "".join(f"{plugin.integrator}; " for plugin in scene_renderer.extension_integrators().values())
        return (
            f"pictures of {self.app.picture} px of {self.app.spp} paths a pixel; fits guide three of four paths, "
            f"without next-event estimation (NEE); {notes}equal time is as long as regular takes, in seconds of CPU, "
            "and counts the samples that a fit sees, the fit, its table and the picture"
        )

    @override
    def preview(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Draw the film, and the directions at sixteen parts of it, of the samples and of the fit.

        On the film there are the scene's picture and a picture that the fit guides; if there is no scene, the
        densities.
        """
        reference = scene_renderer.renderer_of(task).noisy_reference if "scene" in task.data else None
        return {
            "reference": density_pictures.draw_sample_histograms(task.data["samples"], reference),
            "fit": PathGuide(self.app, theta, task).preview(),
        }

    @override
    def picture_errors(self, fits: Mapping[str, TimedFit], task: Task) -> dict[str, dict[str, float]]:
        """Measure MAPE, SMAPE and DSSIM of pictures that fits guide, at equal paths and in equal time.

        Pictures without a guide are measured, too: see :func:`metapp.apps.transport.scene_renderer.picture_errors`.
        """
        if "scene" not in task.data:
            return {}
        app = self.app
        renderer = scene_renderer.renderer_of(task, app.picture, spp=app.spp, reference_spp=app.reference_spp)
        return scene_renderer.picture_errors(renderer, app.decoder.network, fits, task)

    @override
    def remarks(self, theta: Params, task: Task) -> dict[str, object]:
        """State that paths have next-event estimation, if the task's samples have."""
        return {"note": NEXT_EVENT_NOTE} if "next_event" in task.data else {}
