"""Surfaces under a map, whose light losses compare."""

from __future__ import annotations

import functools
import math

import torch
from torch import Tensor
from torch.nn.functional import normalize

from metapp.appearance import latlong, reflection
from metapp.appearance.latlong import cosine_transfer, glossy_transfer
from metapp.storage.cache import cached_tensors

FACED, MIRRORED, SHINE = 64, 128, 0.35  # surfaces that the loss looks at: diffuse, glossy and how rough


@functools.lru_cache(maxsize=4)
def surfaces(height: int, width: int, device: torch.device) -> Tensor:
    """Transport of light to surfaces [FACED + MIRRORED, height * width], evenly spread: facing, then mirroring."""
    name, sources = f"surfaces-{height}x{width}", (__file__, latlong.__file__, reflection.__file__)
    return cached_tensors(name, sources, lambda: {"sent": _surfaces(height, width)})["sent"].to(device)


def _surfaces(height: int, width: int) -> Tensor:
    middle = normalize(_spread(MIRRORED) + torch.tensor([0.0, 0.0, 1.0]), dim=1)  # between them and the viewer
    # a few at a time stay near the processor, a third of the time
    glossy = [glossy_transfer(each, SHINE, height, width, samples=2) for each in middle.split(8)]
    return torch.cat([cosine_transfer(_spread(FACED), height, width), *glossy])


def _spread(count: int) -> Tensor:
    """Evenly spread directions [count, 3]: a Fibonacci lattice."""
    i = torch.arange(count) + 0.5
    y, phi = 1 - 2 * i / count, i * (math.pi * (1 + math.sqrt(5)))
    radius = (1 - y * y).sqrt()
    return torch.stack([radius * phi.sin(), y, -radius * phi.cos()], 1)
