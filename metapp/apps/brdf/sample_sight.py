"""What fits of BRDFs see: samples of reflectance, random ones in each step.

Of each task's samples, fits see those of the first half; those of the second half are held out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.appearance.geometry import half_difference_and_cosine
from metapp.apps.brdf import anisotropic
from metapp.apps.brdf.brdf_network import (
    BrdfNetwork,
    DistinctSamples,
    ReflectanceFunction,
    ReflectanceSamples,
    SampleEncoder,
    gather_samples,
    opponent_axes,
    put_distinct_first,
)
from metapp.apps.brdf.highlight import MANY_SAMPLES
from metapp.apps.brdf.nbrdf_network import WEIGHT_KNOTS, sample_weights
from metapp.learning.components import Sight, VisibleData
from metapp.learning.random_tensors import draw_uniform
from metapp.learning.rounding import initial_smoothing, smooth_absolute
from metapp.learning.task import LeastSquares, Params, Task, Tasks

INITIAL_SMOOTHING = 0.05  # of |d| in losses, before a rule has learned it


@dataclass(frozen=True)
class SampleSight(Sight[ReflectanceFunction, Any]):
    """The sight of random samples of the first half of each task's."""

    seen_type: ClassVar[type[Any]] = ReflectanceSamples

    @override
    def describe_visible(self, task: Task) -> VisibleData:
        """Return how many samples steps draw from: the first half, three angles and a colour each."""
        angles, reflectance = task.data["angles"], task.data["reflectance"]
        return VisibleData(len(angles) // 2, angles[0].nbytes + reflectance[0].nbytes, SampleEncoder.samples)

    @override
    def prepare(self, task: Task, decoder: BrdfNetwork) -> Any:
        angles = task.data["angles"]
        if decoder.anisotropic:
            phi_h = task.data.get("phi_h", anisotropic.fixed_azimuths(len(angles)).to(angles))
            angles = torch.cat([angles, phi_h[:, None]], 1)
        where = half_difference_and_cosine(angles)
        target = torch.log1p(task.data["reflectance"] * where[:, 6:])
        return ReflectanceSamples(where.float(), target.float())

    @override
    def gather(self, tasks: Tasks) -> Any:
        """Return the samples of the first half."""
        half = tasks.data["where"].shape[1] // 2
        return ReflectanceSamples(
            *(tasks.data[name][tasks.rows, :half].transpose(1, 2) for name in ReflectanceSamples._fields)
        )

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Any:
        half = tasks.data["where"].shape[1] // 2
        rows = torch.randint(half, (len(tasks), count), generator=rng, device=rng.device)
        return gather_samples(tasks, rows)

    @override
    def loss(self, answer: ReflectanceFunction, seen: Any, loss_parameters: Params) -> Tensor:
        """Return the mean |log(1 + f cos theta_i) - log(1 + f' cos theta_i)| of each task, [T].

        The learned `smoothing` [T], log s, replaces |d| by sqrt(d^2 + s^2) - s, whose curvature at sign changes
        automatic differentiation sees. The learned `weights` [T, 8] are log weights of samples: see
        :func:`sample_weights`. The extension `native` computes this loss in C, too: change it in a subclass, which
        `native` leaves to torch, or in both places.
        """
        # errors clamp reflectance at 0, which only ever lowers them; without it a fit that is too dark has a gradient
        differences: Tensor = torch.log1p(answer(seen.where) * seen.where[:, 6:7]) - seen.target
        if not loss_parameters:
            return differences.abs().mean((1, 2))
        misfits = smooth_absolute(differences, loss_parameters).mean(1)
        weights = sample_weights(seen.where, loss_parameters) if "weights" in loss_parameters else 1.0
        return (misfits * weights).mean(1)

    @override
    def initial_loss_parameters(self, steps: int) -> Params:
        """Return initial values of log `smoothing`, [steps], and `weights` [steps, 8]."""
        return initial_smoothing(steps, INITIAL_SMOOTHING) | {"weights": torch.zeros(steps, WEIGHT_KNOTS)}


@dataclass(frozen=True)
class DistinctSampleSight(SampleSight):
    """The sight of random samples for networks that are linear in a parameter.

    Rules solve for that parameter, and need to know how many samples are different.
    """

    seen_type = DistinctSamples

    @override
    def seen_type_of(self, tensors: Mapping[str, Tensor]) -> type[Any]:
        """Return also the type of samples that are not counted, which judges draw."""
        return DistinctSamples if "distinct" in tensors else ReflectanceSamples

    @override
    def prepare(self, task: Task, decoder: BrdfNetwork) -> DistinctSamples:
        """Put different samples first; see :func:`put_distinct_first`."""
        return put_distinct_first(super().prepare(task, decoder))

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> DistinctSamples:
        """Draw samples of those that are different."""
        # tasks that were prepared for another network do not say how many these are
        half_counts = torch.full((len(tasks.names),), float(tasks.data["where"].shape[1] // 2), device=rng.device)
        counts = tasks.data.get("distinct", half_counts)[tasks.rows]
        rows = (draw_uniform(rng, len(tasks), count) * counts[:, None]).long()
        return DistinctSamples(*gather_samples(tasks, rows), counts)

    @override
    def least_squares(
        self, decoder: BrdfNetwork, theta: Params, seen: DistinctSamples, loss_parameters: Params
    ) -> LeastSquares:
        """Return least squares in log(1 + f) that follow the loss near the fit of this step.

        A sample weighs slope^2 / sqrt(d^2 + s^2), where d is its difference from the target, s the learned smoothing,
        and slope the derivative of log(1 + f cos theta_i) in log(1 + f). Two learned powers, `evidence` [T, 2], lower
        all weights against the penalties: one where a task has few samples, one where the fit of this step misses them.
        Penalties hold for luminance and two axes of colour.
        """
        where, target, distinct = seen
        cosine = where[:, 6:7]
        features = decoder.linear_features(theta, where)
        residual = torch.log1p(torch.expm1(target) / cosine.clamp_min(1e-4)) - torch.bmm(theta["last"], features)
        # the derivative of log(1 + f cos theta_i) in log(1 + f)
        slope = 1 - (1 - cosine) * torch.exp(-target)
        differences = slope * residual
        smoothing = torch.exp(loss_parameters["smoothing"])[:, None]
        weights = slope.square().mean(1) / (differences.square().mean(1) + smoothing * smoothing).sqrt()
        losses = differences.abs().mean((1, 2))
        count_power, miss_power = loss_parameters["evidence"].unbind(1)
        count_share = distinct.clamp(max=MANY_SAMPLES) / MANY_SAMPLES
        strength = count_share**count_power * (1 + losses / smoothing[:, 0]) ** -miss_power
        axes = opponent_axes(features)
        return LeastSquares("last", features, residual, weights * strength[:, None], losses, axes=axes)

    @override
    def initial_loss_parameters(self, steps: int) -> Params:
        """Return initial values of log `smoothing`, [steps], and `evidence` [steps, 2]."""
        evidence = torch.tensor([1.0, 0.0]).repeat(steps, 1)
        return initial_smoothing(steps, INITIAL_SMOOTHING) | {"evidence": evidence}
