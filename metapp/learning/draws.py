"""Random tensors, on the device of their generator."""

from __future__ import annotations

import torch
from torch import Generator, Tensor


def uniform(rng: Generator, *shape: int) -> Tensor:
    """Numbers evenly in [0, 1), of a shape."""
    return torch.rand(shape, generator=rng, device=rng.device)


def normal(rng: Generator, *shape: int) -> Tensor:
    """Standard normal numbers, of a shape."""
    return torch.randn(shape, generator=rng, device=rng.device)
