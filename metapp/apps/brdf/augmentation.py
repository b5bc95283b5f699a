"""Data augmentation of BRDFs: mixtures of materials."""

from __future__ import annotations

import torch
from torch import Generator

from metapp.learning.draws import normal, uniform
from metapp.learning.task import Params, Tasks

SAMPLES = 8192


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
        share = 2 * uniform(rng, count, 1, 1)
        mine = torch.lerp(torch.expm1(target[other, columns]), mine, share.clamp(max=1))
    channels = uniform(rng, count, 1, 3).argsort(-1).expand_as(mine)
    gain = torch.exp(0.3 * normal(rng, count, 1, 3))
    gain = gain * torch.exp(0.3 * normal(rng, count, 1, 1))
    return {"where": where[tasks.rows[:, None], columns], "target": torch.log1p(mine.gather(2, channels) * gain)}
