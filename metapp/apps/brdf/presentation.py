"""BRDFs on screens: spheres in the light of a lamp and of an environment."""

from __future__ import annotations

import functools
from collections.abc import Mapping

import numpy as np
from torch import Tensor

from metapp.appearance.colorimetry import colour_difference
from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.metrics import ssim
from metapp.appearance.presentation import Fitted, Presentation, Visible
from metapp.appearance.sphere import environment_scene, reference_scene, shade_sphere
from metapp.apps.brdf.app import CONDITION, Brdf
from metapp.apps.brdf.networks import network_of
from metapp.learning.task import Params, Task


class BrdfPresentation(Presentation[Brdf]):
    """A sphere of each material; fits are kept as parameters alone."""

    title = "BRDF"
    measure = "mean |log(1 + f cos theta_i) - log(1 + f' cos theta_i)| on held-out directions"
    image_measure = (
        "the sphere under an environment map (a sky, a sun, two windows), sRGB, over the pixels it touches: SSIM, and "
        "the CIE 2000 colour difference (D65), of which about 1 is just noticeable"
    )

    def outputs(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """The sphere, on black with coverage."""
        scene = reference_scene(azimuths=True) if "phi_h" in task.data else reference_scene()
        fit = shade_sphere(scene, functools.partial(network_of(theta).evaluate, theta))
        return {"reference": task.data["render"], "fit": fit}

    def image_errors(self, fits: Mapping[str, Fitted], task: Task) -> dict[str, dict[str, float]]:
        """SSIM of the sphere under the environment map, mean over the pixels that it touches, and colour differences.

        Empty where a data set was made before it had such pictures.
        """
        if "environment" not in task.data:
            return {}
        scene, measured = environment_scene(azimuths="phi_h" in task.data), {}
        reference = _display(task.data["environment"])
        for name, fit in fits.items():
            picture = _display(shade_sphere(scene, functools.partial(network_of(fit.theta).evaluate, fit.theta)))
            pixels = (each[0][:, scene.mask].T.double().numpy() for each in (picture, reference))
            median, high = np.quantile(colour_difference(*pixels), (0.5, 0.95))
            similarity = float(ssim(picture, reference)[0][:, scene.mask].mean())
            measured[name] = {"SSIM": similarity, "CIE 2000, median": float(median), "CIE 2000, 95 %": float(high)}
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
