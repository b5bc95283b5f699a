"""BRDFs on screens: spheres in the light of a lamp and of an environment."""

from __future__ import annotations

import functools
from collections.abc import Mapping

from torch import Tensor

from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.metrics import ssim
from metapp.appearance.presentation import Compared, Fitted, Presentation, Visible
from metapp.appearance.sphere import environment_scene, reference_scene, shade_sphere
from metapp.apps.brdf.app import CONDITION, Brdf
from metapp.apps.brdf.networks import network_of
from metapp.learning.task import Params, Task


class BrdfPresentation(Presentation[Brdf]):
    """A sphere of each material; fits are kept as parameters alone."""

    title = "BRDF"
    measure = "mean |log(1 + f cos theta_i) - log(1 + f' cos theta_i)| on held-out directions"
    image_measure = "the sphere under an environment map (a sky, a sun, two windows), sRGB, over the pixels it touches"

    def outputs(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """The sphere, on black with coverage."""
        scene = reference_scene(azimuths=True) if "phi_h" in task.data else reference_scene()
        fit = shade_sphere(scene, functools.partial(network_of(theta).evaluate, theta))
        return {"reference": task.data["render"], "fit": fit}

    def compared(self, theta: Params, task: Task) -> Compared | None:
        """The sphere under the environment map; None where a data set was made before it had such pictures."""
        if "environment" not in task.data:
            return None
        scene = environment_scene(azimuths="phi_h" in task.data)
        fit = shade_sphere(scene, functools.partial(network_of(theta).evaluate, theta))
        return Compared(_display(fit), _display(task.data["environment"]), scene.mask)

    def image_errors(self, fits: Mapping[str, Fitted], task: Task) -> dict[str, dict[str, float]]:
        """SSIM, mean over the pixels that the sphere touches, and what extensions measure of these."""
        measured = {}
        for name, fit in fits.items():
            if compared := self.compared(fit.theta, task):
                similarity = ssim(compared.pictures, compared.references)[..., compared.mask].mean()
                measured[name] = {"SSIM": float(similarity)} | compared.measures(self.app.name)
        return measured

    def visible(self, task: Task) -> Visible:
        """The first half of the samples, three angles and a colour each."""
        angles, reflectance = task.data["angles"], task.data["reflectance"]
        return Visible(len(angles) // 2, angles[0].nbytes + reflectance[0].nbytes, CONDITION)


def _display(linear: Tensor) -> Tensor:
    """Linear RGB on black with coverage, [H, W, 4], as sRGB [1, 3, H, W] on white."""
    coverage = linear[..., 3:]
    display = coverage * linear_to_srgb((linear[..., :3] / coverage.clamp_min(1e-6)).clamp(0, 1)) + 1 - coverage
    return display.permute(2, 0, 1)[None]
