"""What people look at of fitted densities of light paths: pictures that fits guide, and the densities themselves."""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor
from typing_extensions import override

from metapp.appearance.pictures import Picture, TimedFit, VisibleData
from metapp.appearance.presenter import Presenter
from metapp.apps.transport import density_pictures, guided_pictures
from metapp.apps.transport.app import Transport
from metapp.learning.task import Params, Task

NEXT_EVENT_NOTE = (
    "paths have next-event estimation from the second surface on, since few or none meet a light without it"
)


class TransportPresenter(Presenter[Transport]):
    """What people look at of the density of a scene's light paths."""

    @property
    @override
    def picture_measure(self) -> str:
        notes = "".join(f"{plugin.help}; " for plugin in guided_pictures.extension_integrators().values())
        return (
            f"pictures of {self.app.picture} px of {self.app.spp} paths a pixel; fits guide three of four paths, "
            f"without next-event estimation (NEE); {notes}equal time is that of regular, in seconds of CPU, and counts "
            "the samples that a fit sees, the fit, its table and the picture"
        )

    def preview(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Draw the film, and the directions at sixteen parts of it, of the samples and of the fit.

        On the film there are the scene's picture and one that the fit guides; if there is no scene, the densities.
        """
        network, reference, guided = self.app.network, None, None
        if "scene" in task.data:
            studio = guided_pictures.renderer_of(task)
            reference, guided = studio.glance, studio.guided(network, theta, self.app.overview_spp).picture
        return {
            "reference": density_pictures.draw_sample_histograms(task.data["samples"], reference),
            "fit": density_pictures.draw_flow_density(network, theta, guided),
        }

    def pictures(self, theta: Params, task: Task) -> dict[str, Picture]:
        """Return the scene guided by the fit and without a guide; {} if there is no scene."""
        if "scene" not in task.data:
            return {}
        studio, spp = guided_pictures.renderer_of(task), self.app.shown_spp
        shots = {"guided": studio.guided(self.app.network, theta, spp), "regular": studio.regular(spp)}
        return {name: Picture(shot.picture.permute(1, 2, 0), "radiance") for name, shot in shots.items()}

    def picture_errors(self, fits: Mapping[str, TimedFit], task: Task) -> dict[str, dict[str, float]]:
        """Measure MAPE, SMAPE and DSSIM of pictures that fits guide, at equal paths and in equal time.

        Pictures without a guide are measured, too: see :func:`metapp.apps.transport.guided_pictures.picture_errors`.
        """
        if "scene" not in task.data:
            return {}
        app = self.app
        studio = guided_pictures.renderer_of(task, app.picture, spp=app.spp, reference_spp=app.reference_spp)
        return guided_pictures.picture_errors(studio, app.network, fits, task)

    def remarks(self, theta: Params, task: Task) -> dict[str, object]:
        """State that paths have next-event estimation, where the task's samples have."""
        return {"note": NEXT_EVENT_NOTE} if "next_event" in task.data else {}

    @override
    def visible(self, task: Task) -> VisibleData:
        samples = task.data["samples"]
        return VisibleData(len(samples), samples[0].nbytes, 0)  # General's encoder reads the picture alone
