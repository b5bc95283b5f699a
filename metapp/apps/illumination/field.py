"""The network of one map: directions to log radiance, a SIREN that a code shifts from place to place."""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import torch
from torch import Generator, Tensor

from metapp.latlong import directions
from metapp.task import Params


class Field(NamedTuple):
    """A SIREN over directions (Sitzmann et al. 2020) whose layers are shifted by a code that varies over the sphere.

    The code lies on a lat-long grid and is interpolated between its cells: shift modulations as of Dupont et al. 2022,
    made local as of Mehta et al. 2021. A light then moves a few entries of the code, not all weights at once, which is
    why few steps fit it.

    Attributes:
        height, width: texels of the maps that it is fitted to.
        hidden: units of a layer.
        layers: sine layers.
        rows, columns: cells of the code's grid.
        code: length of the code in a cell.
        frequency: of the first layer's sines, w0.
    """

    height: int
    width: int
    hidden: int = 32
    layers: int = 3
    rows: int = 16
    columns: int = 32
    code: int = 8
    frequency: float = 12.0

    def init(self, rng: Generator, count: int) -> Params:
        """Random parameters of `count` networks: each tensor [count, ...]."""

        def uniform(*shape: int, bound: float) -> Tensor:
            return (2 * torch.rand(count, *shape, generator=rng, device=rng.device) - 1) * bound

        theta = {"z": uniform(self.code, self.rows, self.columns, bound=0.1)}
        for layer in range(self.layers):
            inputs = self.hidden if layer else 3
            bound = math.sqrt(6 / inputs) if layer else self.frequency / math.sqrt(3)
            theta[f"layer{layer}.kernel"] = uniform(self.hidden, inputs, bound=bound)
            theta[f"layer{layer}.code"] = uniform(self.hidden, self.code, bound=1.5 / math.sqrt(self.code))
            theta[f"layer{layer}.shift"] = uniform(self.hidden, bound=0.1 if layer else math.pi)
        theta["out.kernel"] = uniform(3, self.hidden, bound=1 / math.sqrt(self.hidden))
        theta["out.code"] = uniform(3, self.code, bound=1 / math.sqrt(self.code))
        theta["out.shift"] = torch.full((count, 3), -0.5, device=rng.device)
        return theta

    def __call__(self, theta: Params) -> Tensor:
        """Log radiance [T, 3, height, width] at the texels' centres."""
        z = theta["z"]
        down, across = (each.to(z) for each in _interpolation(self))
        code = (down @ z @ across).flatten(2)
        x = directions(self.height, self.width, dtype=z.dtype, device=z.device).flatten(1).expand(len(z), -1, -1)
        for name in (*(f"layer{layer}" for layer in range(self.layers)), "out"):
            shifted = torch.baddbmm(theta[f"{name}.shift"][..., None], theta[f"{name}.code"], code)
            x = torch.baddbmm(shifted, theta[f"{name}.kernel"], x)
            x = x if name == "out" else x.sin()
        return x.unflatten(2, (self.height, self.width))


@functools.lru_cache(maxsize=8)
def _interpolation(field: Field) -> tuple[Tensor, Tensor]:
    """What each row and column of a map takes of those of the code: [height, rows] and [columns, width]."""
    down = _linear(field.height, field.rows, wraps=False)
    return down, _linear(field.width, field.columns, wraps=True).T.contiguous()


def _linear(count: int, cells: int, *, wraps: bool) -> Tensor:
    """Linear interpolation at `count` centres between those of `cells`, [count, cells]; around or up to the ends."""
    place = (torch.arange(count) + 0.5) * (cells / count) - 0.5
    first = place.floor().long()
    weights = torch.zeros(count, cells)
    for cell, share in ((first, 1 - (place - first)), (first + 1, place - first)):
        cell = cell % cells if wraps else cell.clamp(0, cells - 1)
        weights.scatter_add_(1, cell[:, None], share[:, None])
    return weights
