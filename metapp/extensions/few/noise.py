"""Measurement errors of reflectance: noise and outliers."""

from __future__ import annotations

import torch
from torch import Generator, Tensor

from metapp.learning.draws import normal, uniform

DECADES = (0.5, 1.0)  # by which outliers are off, up or down


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
