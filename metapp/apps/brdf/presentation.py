"""BRDFs on screens: spheres in the light of a lamp and of an environment."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Mapping

import torch
from torch import Tensor

from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.metrics import ssim
from metapp.appearance.presentation import Compared, Fitted, Presentation, Visible
from metapp.appearance.sphere import environment_scene, reference_scene, shade_sphere
from metapp.apps.brdf.app import CONDITION, Brdf
from metapp.apps.brdf.networks import network_of
from metapp.learning.task import Params, Task

SIDE, DOT = 96, 3  # px, of a picture of samples and of a sample
DOTS = 1024  # samples that are drawn, at most


class BrdfPresentation(Presentation[Brdf]):
    """A sphere of each material; fits are kept as parameters alone."""

    title = "BRDF"
    measure = "mean |log(1 + f cos theta_i) - log(1 + f' cos theta_i)| on held-out directions"
    image_measure = "the sphere under an environment map (a sky, a sun, two windows), sRGB, over the pixels it touches"

    def outputs(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """The sphere, on black with coverage; of a material known by samples alone these and the fit's values there."""
        scene = reference_scene(azimuths=True) if "phi_h" in task.data else reference_scene()
        evaluate = functools.partial(network_of(theta).evaluate, theta)
        fit = shade_sphere(scene, evaluate)
        if "render" in task.data:
            return {"reference": task.data["render"], "fit": fit}
        angles, reflectance = task.data["angles"][-DOTS:], task.data["reflectance"][-DOTS:]  # those held out
        four = torch.cat([angles, task.data["phi_h"][-DOTS:, None]], 1) if "phi_h" in task.data else angles
        return {"samples": dots(angles, reflectance), "predicted": dots(angles, evaluate(four)), "fit": fit}

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


def dots(angles: Tensor, reflectance: Tensor) -> Tensor:
    """Draw samples in the half-vector plane: theta_h from left to right, by its root, theta_d from the bottom up.

    Args:
        angles: theta_h, theta_d, phi_d [N, 3] in rad.
        reflectance: linear RGB [N, 3] in 1/sr.

    Returns:
        [SIDE, SIDE, 4], pi f as linear RGB on black, and coverage.
    """
    picture = reflectance.new_zeros(SIDE, SIDE, 4)
    shares = angles[:, :2] / (math.pi / 2)
    x, y = ((SIDE - DOT) * torch.stack([shares[:, 0].sqrt(), 1 - shares[:, 1]])).round().long().clamp(0, SIDE - DOT)
    colour = torch.cat([math.pi * reflectance, torch.ones_like(reflectance[:, :1])], 1)
    for row, column in itertools.product(range(DOT), repeat=2):
        picture[y + row, x + column] = colour
    return picture


def _display(linear: Tensor) -> Tensor:
    """Linear RGB on black with coverage, [H, W, 4], as sRGB [1, 3, H, W] on white."""
    coverage = linear[..., 3:]
    display = coverage * linear_to_srgb((linear[..., :3] / coverage.clamp_min(1e-6)).clamp(0, 1)) + 1 - coverage
    return display.permute(2, 0, 1)[None]
