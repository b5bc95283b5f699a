"""Data augmentation of BRDFs: mixtures of materials, and samples as measurements have them."""

from __future__ import annotations

import math

import torch
from torch import Generator, Tensor

from metapp.appearance.geometry import outgoing_cosine
from metapp.appearance.noise import factors, standing_in
from metapp.learning.task import Params, Tasks

SAMPLES = 8192
# shares of the materials that are noisy and that lack grazing samples; the most noise and outliers, as of
# `appearance.noise.factors`; the least and greatest angle that is measured
NOISY, CUT = 1 / 2, 1 / 3
NOISE, OUTLIERS, MEASURED_RAD = 0.25, 0.02, (math.radians(60), math.radians(85))


def mixed(tasks: Tasks, rng: Generator) -> Params:
    """Mixtures of two of these materials, channels permuted and scaled: `where`, `target` at SAMPLES samples each.

    Mixing needs both materials at the same angles; where a data set has them at its own for each, they are only
    permuted and scaled.
    """
    count, device = len(tasks), rng.device
    where, target = tasks.data["where"], tasks.data["target"]
    columns = torch.randint(where.shape[1], (SAMPLES,), generator=rng, device=device)
    mine = torch.expm1(target[tasks.rows[:, None], columns])
    if where.stride(0) == 0:
        other = tasks.rows[torch.randint(count, (count, 1), generator=rng, device=device)]
        share = 2 * torch.rand(count, 1, 1, generator=rng, device=device)
        mine = torch.lerp(torch.expm1(target[other, columns]), mine, share.clamp(max=1))
    channels = torch.rand(count, 1, 3, generator=rng, device=device).argsort(-1).expand_as(mine)
    gain = torch.exp(0.3 * torch.randn(count, 1, 3, generator=rng, device=device))
    gain = gain * torch.exp(0.3 * torch.randn(count, 1, 1, generator=rng, device=device))
    return {"where": where[tasks.rows[:, None], columns], "target": torch.log1p(mine.gather(2, channels) * gain)}


def measured(data: Params, rng: Generator) -> Params:
    """Materials [T, N, ...] of which the first half of the samples, which fits see, is as measurements are."""
    where, target = data["where"], data["target"]
    count, half = len(where), where.shape[1] // 2

    def uniform() -> Tensor:
        return torch.rand(count, 1, 1, generator=rng, device=rng.device)

    level = torch.where(uniform() < NOISY, uniform(), 0.0)
    factor = factors(rng, (count, half), NOISE * level, OUTLIERS * level)
    rows = standing_in(rng, within_reach(where[:, :half], rng))[..., None]
    visible = {"where": where[:, :half], "target": torch.log1p(torch.expm1(target[:, :half]) * factor)}
    kept = {key: value.gather(1, rows.expand_as(value)) for key, value in visible.items()}
    return {key: torch.cat([value, data[key][:, half:]], 1) for key, value in kept.items()}


def within_reach(where: Tensor, rng: Generator) -> Tensor:
    """Which samples [T, N, 7] an instrument sees, bool [T, N]: of a share of materials none beyond an angle."""

    def uniform() -> Tensor:
        return torch.rand(len(where), 1, generator=rng, device=rng.device)

    low, high = MEASURED_RAD
    limit = torch.where(uniform() < CUT, torch.cos(low + (high - low) * uniform()), 0.0)
    return torch.minimum(where[..., 6], outgoing_cosine(where.transpose(1, 2))) >= limit
