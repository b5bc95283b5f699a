"""What measurements of reflectance have and models have not: noise, outliers, missing samples at grazing angles."""

from __future__ import annotations

import torch
from torch import Generator, Tensor

DECADES = (0.5, 1.0)  # that an outlier is off, up or down


def factors(rng: Generator, shape: tuple[int, ...], noise: Tensor | float, outliers: Tensor | float) -> Tensor:
    """What measurement multiplies reflectance by, [*shape, 3].

    Args:
        rng: of all draws.
        shape: of the samples.
        noise: standard deviation of the logarithm of a channel's factor, such as 0.05 for about 5 %; broadcasts.
        outliers: share of samples that are off by DECADES, all channels alike; broadcasts.
    """

    def uniform() -> Tensor:
        return torch.rand(*shape, 1, generator=rng, device=rng.device)

    factor = torch.exp(noise * torch.randn(*shape, 3, generator=rng, device=rng.device))
    low, high = DECADES
    decades = low + (high - low) * uniform()
    decades = decades * (2 * torch.randint(2, (*shape, 1), generator=rng, device=rng.device) - 1)
    return factor * torch.where(uniform() < outliers, 10**decades, 1.0)


def standing_in(rng: Generator, seen: Tensor) -> Tensor:
    """Which sample stands in for each: itself where it is seen, else one that is, drawn at random.

    Args:
        rng: of all draws.
        seen: bool [T, N], at least one of each row.

    Returns:
        Indices [T, N].
    """
    others = torch.multinomial(seen.float(), seen.shape[1], replacement=True, generator=rng)
    return torch.where(seen, torch.arange(seen.shape[1], device=seen.device), others)
