"""The application of BRDFs on half and difference vectors (paper section 4.1.2).

A task is one material, known by samples of its reflectance; losses and errors compare log(1 + f cos theta_i). Which
network a fit has does not matter here: all are used by the methods of :class:`BrdfNetwork`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.geometry import half_difference_and_cosine
from metapp.apps.brdf import anisotropic
from metapp.apps.brdf.brdf_network import COUNT_KEY, BrdfNetwork, gather_samples, opponent_axes, put_distinct_first
from metapp.apps.brdf.nbrdf_network import NBRDF_NETWORK, WEIGHT_KNOTS, sample_weights
from metapp.apps.brdf.sample_augmentation import mix_brdfs
from metapp.learning.app import App, ErrorMeasure
from metapp.learning.random_tensors import draw_uniform
from metapp.learning.task import Batch, LeastSquares, Params, Task, Tasks, TensorSpec
from metapp.networks.coded import smooth_absolute

ENCODER_SAMPLES = 1024  # samples that General's encoder reads
MANY_SAMPLES = 4096  # different samples, above which further ones count no more against penalties


@dataclass(frozen=True)
class Brdf(App):
    """The application of BRDFs: a task is one measured or modelled material.

    If a material is anisotropic, a network that does not read phi_h fits the mean over phi_h.

    Attributes:
        network: evaluates materials, and has General's encoder of its own.
        conserve: whether fits are changed after the last step so that they reflect no more light than they receive.
    """

    network: BrdfNetwork = NBRDF_NETWORK
    conserve: bool = False
    name = "brdf"
    error_measure = ErrorMeasure(
        "mean |log(1 + f cos theta_i) - log(1 + f' cos theta_i)| over samples that are held out, or all if none is",
        scale=100,
    )
    tensors: ClassVar = {
        "angles": TensorSpec(("N", 3), low=0.0, high=2 * math.pi),
        "phi_h": TensorSpec(("N",), low=0.0, high=2 * math.pi, optional=True),
        "reflectance": TensorSpec(("N", 3), low=0.0),
        "render": TensorSpec(("H", "W", 4), optional=True),
        "environment": TensorSpec(("h", "w", 4), optional=True),
    }
    small_tensors = True

    @override
    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Prepare the samples of a material as networks read them.

        Returns:
            `where` [N, 7]: half vector, difference vector and cos theta_i; `target` [N, 3]: log(1 + f cos theta_i). For
            a network that is linear in a parameter also COUNT_KEY, a scalar: see :func:`put_distinct_first`.
        """
        angles = task.data["angles"]
        if self.network.anisotropic:
            phi_h = task.data.get("phi_h", anisotropic.fixed_azimuths(len(angles)).to(angles))
            angles = torch.cat([angles, phi_h[:, None]], 1)
        where = half_difference_and_cosine(angles)
        data = {"where": where.float(), "target": torch.log1p(task.data["reflectance"] * where[:, 6:]).float()}
        return put_distinct_first(data) if self.network.linear_parameter else data

    @property
    @override
    def linear_parameter(self) -> str:
        return self.network.linear_parameter

    @override
    def init(self, rng: Generator, count: int) -> Params:
        return self.network.init(rng, count)

    @override
    def init_encoder(self, rng: Generator) -> Params:
        return self.network.init_encoder(rng)

    @override
    def encode(self, encoder: Params, encoder_input: Batch) -> Params:
        return self.network.encode(encoder, encoder_input)

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Draw `where` [T, 7, count] and `target` [T, 3, count] from the first half of each task's samples.

        For a network that is linear in a parameter, the batch also has COUNT_KEY, [T]: the number of different samples
        of each task. These come first in the task, and only these are drawn.
        """
        half = tasks.data["where"].shape[1] // 2
        if not self.network.linear_parameter:
            return gather_samples(tasks, torch.randint(half, (len(tasks), count), generator=rng, device=rng.device))
        # tasks that were prepared for another network do not say how many samples are different
        half_counts = torch.full((len(tasks.names),), float(half), device=rng.device)
        distinct_counts = tasks.data.get(COUNT_KEY, half_counts)[tasks.rows]
        rows = (draw_uniform(rng, len(tasks), count) * distinct_counts[:, None]).long()
        return gather_samples(tasks, rows) | {COUNT_KEY: distinct_counts}

    @override
    def outer_sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Draw query samples from the second half, which fits do not see and where augmentation leaves out no angle."""
        half = tasks.data["where"].shape[1] // 2
        return gather_samples(tasks, half + torch.randint(half, (len(tasks), count), generator=rng, device=rng.device))

    @override
    def loss(self, theta: Params, batch: Batch, loss_parameters: Params) -> Tensor:
        """Return the mean |log(1 + f cos theta_i) - log(1 + f' cos theta_i)| of each task, [T].

        The learned `smoothing` [T], log s, replaces |d| by sqrt(d^2 + s^2) - s, whose curvature at sign changes
        automatic differentiation sees. The learned `weights` [T, 8] are log weights of samples: see
        :func:`sample_weights`. The extension `native` computes this loss in C, too: change it in a subclass, which
        `native` leaves to torch, or in both places.
        """
        where = batch["where"]
        # errors clamp reflectance at 0, which only ever lowers them; without it a fit that is too dark has a gradient
        differences = torch.log1p(self.network.reflectance(theta, where) * where[:, 6:7]) - batch["target"]
        if not loss_parameters:
            return differences.abs().mean((1, 2))
        misfits = smooth_absolute(differences, loss_parameters).mean(1)
        return (misfits * sample_weights(where, loss_parameters) if "weights" in loss_parameters else misfits).mean(1)

    @override
    def least_squares(self, theta: Params, batch: Batch, loss_parameters: Params) -> LeastSquares:
        """Return least squares in log(1 + f) that follow the loss near the fit of this step.

        A sample weighs slope^2 / sqrt(d^2 + s^2), where d is its difference from the target, s the learned smoothing,
        and slope the derivative of log(1 + f cos theta_i) in log(1 + f). Two learned powers, `evidence` [T, 2], lower
        all weights against the penalties: one where a task has few samples, one where the fit of this step misses them.
        Penalties hold for luminance and two axes of colour.
        """
        where, target = batch["where"], batch["target"]
        cosine = where[:, 6:7]
        features = self.network.linear_features(theta, where)
        residual = torch.log1p(torch.expm1(target) / cosine.clamp_min(1e-4)) - torch.bmm(theta["last"], features)
        # the derivative of log(1 + f cos theta_i) in log(1 + f)
        slope = 1 - (1 - cosine) * torch.exp(-target)
        differences = slope * residual
        smoothing = torch.exp(loss_parameters["smoothing"])[:, None]
        weights = slope.square().mean(1) / (differences.square().mean(1) + smoothing * smoothing).sqrt()
        losses = differences.abs().mean((1, 2))
        count_power, miss_power = loss_parameters["evidence"].unbind(1)
        count_share = batch[COUNT_KEY].clamp(max=MANY_SAMPLES) / MANY_SAMPLES
        strength = count_share**count_power * (1 + losses / smoothing[:, 0]) ** -miss_power
        axes = opponent_axes(features)
        return LeastSquares("last", features, residual, weights * strength[:, None], losses, axes=axes)

    @override
    def initial_loss_parameters(self, steps: int) -> Params:
        """Return initial values of log `smoothing`, [steps], and of what a rule learns beside it.

        That is `evidence` [steps, 2] for a network that is linear in a parameter, else `weights` [steps, 8].
        """
        parameters = {"smoothing": torch.full((steps,), math.log(0.05))}
        if self.network.linear_parameter:
            return parameters | {"evidence": torch.tensor([1.0, 0.0]).repeat(steps, 1)}
        return parameters | {"weights": torch.zeros(steps, WEIGHT_KNOTS)}

    @override
    def encoder_input(self, tasks: Tasks, rng: Generator) -> Batch:
        return self.sample(tasks, rng, ENCODER_SAMPLES)

    @override
    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Return mixtures of these materials, with samples as the network learns from them."""
        return tasks.make_variants(self.network.augment(mix_brdfs(tasks, rng), rng))

    @override
    def postprocess(self, theta: Params) -> Params:
        """Limit fits to reflecting no more light than they receive, if `conserve` asks for it."""
        return self.network.conserve_energy(theta) if self.conserve else theta

    @override
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        half = tasks.data["where"].shape[1] // 2
        where = tasks.data["where"][tasks.rows, half:].transpose(1, 2)
        return self.errors_of(self.network.reflectance(theta, where).clamp_min(0), tasks)

    def errors_of(self, prediction: Tensor, tasks: Tasks) -> dict[str, Tensor]:
        """Measure how far reflectance is off at the held-out samples, the second half of each task's.

        Args:
            prediction: reflectance [T, 3, M] at these samples, linear RGB in 1/sr, >= 0.
            tasks: T tasks.

        Returns:
            `error` [T]: the mean |log(1 + f cos theta_i) - log(1 + f' cos theta_i)|.
        """
        half = tasks.data["where"].shape[1] // 2
        cosine = tasks.data["where"][tasks.rows, half:, 6:7].transpose(1, 2)
        target = tasks.data["target"][tasks.rows, half:].transpose(1, 2)
        return {"error": (torch.log1p(prediction * cosine) - target).abs().mean((1, 2))}

    def reflectance(self, theta: Params, angles: Tensor) -> Tensor:
        """Return the reflectance of a fit, linear RGB [..., 3] in 1/sr, without the cosine.

        Args:
            theta: the fit, without a task axis.
            angles: half and difference angles, and phi_h of anisotropic fits, [..., 3 or 4] in rad.
        """
        return self.network.evaluate(theta, angles)

    def require_isotropic(self, subject: str | Path, form: str) -> None:
        """Refuse to write an anisotropic fit in a form that has no phi_h.

        Args:
            subject: the fit's name or file, which begins the message.
            form: the form, as the subject of "has no phi_h".

        Raises:
            ValueError: the fit is anisotropic.
        """
        if self.network.anisotropic:
            raise ValueError(
                f"{subject}: an anisotropic fit, expected an isotropic one: {form} has no phi_h; export bsdf or "
                "mitsuba, or fit by --recipe full."
            )
