"""BRDFs on half and difference vectors (paper section 4.1.2): the NBRDF network, or one of learned features."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import torch
from torch import Generator, Tensor

from metapp.appearance.geometry import half_difference_and_cosine
from metapp.apps.brdf import anisotropic
from metapp.apps.brdf.brdf_network import COUNT_KEY, BrdfNetwork, gather_samples, opponent_axes, put_distinct_first
from metapp.apps.brdf.nbrdf_network import NBRDF_NETWORK, WEIGHT_KNOTS, sample_weights
from metapp.apps.brdf.sample_augmentation import mix_brdfs
from metapp.learning.app import App, ErrorMeasure
from metapp.learning.random_tensors import draw_uniform
from metapp.learning.task import Batch, LeastSquares, Params, Task, Tasks, TensorSpec
from metapp.networks.coded import smooth_absolute

CONDITION_SAMPLES = 1024  # samples that General's encoder reads
MANY_SAMPLES = 4096  # different samples, from which on more of them count no more against penalties


@dataclass(frozen=True)
class Brdf(App):
    """One measured or modelled material a task; of an anisotropic one a network without phi_h fits the mean.

    Attributes:
        network: evaluates materials; it has an encoder of its own.
        conserve: whether fits are brought to reflect no more than they receive.
    """

    network: BrdfNetwork = NBRDF_NETWORK
    conserve: bool = False
    name = "brdf"
    error_measure = ErrorMeasure(
        "mean |log(1 + f cos theta_i) - log(1 + f' cos theta_i)| on held-out directions", scale=100
    )
    tensors: ClassVar = {
        "angles": TensorSpec(("N", 3), low=0.0, high=2 * math.pi),
        "phi_h": TensorSpec(("N",), low=0.0, high=2 * math.pi, optional=True),
        "reflectance": TensorSpec(("N", 3), low=0.0),
        "render": TensorSpec(("H", "W", 4), optional=True),
        "environment": TensorSpec(("h", "w", 4), optional=True),
    }
    single_threaded = cheap_fits = True

    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Return `where` [N, 7], half and difference vector and cos theta_i; `target` [N, 3], log(1 + f cos theta_i).

        For a network that is linear in a parameter also COUNT, a scalar: see :func:`put_distinct_first`.
        """
        angles = task.data["angles"]
        if self.network.anisotropic:
            phi_h = task.data.get("phi_h", anisotropic.fixed_azimuths(len(angles)).to(angles))
            angles = torch.cat([angles, phi_h[:, None]], 1)
        where = half_difference_and_cosine(angles)
        data = {"where": where.float(), "target": torch.log1p(task.data["reflectance"] * where[:, 6:]).float()}
        return put_distinct_first(data) if self.network.linear_parameter else data

    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Draw `where` [T, 7, count] and `target` [T, 3, count] from the first half of the samples.

        Tasks for a network that is linear in a parameter have as many different samples as COUNT [T] says, the first
        ones, and a batch has this number, too.
        """
        half = tasks.data["where"].shape[1] // 2
        if not self.network.linear_parameter:
            return gather_samples(tasks, torch.randint(half, (len(tasks), count), generator=rng, device=rng.device))
        every = torch.full((len(tasks.names),), float(half), device=rng.device)  # of tasks for another network
        seen = tasks.data.get(COUNT_KEY, every)[tasks.rows]
        return gather_samples(tasks, (draw_uniform(rng, len(tasks), count) * seen[:, None]).long()) | {COUNT_KEY: seen}

    def outer_sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Query samples: from the half that fits do not see, of which augmentation leaves out no angle."""
        half = tasks.data["where"].shape[1] // 2
        return gather_samples(tasks, half + torch.randint(half, (len(tasks), count), generator=rng, device=rng.device))

    def loss(self, theta: Params, batch: Batch, learned: Params) -> Tensor:
        """Mean |log(1 + f cos theta_i) - log(1 + f' cos theta_i)|, [T].

        A learned `smoothing` s [T] replaces |d| by sqrt(d^2 + s^2) - s, whose curvature at sign changes autodiff sees;
        learned `weights` [T, 8] are log weights of samples at knots over theta_h. The extension `native` has this loss
        in C, too: change it in a subclass, which C leaves to torch, or in both places.
        """
        where = batch["where"]
        # without the clamp at 0 a network that is too dark still has a gradient; the clamp only ever helps
        d = torch.log1p(self.network.reflectance(theta, where) * where[:, 6:7]) - batch["target"]
        if not learned:
            return d.abs().mean((1, 2))
        off = smooth_absolute(d, learned).mean(1)
        return (off * sample_weights(where, learned) if "weights" in learned else off).mean(1)

    def least_squares(self, theta: Params, batch: Batch, learned: Params) -> LeastSquares:
        """Return least squares in log(1 + f) that follow the loss, by weights slope^2 / sqrt(d^2 + s^2) of this step.

        Learned powers, `evidence` [T, 2], say how much less against penalties few samples count, and ones that the fit
        so far misses. Penalties hold for luminance and two axes of colour.
        """
        where, target = batch["where"], batch["target"]
        cos = where[:, 6:7]
        features = self.network.features_of(theta, where)
        residual = torch.log1p(torch.expm1(target) / cos.clamp_min(1e-4)) - torch.bmm(theta["last"], features)
        # the derivative of log(1 + f cos theta_i) in log(1 + f)
        slope = 1 - (1 - cos) * torch.exp(-target)
        d = slope * residual
        s = torch.exp(learned["smoothing"])[:, None]
        weights = slope.square().mean(1) / (d.square().mean(1) + s * s).sqrt()
        losses = d.abs().mean((1, 2))
        few, missed = learned["evidence"].unbind(1)
        share = batch[COUNT_KEY].clamp(max=MANY_SAMPLES) / MANY_SAMPLES
        strength = share**few * (1 + losses / s[:, 0]) ** -missed
        axes = opponent_axes(features)
        return LeastSquares("last", features, residual, weights * strength[:, None], losses, axes=axes)

    def loss_parameters(self, steps: int) -> Params:
        """Return initial smoothing, and the powers of evidence of least squares, else log weights of samples."""
        parameters = {"smoothing": torch.full((steps,), math.log(0.05))}
        if self.network.linear_parameter:
            return parameters | {"evidence": torch.tensor([1.0, 0.0]).repeat(steps, 1)}
        return parameters | {"weights": torch.zeros(steps, WEIGHT_KNOTS)}

    def condition(self, tasks: Tasks, rng: Generator) -> Batch:
        return self.sample(tasks, rng, CONDITION_SAMPLES)

    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Mixtures of these materials, with samples as the network learns from them."""
        return tasks.make_variants(self.network.augment(mix_brdfs(tasks, rng), rng))

    def postprocess(self, theta: Params) -> Params:
        """Limited to reflecting no more than all, if that is asked for."""
        return self.network.conserved(theta) if self.conserve else theta

    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        half = tasks.data["where"].shape[1] // 2
        where = tasks.data["where"][tasks.rows, half:].transpose(1, 2)
        return self.errors_of(self.network.reflectance(theta, where).clamp_min(0), tasks)

    def errors_of(self, answer: Tensor, tasks: Tasks) -> dict[str, Tensor]:
        """Of reflectance [T, 3, M] at the held-out samples, linear RGB in 1/sr, >= 0."""
        half = tasks.data["where"].shape[1] // 2
        cos = tasks.data["where"][tasks.rows, half:, 6:7].transpose(1, 2)
        target = tasks.data["target"][tasks.rows, half:].transpose(1, 2)
        return {"error": (torch.log1p(answer * cos) - target).abs().mean((1, 2))}

    def reflectance(self, theta: Params, angles: Tensor) -> Tensor:
        """Return reflectance in 1/sr without the cosine, linear RGB [..., 3].

        Args:
            theta: the fit, without a task axis.
            angles: half and difference angles, and phi_h of anisotropic fits, [..., 3 or 4] in rad.
        """
        return self.network.evaluate(theta, angles)

    def require_isotropic(self, subject: str | Path, form: str) -> None:
        """Refuse to write a fit in a form that has no phi_h.

        Raises:
            ValueError: the fit is anisotropic.
        """
        if self.network.anisotropic:
            raise ValueError(
                f"{subject}: an anisotropic fit, expected an isotropic one: {form} has no phi_h; export bsdf or "
                "mitsuba, or fit by --recipe full."
            )
