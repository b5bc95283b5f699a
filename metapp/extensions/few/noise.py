"""Measurement errors of reflectance: noise and outliers; angles that an instrument does not reach."""

from __future__ import annotations

import math

import torch
from torch import Generator, Tensor

from metapp.appearance.geometry import outgoing_cosine
from metapp.learning.draws import normal, uniform

DECADES = (0.5, 1.0)  # by which outliers are off, up or down
CUT = 1 / 3  # share of the materials that lack grazing samples
MEASURED_RAD = (math.radians(60), math.radians(85))  # the least and greatest angle that is measured


def factors(rng: Generator, shape: tuple[int, ...], noise: Tensor | float, outliers: Tensor | float) -> Tensor:
    """Factors [*shape, 3] by which measured reflectance is off.

    Args:
        rng: of all draws.
        shape: of the samples.
        noise: standard deviation of the logarithm of a channel's factor, such as 0.05 for about 5 %; broadcasts.
        outliers: share of samples that are off by DECADES, all channels alike; broadcasts.
    """
    factor = torch.exp(noise * normal(rng, *shape, 3))
    low, high = DECADES
    decades = low + (high - low) * uniform(rng, *shape, 1)
    decades = decades * (2 * torch.randint(2, (*shape, 1), generator=rng, device=rng.device) - 1)
    return factor * torch.where(uniform(rng, *shape, 1) < outliers, 10**decades, 1.0)


def within_reach(where: Tensor, rng: Generator) -> Tensor:
    """Which samples [T, N, 7] an instrument sees, bool [T, N]: of a share of materials none beyond an angle."""
    low, high = MEASURED_RAD
    chance, share = uniform(rng, len(where), 1), uniform(rng, len(where), 1)
    limit = torch.where(chance < CUT, torch.cos(low + (high - low) * share), 0.0)
    return torch.minimum(where[..., 6], outgoing_cosine(where.transpose(1, 2))) >= limit
