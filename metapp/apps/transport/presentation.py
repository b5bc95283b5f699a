"""Transport on screens and in files: densities, and pictures of scenes that they guide."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from metapp.appearance.presentation import Fitted, Picture, Presentation, Rendered, Visible
from metapp.apps.transport import Transport
from metapp.apps.transport.images import image_errors, rendered, studio_of
from metapp.apps.transport.views import picture_of_flow, picture_of_samples
from metapp.learning.task import Params, Task

SHOWN, GLANCE = 512, 256  # paths a pixel of the pictures that a run leaves, and of those in its overview
IMAGE_MEASURE = (
    "pictures of {size} px of 1024 paths a pixel; fits guide three of four paths, without next-event estimation (NEE); "
    "guided_path guides all bounces and learns while it renders; equal time is that of regular, in seconds of CPU, "
    "and counts the samples that a fit sees, the fit, its table and the picture"
)
SECONDS = 0.012  # of CPU for each pixel of `image_errors`, about


class TransportPresentation(Presentation[Transport]):
    """Densities of light paths, and the scene guided by them where there is one."""

    title = "Transport"
    measure = "negative log-likelihood of held-out light paths, on the film and in their first direction"
    logarithmic = True
    renders = True

    def __init__(self, app: Transport, size: tuple[int, int] | None = None) -> None:
        super().__init__(app, size)
        side = app.setup.picture
        self.image_measure = IMAGE_MEASURE.format(size=side)
        self.image_seconds = SECONDS * side**2

    def outputs(self, theta: Params, task: Task) -> dict[str, Any]:
        """What there is on the film, and the directions at sixteen parts of it, of the samples and of the fit.

        On the film there are the scene's picture and one of GLANCE paths a pixel that the fit guides; where there is no
        scene, the densities.
        """
        seen = found = None
        if "scene" in task.data:
            studio = studio_of(task)
            seen, found = studio.glance, studio.guided(self.app.flow, theta, GLANCE).picture
        return {
            "reference": picture_of_samples(task.data["samples"], seen),
            "fit": picture_of_flow(self.app.flow, theta, found),
        }

    def files(self, theta: Params, task: Task) -> dict[str, Picture]:
        """The scene guided by the fit, and without a guide, at SHOWN paths a pixel; nothing where there is no scene."""
        if "scene" not in task.data:
            return {}
        studio = studio_of(task)
        shots = {"guided": studio.guided(self.app.flow, theta, SHOWN), "regular": studio.regular(SHOWN)}
        return {name: Picture(shot.picture.permute(1, 2, 0), "radiance") for name, shot in shots.items()}

    def rendered(self, task: Task, side: int) -> Rendered | None:
        return rendered(task, side) if "scene" in task.data else None

    def image_errors(self, fits: Mapping[str, Fitted], task: Task) -> dict[str, dict[str, float]]:
        """MAPE, SMAPE and DSSIM of pictures that fits guide, at equal paths and in equal time, and of Regular's."""
        return image_errors(self.app.flow, fits, task, self.app.setup.picture) if "scene" in task.data else {}

    def visible(self, task: Task) -> Visible:
        """All samples but the held-out ones; General's encoder sees none of them, only the picture."""
        samples = task.data["samples"]
        return Visible(len(samples), samples[0].nbytes, 0)


PRESENTATION = TransportPresentation
