"""Presentation of fitted BRDFs: pictures of spheres and of samples, remarks and warnings.

Spheres are drawn by the network that a fit's parameters belong to, so that fits of all networks are shown alike.
"""

from __future__ import annotations

import functools
import itertools
import math

import torch
from torch import Tensor
from typing_extensions import override

from metapp.appearance.colour import composite_to_srgb
from metapp.appearance.pictures import PictureComparison
from metapp.appearance.presenter import Presenter
from metapp.appearance.sphere import environment_scene, reference_scene, shade_sphere
from metapp.appearance.uniform import collapsed_fit_warnings, uniform_input_remarks
from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.brdf_network import find_network
from metapp.apps.brdf.energy import INCIDENT_RAD, albedo
from metapp.apps.brdf.highlight import MANY_SAMPLES, describe_guessed_highlight, describe_unseen_highlight
from metapp.learning.task import Params, Task, Tasks

DRAWN_SAMPLES = 1024  # samples in a picture, at most
SAMPLES_SIDE_PX, DOT_PX = 96, 3  # sides of a picture of samples, and of the square that shows a sample
EXCESSIVE_REFLECTANCE = 2.0  # 1/sr of half of the samples: six times what a white matte surface reflects
EXCESSIVE_ALBEDO = 1.01  # the share of reflected light above which a note says so


class BrdfPresenter(Presenter[Brdf]):
    """The presenter of BRDFs fitted by any network; subclasses of the application are shown by it, too."""

    picture_measure = (
        "the sphere under an environment map (a sky, a sun, two windows), sRGB, over the pixels it touches"
    )

    @override
    def preview(self, theta: Params, task: Task) -> dict[str, Tensor]:
        """Return pictures of the sphere, linear RGB on black with coverage, [H, W, 4].

        A material that is known by samples alone has no `reference`: it has pictures of these samples, `samples`, and
        of the fit at the angles of these samples, `predicted`.
        """
        scene = reference_scene(azimuths=True) if "phi_h" in task.data else reference_scene()
        evaluate = functools.partial(find_network(theta).evaluate, theta)
        fit = shade_sphere(scene, evaluate)
        if "render" in task.data:
            return {"reference": task.data["render"], "fit": fit}
        # the last samples are held out
        angles, reflectance = task.data["angles"][-DRAWN_SAMPLES:], task.data["reflectance"][-DRAWN_SAMPLES:]
        with_phi_h = angles
        if "phi_h" in task.data:
            with_phi_h = torch.cat([angles, task.data["phi_h"][-DRAWN_SAMPLES:, None]], 1)
        predicted = evaluate(with_phi_h)
        return {"samples": plot_samples(angles, reflectance), "predicted": plot_samples(angles, predicted), "fit": fit}

    @override
    def comparison(self, theta: Params, task: Task) -> PictureComparison | None:
        """Return the sphere under the environment map; None for data sets made before tasks had such pictures."""
        if "environment" not in task.data:
            return None
        scene = environment_scene(azimuths="phi_h" in task.data)
        fit = shade_sphere(scene, functools.partial(find_network(theta).evaluate, theta))
        return PictureComparison(_encode_on_white(fit), _encode_on_white(task.data["environment"]), scene.mask)

    @override
    def remarks(self, theta: Params, task: Task) -> dict[str, object]:
        """State what a reader of the error must know of the fit, as notes, and how much light it reflects.

        Notes say that no sample is held out, that samples do not determine the highlight, that phi_h is left out, that
        reflectance is the same everywhere, and that more light is reflected than received. `albedo`, of isotropic fits,
        is the share of light that is reflected, the greatest of the channels', from each of the angles
        `metapp.apps.brdf.energy.INCIDENT_RAD`.
        """
        notes, seen_count = [], len(task.data["angles"]) // 2
        if torch.equal(task.data["angles"][:seen_count], task.data["angles"][seen_count:]):
            notes.append(f"all {seen_count} samples are fitted, none is held out: the error is of these")
        if highlight_note := describe_highlight(theta, task):
            notes.append(highlight_note)
        if "phi_h" in task.data and not self.app.network.anisotropic:
            notes.append("anisotropic, fitted as isotropic: phi_h is left out; take --recipe anisotropic")
        notes += uniform_input_remarks(task.data["reflectance"].T, "reflectance in 1/sr")
        remarks: dict[str, object] = {}
        if not self.app.network.anisotropic:
            theta_on_cpu = {key: value.cpu() for key, value in theta.items()}
            shares = albedo(functools.partial(self.app.reflectance, theta_on_cpu)).amax(1)
            remarks["albedo"] = [round(share, 4) for share in shares.tolist()]
            if (greatest_share := float(shares.amax())) > EXCESSIVE_ALBEDO:
                angle = math.degrees(INCIDENT_RAD[shares.argmax()])
                # far from samples reflectance is an exponential of anything
                amount = f"{greatest_share:.2f} of" if greatest_share < 100 else "more than 100 times"
                remedy = "--conserve limits it"
                if torch.quantile(task.data["reflectance"].float().flatten()[:100_000], 0.5) > EXCESSIVE_REFLECTANCE:
                    remedy = "half of the samples do so, too: are they in 1/sr?"
                notes.append(f"reflects {amount} the light from {angle:.0f} degrees; {remedy}")
        return remarks | ({"note": "; ".join(notes)} if notes else {})

    @override
    @torch.no_grad()
    def quality_warnings(self, theta: Params, tasks: Tasks) -> list[list[str]]:
        """Warn of a fit that is black or the same everywhere, where the material is not."""
        where, target = (tasks.data[key][tasks.rows].transpose(1, 2) for key in ("where", "target"))
        samples = torch.expm1(target) / where[:, 6:7].clamp_min(1e-4)
        pairs = zip(self.app.network.reflectance(theta, where).clamp_min(0), samples, strict=True)
        return [collapsed_fit_warnings(fit, material) for fit, material in pairs]


