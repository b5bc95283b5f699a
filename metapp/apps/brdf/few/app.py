"""The application of BRDFs from few samples, which states the error that they leave, and the recipe `few`.

The application differs from :class:`metapp.apps.brdf.app.Brdf` in that a fit sees all samples in its one step, and in
that the network says how much each of them counts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor
from typing_extensions import override

from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.brdf_network import COUNT_KEY, BrdfNetwork, gather_samples
from metapp.apps.brdf.few.design import Posterior, expected_errors
from metapp.apps.brdf.few.gaussian_model import FEW_NETWORK, error_slope, ridge_regression
from metapp.apps.brdf.recipes import FULL, RIDGE_TRAINING
from metapp.apps.brdf.sample_augmentation import draw_measurements, mix_brdfs
from metapp.learning.task import Batch, LeastSquares, Params, Task, Tasks

MAX_FEW_SAMPLES = 1024  # different samples of a material, above which it counts as a table
SHORT_BATCH_SAMPLES = 512  # samples of a batch if no material has more
TABLE_SAMPLES = 32  # samples of a table that a fit sees: the first ones
TRAINING_SAMPLE_RANGE = (4, 256)  # the least and the greatest count of samples in training


@dataclass(frozen=True)
class FewSamples(Brdf):
    """The application of BRDFs from few samples, all of which a fit sees at once."""

    network: BrdfNetwork = FEW_NETWORK

    @override
    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Let fits see no more than the first TABLE_SAMPLES of a task with more than MAX_FEW_SAMPLES."""
        data = super().prepare(task)
        return data | {COUNT_KEY: torch.tensor(float(TABLE_SAMPLES))} if data[COUNT_KEY] > MAX_FEW_SAMPLES else data

    @override
    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """Return the samples that a fit sees, repeated to fill the batch, and COUNT_KEY, [T]: how many are different.

        If no material has more than SHORT_BATCH_SAMPLES, the batch has no more either: the solve takes half the time.
        """
        distinct_counts = tasks.data[COUNT_KEY][tasks.rows]
        count = min(count, SHORT_BATCH_SAMPLES) if bool((distinct_counts <= SHORT_BATCH_SAMPLES).all()) else count
        rows = torch.arange(count, device=rng.device) % distinct_counts[:, None].long()
        return gather_samples(tasks, rows) | {COUNT_KEY: distinct_counts}

    @override
    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Return mixtures of these materials, with few samples as instruments take them."""
        return tasks.make_variants(
            draw_measurements(mix_brdfs(tasks, rng), rng, dense_share=0.0, counts=TRAINING_SAMPLE_RANGE)
        )

    @override
    def initial_loss_parameters(self, steps: int) -> Params:
        """Return the initial smoothing alone: the network itself says how much samples count."""
        return {"smoothing": super().initial_loss_parameters(steps)["smoothing"]}

    @override
    def least_squares(self, theta: Params, batch: Batch, loss_parameters: Params) -> LeastSquares:
        """Return the ridge regression of all samples in logarithms of reflectance."""
        return ridge_regression(theta, batch)

    @override
    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        """Add the errors that samples leave, x100, over all directions, in highlights and at grazing angles.

        See :func:`metapp.apps.brdf.few.design.expected_errors`.
        """
        batch = self.sample(tasks, Generator(), MAX_FEW_SAMPLES)
        errors = []
        for i, count in enumerate(batch[COUNT_KEY].tolist()):
            material = {key: value[i : i + 1] for key, value in theta.items()}
            where, target = (batch[key][i : i + 1, :, : int(count)] for key in ("where", "target"))
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
