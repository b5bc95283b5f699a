"""Fields with a code in every place."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterator
from typing import NamedTuple

import torch
from torch import Generator, Tensor
from torch.nn.functional import interpolate

from metapp.learning.random_tensors import draw_uniform
from metapp.learning.task import Params

STRIP_TEXELS = 2**17  # evaluated at a time: 16 MB of 32 channels, which the next rows get again, still mapped


class LocalField(NamedTuple):
    """A SIREN (Sitzmann et al. 2020) whose layers are shifted by a code that varies from place to place.

    The code lies on a grid and is interpolated between its cells: shift modulations as of Dupont et al. 2022, made
    local as of Mehta et al. 2021. A detail then moves a few entries of the code, not all weights at once, which is why
    few steps fit it.

    Attributes:
        height, width: texels of its output.
        inputs, outputs: channels.
        rows, columns: cells of the code's grid.
        code: length of the code in a cell.
        hidden: units of a layer.
        layers: sine layers.
        frequency: of the first layer's sines for inputs in [-1, 1], w0.
        periodic: whether the left edge goes on at the right one.
        gain: of the code; a step of a rate moves it so many times as far as a weight, and it has far to go.
    """

    height: int
    width: int
    inputs: int = 3
    outputs: int = 3
    rows: int = 16
    columns: int = 32
    code: int = 8
    hidden: int = 32
    layers: int = 3
    frequency: float = 12.0
    periodic: bool = True
    gain: float = 30.0

    def init(self, rng: Generator, count: int) -> Params:
        """Random parameters of `count` networks: each tensor [count, ...]."""

        def within(bound: float, *shape: int) -> Tensor:
            return (2 * draw_uniform(rng, count, *shape) - 1) * bound

        theta = {"z": within(0.1 / self.gain, self.code, self.rows, self.columns)}
        for layer in range(self.layers):
            inputs = self.hidden if layer else self.inputs
            bound = math.sqrt(6 / inputs) if layer else self.frequency / math.sqrt(inputs)
            theta[f"layer{layer}.kernel"] = within(bound, self.hidden, inputs)
            theta[f"layer{layer}.code"] = within(1.5 / math.sqrt(self.code), self.hidden, self.code)
            theta[f"layer{layer}.shift"] = within(0.1 if layer else math.pi, self.hidden)
        theta["out.kernel"] = within(1 / math.sqrt(self.hidden), self.outputs, self.hidden)
        theta["out.code"] = within(1 / math.sqrt(self.code), self.outputs, self.code)
        theta["out.shift"] = torch.zeros(count, self.outputs, device=rng.device)
        return theta

    def __call__(self, theta: Params, places: Tensor) -> Tensor:
        """Evaluate the field at every texel.

        Args:
            theta: parameters of T networks, as of `init`.
            places: inputs of the texels, [T, inputs, height, width].

        Returns:
            Values before any range is imposed, [T, outputs, height, width].
        """
        return self.decoded(theta, self.code_at(theta, 0, self.height), places)

    def code_at(self, theta: Params, first: int, end: int) -> Tensor:
        """The code at the texels of some rows, [T, code, end - first, width]."""
        z = self.gain * theta["z"]
        if (self.rows, self.columns) == (self.height, self.width):
            return z[:, :, first:end]  # as interpolation has it, bit by bit
        down, across = (each.to(z) for each in _interpolation(self, z.device))
        return down[first:end] @ z @ across

    def decoded(self, theta: Params, code: Tensor, places: Tensor) -> Tensor:
        """Evaluate texels with a code [T, code, h, w] and `places` [T, inputs, h, w]: [T, outputs, h, w]."""
        size, code, x = places.shape[2:], code.flatten(2), places.flatten(2)
        for name in (*(f"layer{layer}" for layer in range(self.layers)), "out"):
            shifted = torch.baddbmm(theta[f"{name}.shift"][..., None], theta[f"{name}.code"], code)
            x = shifted.baddbmm_(theta[f"{name}.kernel"], x)  # in place: to copy it takes as long as the product
            x = x if name == "out" else x.sin()
        result: Tensor = x.unflatten(2, size)
        return result


def regrid(values: Tensor, rows: int, columns: int, *, periodic: bool) -> Tensor:
    """Values [..., r, c] of a grid on a finer one, [..., rows, columns], linear between the cells' centres."""
    if values.shape[-2:] == (rows, columns):
        return values
    down = _linear(rows, values.shape[-2], periodic=False).to(values)
    return down @ values @ _linear(columns, values.shape[-1], periodic=periodic).T.to(values)


@functools.lru_cache(maxsize=8)
def _interpolation(field: LocalField, device: torch.device) -> tuple[Tensor, Tensor]:
    """The weights of the code's rows and columns in each row and column: [height, rows] and [columns, width]."""
    down = _linear(field.height, field.rows, periodic=False)
    across = _linear(field.width, field.columns, periodic=field.periodic).T.contiguous()
    return down.to(device), across.to(device)


def _linear(count: int, cells: int, *, periodic: bool) -> Tensor:
    """Linear interpolation at `count` centres between those of `cells`, [count, cells]; around or up to the ends."""
    place = (torch.arange(count) + 0.5) * (cells / count) - 0.5
    first = place.floor().long()
    weights = torch.zeros(count, cells)
    for cell, share in ((first, 1 - (place - first)), (first + 1, place - first)):
        cell = cell % cells if periodic else cell.clamp(0, cells - 1)
        weights.scatter_add_(1, cell[:, None], share[:, None])
    return weights


def evaluate_by_rows(field: LocalField, theta: Params, places: Tensor, texels: int = STRIP_TEXELS) -> Iterator[Tensor]:
    """Yield the rows of a field's output, [T, outputs, h, width] at a time, from the top.

    Args:
        field: the field.
        theta: its parameters.
        places: inputs [T, inputs, height, width].
        texels: how many are evaluated at a time, about.
    """
    rows, narrow = max(1, texels // field.width), field._replace(width=field.columns)
    for first in range(0, field.height, rows):
        end = first + rows
        if field.periodic:
            code = field.code_at(theta, first, end)
        else:  # of two cells each: a product with all of a row takes as long as the network
            code = narrow.code_at(theta, first, end).flatten(0, 1)
            code = interpolate(code, field.width, mode="linear").unflatten(0, theta["z"].shape[:2])
        yield field.decoded(theta, code, places[..., first:end, :])