def describe_highlight(theta: Params, task: Task) -> str:
    """Return a clause of a note, that samples do not determine the highlight; "" if they do.

    More than MANY_SAMPLES, and those of anisotropic materials, are only asked whether any of them shows it.
    """
    seen_count = len(task.data["angles"]) // 2
    angles, reflectance = task.data["angles"][:seen_count], task.data["reflectance"][:seen_count]
    if seen_count > MANY_SAMPLES or "phi_h" in task.data:
        return describe_unseen_highlight(angles)
    theta = {key: value.cpu() for key, value in theta.items()}
    evaluate = functools.partial(find_network(theta).evaluate, theta)
    return describe_guessed_highlight(angles.cpu(), reflectance.cpu(), evaluate)


def plot_samples(angles: Tensor, reflectance: Tensor) -> Tensor:
    """Draw samples in the half-vector plane: the root of theta_h from left to right, theta_d from the bottom up.

    Args:
        angles: theta_h, theta_d, phi_d [N, 3] in rad.
        reflectance: linear RGB [N, 3] in 1/sr.

    Returns:
        [SAMPLES_SIDE_PX, SAMPLES_SIDE_PX, 4]: pi f as linear RGB on black, and coverage.
    """
    picture = reflectance.new_zeros(SAMPLES_SIDE_PX, SAMPLES_SIDE_PX, 4)
    plane_shares = angles[:, :2] / (math.pi / 2)
    last_px = SAMPLES_SIDE_PX - DOT_PX
    x, y = (last_px * torch.stack([plane_shares[:, 0].sqrt(), 1 - plane_shares[:, 1]])).round().long().clamp(0, last_px)
    colour = torch.cat([math.pi * reflectance, torch.ones_like(reflectance[:, :1])], 1)
    for row, column in itertools.product(range(DOT_PX), repeat=2):
        picture[y + row, x + column] = colour
    return picture


def _encode_on_white(linear: Tensor) -> Tensor:
    """Encode linear RGB on black with coverage, [H, W, 4], as sRGB [1, 3, H, W] on white."""
    return torch.from_numpy(composite_to_srgb(linear)).to(linear).permute(2, 0, 1)[None]
