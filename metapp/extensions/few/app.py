"""BRDFs of few samples: the samples of a fit, and the error that they leave."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor

from metapp.apps.brdf.app import Brdf
from metapp.apps.brdf.augmentation import mixed, within_reach
from metapp.apps.brdf.network import BrdfNetwork, samples_at
from metapp.apps.brdf.recipes import FULL, RIDGE
from metapp.extensions.few.design import Posterior, expected_errors
from metapp.extensions.few.network import NETWORK, linear, slope_of
from metapp.learning.draws import normal, uniform
from metapp.learning.task import Batch, LeastSquares, Params, Task, Tasks

MOST_SAMPLES = 1024  # samples of which a material has few at most
SHORT_BATCH = 512  # samples of shorter batches
TABLE_SAMPLES = 32  # samples of a table, which has more, that a fit sees: the first ones
FEWEST_SAMPLES, SEEN_SAMPLES = 4, 256  # samples in training, at least and at most
NOISY, MOST_NOISE = 1 / 2, 0.1  # share of the materials whose samples are noisy, and their most noise
POLAR = 3  # the power that crowds theta_h around 0


@dataclass(frozen=True)
class FewSamples(Brdf):
    """Materials of few samples, all of which a fit sees at once."""

    network: BrdfNetwork = NETWORK

    def prepare(self, task: Task) -> dict[str, Tensor]:
        """Put the samples that a fit sees in front, none twice, and say their `count`.

        Of a table, which has more than MOST_SAMPLES, a fit sees the first TABLE_SAMPLES of them.
        """
        data = super().prepare(task)
        half = len(data["where"]) // 2
        _, which = torch.unique(data["where"][:half], dim=0, return_inverse=True)
        first = torch.full((int(which.max()) + 1,), half).scatter_reduce(0, which, torch.arange(half), "amin")
        if len(first) > MOST_SAMPLES:
            return data | {"count": torch.tensor(float(TABLE_SAMPLES))}
        order = torch.arange(len(data["where"]))
        order[: len(first)] = first.sort().values
        return {key: value[order] for key, value in data.items()} | {"count": torch.tensor(float(len(first)))}

    def sample(self, tasks: Tasks, rng: Generator, count: int) -> Batch:
        """The samples that a fit sees, again and again, and how many different ones, `count` [T].

        If all materials have SHORT_BATCH or fewer, a batch has no more: the solve takes half the time.
        """
        seen = tasks.data["count"][tasks.rows]
        count = min(count, SHORT_BATCH) if bool((seen <= SHORT_BATCH).all()) else count
        rows = torch.arange(count, device=rng.device) % seen[:, None].long()
        return samples_at(tasks, rows) | {"count": seen}

    def augment(self, tasks: Tasks, rng: Generator) -> Tasks:
        """Mixtures of these materials, with samples as `few_of` draws them."""
        return tasks.variants(few_of(mixed(tasks, rng), rng))

    def least_squares(self, theta: Params, batch: Batch, learned: Params) -> LeastSquares:
        """The ridge regression of all samples in logarithms."""
        return linear(theta, batch)

    def errors(self, theta: Params, tasks: Tasks) -> dict[str, Tensor]:
        """With the error that samples leave, x100: `expected` over all directions, in highlights, at grazing angles."""
        batch = self.sample(tasks, Generator(), MOST_SAMPLES)
        errors = []
        for i, count in enumerate(batch["count"].tolist()):
            one = {key: value[i : i + 1] for key, value in theta.items()}
            where, target = (batch[key][i : i + 1, :, : int(count)] for key in ("where", "target"))
            slope = slope_of(target.expm1() / where[:, 6:].clamp_min(1e-4), where)
            errors.append(expected_errors(Posterior.of(one, where, slope)))
        expected = {name: self.scale * torch.tensor([one[name] for one in errors]) for name in errors[0]}
        return super().errors(theta, tasks) | expected


def few_of(data: Params, rng: Generator) -> Params:
    """Few samples, `count` [T], among the first SEEN_SAMPLES.

    In half of the materials with noise; in a third none beyond an angle; in half of them crowded around
    theta_h = 0, as planned ones are.
    """
    where, target = data["where"].clone(), data["target"].clone()
    count, half = len(where), where.shape[1] // 2

    seen = within_reach(where[:, :half], rng)
    # the density of theta_h where it is the power of what is uniform
    crowded = where[:, :half, 2].clamp(-1, 1).arccos().clamp_min(1e-2) ** (1 / POLAR - 1)
    wanted = torch.where(uniform(rng, count, 1) < 0.5, crowded, 1.0) * seen + 1e-9
    chosen = torch.multinomial(wanted, SEEN_SAMPLES, generator=rng)[..., None]
    level = torch.where(uniform(rng, count, 1) < NOISY, uniform(rng, count, 1), 0.0)[..., None]
    factor = torch.exp(MOST_NOISE * level * normal(rng, count, SEEN_SAMPLES, 3))
    where[:, :SEEN_SAMPLES] = where.gather(1, chosen.expand(-1, -1, 7))
    target[:, :SEEN_SAMPLES] = torch.log1p(torch.expm1(target.gather(1, chosen.expand(-1, -1, 3))) * factor)
    return {
        "where": where,
        "target": target,
        "count": (FEWEST_SAMPLES * (SEEN_SAMPLES / FEWEST_SAMPLES) ** uniform(rng, count, 1)[:, 0]).round(),
    }


# one solve of all samples, which may be noisy or lack grazing angles
FEW = replace(
    FULL,
    steps=1,
    batch=MOST_SAMPLES,
    meta={
        "ridge": replace(
            RIDGE,
            tasks=12,
            rates=RIDGE.rates | {f"encoder.encoder.{own}": 1e-2 for own in ("last", "deviation", "noise")},
            validate_every=1000,
            app=FewSamples(),
        )
    },
)
