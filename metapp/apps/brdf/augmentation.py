"""Data augmentation of BRDFs: mixtures of materials, instruments that do not reach grazing angles."""

from __future__ import annotations

import math

import torch
from torch import Generator, Tensor

from metapp.appearance.geometry import outgoing_cosine
from metapp.learning.draws import normal, uniform
from metapp.learning.task import Params, Tasks

SAMPLES = 8192
CUT = 1 / 3  # share of the materials that lack grazing samples
MEASURED_RAD = (math.radians(60), math.radians(85))  # the least and greatest angle that is measured


def mixed(tasks: Tasks, rng: Generator) -> Params:
    """Mixtures of two of these materials, channels permuted and scaled: `where`, `target` at SAMPLES samples each.

    Mixing needs both materials at the same angles; if a data set has them at its own for each, they are only
    permuted and scaled.
    """
    count, device = len(tasks), rng.device
    where, target = tasks.data["where"], tasks.data["target"]
    columns = torch.randint(where.shape[1], (SAMPLES,), generator=rng, device=device)
    mine = torch.expm1(target[tasks.rows[:, None], columns])
    if where.stride(0) == 0:
        other = tasks.rows[torch.randint(count, (count, 1), generator=rng, device=device)]
        share = 2 * uniform(rng, count, 1, 1)
        mine = torch.lerp(torch.expm1(target[other, columns]), mine, share.clamp(max=1))
    channels = uniform(rng, count, 1, 3).argsort(-1).expand_as(mine)
    gain = torch.exp(0.3 * normal(rng, count, 1, 3))
    gain = gain * torch.exp(0.3 * normal(rng, count, 1, 1))
    return {"where": where[tasks.rows[:, None], columns], "target": torch.log1p(mine.gather(2, channels) * gain)}


def within_reach(where: Tensor, rng: Generator) -> Tensor:
    """Which samples [T, N, 7] an instrument sees, bool [T, N]: of a share of materials none beyond an angle."""
    low, high = MEASURED_RAD
    chance, share = uniform(rng, len(where), 1), uniform(rng, len(where), 1)
    limit = torch.where(chance < CUT, torch.cos(low + (high - low) * share), 0.0)
    return torch.minimum(where[..., 6], outgoing_cosine(where.transpose(1, 2))) >= limit
