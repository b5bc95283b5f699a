"""The application of BRDFs from few samples, which states the error that they leave, and the recipe `few`.

The application differs from :class:`metapp.apps.brdf.app.Brdf` in that a fit sees all samples in its one step, and in
that the network says how much each of them counts.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.brdf_network import BrdfNetwork, DistinctSamples, gather_samples
from metapp.apps.brdf.few.design import Posterior, expected_errors
from metapp.apps.brdf.few.gaussian_model import FEW_NETWORK, error_slope, ridge_regression
from metapp.apps.brdf.recipes import FULL, RIDGE_TRAINING
from metapp.apps.brdf.sample_augmentation import draw_measurements, mix_brdfs
from metapp.apps.brdf.sample_sight import DistinctSampleSight
from metapp.learning.task import LeastSquares, Params, Task, Tasks

MAX_FEW_SAMPLES = 1024  # different samples of a material, above which it counts as a table
SHORT_BATCH_SAMPLES = 512  # samples of a batch if no material has more
TABLE_SAMPLES = 32  # samples of a table that a fit sees: the first ones
TRAINING_SAMPLE_RANGE = (4, 256)  # the least and the greatest count of samples in training


@dataclass(frozen=True)
class FewSampleSight(DistinctSampleSight):
    """The sight of few samples, all of which a fit sees at once."""

    @override
    def prepare(self, task: Task, decoder: BrdfNetwork) -> DistinctSamples:
        """Let fits see no more than the first TABLE_SAMPLES of a task with more than MAX_FEW_SAMPLES."""
        samples = super().prepare(task, decoder)
        is_table = samples.distinct > MAX_FEW_SAMPLES
        return samples._replace(distinct=torch.tensor(float(TABLE_SAMPLES))) if is_table else samples

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> DistinctSamples:
        """Return the samples that a fit sees, repeated to fill the batch.

        If no material has more than SHORT_BATCH_SAMPLES, the batch has no more either: the solve takes half the time.
        """
        counts = tasks.data["distinct"][tasks.rows]
        count = min(count, SHORT_BATCH_SAMPLES) if bool((counts <= SHORT_BATCH_SAMPLES).all()) else count
        rows = torch.arange(count, device=rng.device) % counts[:, None].long()
        return DistinctSamples(*gather_samples(tasks, rows), counts)

    @override
    def initial_loss_parameters(self, steps: int) -> Params:
        """Return the initial smoothing alone: the network itself says how much samples count."""
        return {"smoothing": super().initial_loss_parameters(steps)["smoothing"]}

    @override
    def least_squares(
        self, decoder: BrdfNetwork, theta: Params, seen: DistinctSamples, loss_parameters: Params
    ) -> LeastSquares:
        """Return the ridge regression of all samples in logarithms of reflectance."""
        return ridge_regression(theta, seen)


@dataclass(frozen=True)
class FewSamples(Brdf):
    """The application of BRDFs from few samples."""

    decoder: BrdfNetwork = FEW_NETWORK
    sight: FewSampleSight = field(default_factory=FewSampleSight)

    @override
    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Return mixtures of these materials, with few samples as instruments take them."""
        return tasks.make_variants(
            draw_measurements(mix_brdfs(tasks, rng), rng, dense_share=0.0, counts=TRAINING_SAMPLE_RANGE)
        )

    @override
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        """Add the errors that samples leave, x100, over all directions, in highlights and at grazing angles.

        See :func:`metapp.apps.brdf.few.design.expected_errors`.
        """
        samples, errors = self.sight.sample(tasks, Generator(tasks.rows.device), MAX_FEW_SAMPLES), []
        for i, count in enumerate(samples.distinct.tolist()):
            material = {key: value[i : i + 1] for key, value in theta.items()}
            where, target = (values[i : i + 1, :, : int(count)] for values in (samples.where, samples.target))
            slope = error_slope(target.expm1() / where[:, 6:].clamp_min(1e-4), where)
            errors.append(expected_errors(Posterior.from_samples(material, where, slope)))
        scale = self.error_measure.scale
        expected = {name: scale * torch.tensor([entry[name] for entry in errors]) for name in errors[0]}
        return super().errors(theta, tasks) | expected


# one solve of all samples, which may be noisy or lack grazing angles
FEW_RECIPE = replace(
    FULL,
    steps=1,
    samples=MAX_FEW_SAMPLES,
    meta={
        "ridge": replace(
            RIDGE_TRAINING,
            tasks=12,
            rates=RIDGE_TRAINING.rates | {f"encoder.encoder.{name}": 1e-2 for name in ("last", "deviation", "noise")},
            validate_every=1000,
            app=FewSamples(),
        )
    },
)
