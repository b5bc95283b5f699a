"""BRDFs of few samples: the samples of a fit, and the error that they leave."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor

from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.brdf_network import COUNT_KEY, BrdfNetwork, gather_samples
from metapp.apps.brdf.few.design import Posterior, expected_errors
from metapp.apps.brdf.few.gaussian_model import FEW_NETWORK, error_slope, ridge_regression
from metapp.apps.brdf.recipes import FULL, RIDGE_TRAINING
from metapp.apps.brdf.sample_augmentation import draw_measurements, mix_brdfs
from metapp.learning.task import Batch, LeastSquares, Params, Task, Tasks

MAX_FEW_SAMPLES = 1024  # samples of which a material has few at most
SHORT_BATCH_SAMPLES = 512  # samples of shorter batches
TABLE_SAMPLES = 32  # samples of a table, which has more, that a fit sees: the first ones
TRAINING_SAMPLE_RANGE = (4, 256)  # samples in training, at least and at most


@dataclass(frozen=True)
class FewSamples(Brdf):
    """Materials of few samples, all of which a fit sees at once."""

    network: BrdfNetwork = FEW_NETWORK

    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Count the first TABLE_SAMPLES alone of a table, which has more than MOST_SAMPLES."""
        data = super().prepare(task)
        return data | {COUNT_KEY: torch.tensor(float(TABLE_SAMPLES))} if data[COUNT_KEY] > MAX_FEW_SAMPLES else data

    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """The samples that a fit sees, again and again, and how many different ones, `count` [T].

        If all materials have SHORT_BATCH or fewer, a batch has no more: the solve takes half the time.
        """
        seen = tasks.data[COUNT_KEY][tasks.rows]
        count = min(count, SHORT_BATCH_SAMPLES) if bool((seen <= SHORT_BATCH_SAMPLES).all()) else count
        rows = torch.arange(count, device=rng.device) % seen[:, None].long()
        return gather_samples(tasks, rows) | {COUNT_KEY: seen}

    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Return mixtures of these materials, with few samples as instruments take them."""
        return tasks.make_variants(
            draw_measurements(mix_brdfs(tasks, rng), rng, dense_share=0.0, counts=TRAINING_SAMPLE_RANGE)
        )

    def loss_parameters(self, steps: int) -> Params:
        """Return initial smoothing alone: the network itself says how much samples count."""
        return {"smoothing": super().loss_parameters(steps)["smoothing"]}

    def least_squares(self, theta: Params, batch: Batch, learned: Params) -> LeastSquares:
        """The ridge regression of all samples in logarithms."""
        return ridge_regression(theta, batch)

    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        """With the error that samples leave, x100: `expected` over all directions, in highlights, at grazing angles."""
        batch = self.sample(tasks, Generator(), MAX_FEW_SAMPLES)
        errors = []
        for i, count in enumerate(batch[COUNT_KEY].tolist()):
            one = {key: value[i : i + 1] for key, value in theta.items()}
            where, target = (batch[key][i : i + 1, :, : int(count)] for key in ("where", "target"))
            slope = error_slope(target.expm1() / where[:, 6:].clamp_min(1e-4), where)
            errors.append(expected_errors(Posterior.of(one, where, slope)))
        expected = {name: self.error_measure.scale * torch.tensor([one[name] for one in errors]) for name in errors[0]}
        return super().errors(theta, tasks) | expected


# one solve of all samples, which may be noisy or lack grazing angles
FEW_RECIPE = replace(
    FULL,
    steps=1,
    batch=MAX_FEW_SAMPLES,
    meta={
        "ridge": replace(
            RIDGE_TRAINING,
            tasks=12,
            rates=RIDGE_TRAINING.rates | {f"encoder.encoder.{own}": 1e-2 for own in ("last", "deviation", "noise")},
            validate_every=1000,
            app=FewSamples(),
        )
    },
)
