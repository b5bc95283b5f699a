"""A field: a network of a few units that is evaluated at each texel, and whose code varies from place to place."""

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

# Texels that are evaluated at a time: 32 channels take 16 MB, memory that the next rows get again, still mapped.
STRIP_TEXELS = 2**17


class LocalField(NamedTuple):
    """A SIREN (Sitzmann et al. 2020) whose layers are shifted by a code that varies from place to place.

    The code lies on a grid and is interpolated between the centres of its cells: shift modulations (Dupont et al.
    2022) that are local (Mehta et al. 2021). A detail then moves a few entries of the code, not all weights at once,
    which is why few gradient steps fit it.

    Attributes:
        height, width: the size of its output, in texels.
        inputs, outputs: the numbers of channels that it reads and makes.
        rows, columns: the size of the code's grid, in cells.
        code: the length of the code in a cell.
        hidden: the number of units of a layer.
        layers: the number of layers with sines.
        frequency: the frequency of the first layer's sines for inputs in [-1, 1] (omega_0 in the paper).
        periodic: whether the left edge goes on at the right one.
        gain: the factor of the parameter z to the code. At one rate, a step moves the code so many times as far as a
            weight, as the code has far to go.
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
        """Draw random parameters of `count` networks, each tensor [count, ...]."""

        def draw_within(bound: float, *shape: int) -> Tensor:
            return (2 * draw_uniform(rng, count, *shape) - 1) * bound

        theta = {"z": draw_within(0.1 / self.gain, self.code, self.rows, self.columns)}
        for layer in range(self.layers):
            inputs = self.hidden if layer else self.inputs
            bound = math.sqrt(6 / inputs) if layer else self.frequency / math.sqrt(inputs)
            theta[f"layer{layer}.kernel"] = draw_within(bound, self.hidden, inputs)
            theta[f"layer{layer}.code"] = draw_within(1.5 / math.sqrt(self.code), self.hidden, self.code)
            theta[f"layer{layer}.shift"] = draw_within(0.1 if layer else math.pi, self.hidden)
        theta["out.kernel"] = draw_within(1 / math.sqrt(self.hidden), self.outputs, self.hidden)
        theta["out.code"] = draw_within(1 / math.sqrt(self.code), self.outputs, self.code)
        theta["out.shift"] = torch.zeros(count, self.outputs, device=rng.device)
        return theta

    def __call__(self, theta: Params, places: Tensor) -> Tensor:
        """Evaluate the field at every texel.

        Args:
            theta: the parameters of T networks, which :meth:`init` draws.
            places: the inputs of the texels, [T, inputs, height, width].

        Returns:
            Values before any range is imposed, [T, outputs, height, width].
        """
        return self.evaluate(theta, self.interpolate_code(theta, 0, self.height), places)

    def resize(self, z: Tensor, places: Tensor) -> LocalField:
        """Return the field with the grid of codes z [T, code, r, c] and the size of places [T, inputs, h, w]."""
        (rows, columns), (height, width) = z.shape[-2:], places.shape[-2:]
        return self._replace(rows=rows, columns=columns, height=height, width=width)

    def interpolate_code(self, theta: Params, first: int, end: int) -> Tensor:
        """Interpolate the code to the texels of rows `first` to `end` - 1: [T, code, end - first, width]."""
        z = self.gain * theta["z"]
        if (self.rows, self.columns) == (self.height, self.width):
            return z[:, :, first:end]  # what interpolation returns, bit by bit
        row_weights, column_weights = (weights.to(z) for weights in _code_weights(self, z.device))
        return row_weights[first:end] @ z @ column_weights

    def evaluate(self, theta: Params, code: Tensor, places: Tensor) -> Tensor:
        """Evaluate the field at texels whose code is given.

        Args:
            theta: the parameters of T networks.
            code: the code of each texel, [T, code, h, w].
            places: the inputs of the texels, [T, inputs, h, w].

        Returns:
            Values before any range is imposed, [T, outputs, h, w].
        """
        size, code, x = places.shape[2:], code.flatten(2), places.flatten(2)
        for name in (*(f"layer{layer}" for layer in range(self.layers)), "out"):
            shift = torch.baddbmm(theta[f"{name}.shift"][..., None], theta[f"{name}.code"], code)
            x = shift.baddbmm_(theta[f"{name}.kernel"], x)  # in place: a copy takes as long as the product
            x = x if name == "out" else x.sin()
        result: Tensor = x.unflatten(2, size)
        return result


def regrid(values: Tensor, rows: int, columns: int, *, periodic: bool) -> Tensor:
    """Interpolate values [..., r, c] at the centres of a grid's cells linearly to the cells of another grid.

    Args:
        values: a value for each cell.
        rows, columns: the size of the other grid.
        periodic: whether the last column goes on at the first.

    Returns:
        Values [..., rows, columns].
    """
    if values.shape[-2:] == (rows, columns):
        return values
    row_weights = _linear_weights(rows, values.shape[-2], periodic=False).to(values)
    return row_weights @ values @ _linear_weights(columns, values.shape[-1], periodic=periodic).T.to(values)


@functools.lru_cache(maxsize=8)
def _code_weights(field: LocalField, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return the weights of the code's rows in rows of texels, [height, rows], and of its columns, [columns, width]."""
    row_weights = _linear_weights(field.height, field.rows, periodic=False)
    column_weights = _linear_weights(field.width, field.columns, periodic=field.periodic).T.contiguous()
    return row_weights.to(device), column_weights.to(device)


def _linear_weights(count: int, cells: int, *, periodic: bool) -> Tensor:
    """Return the weights [count, cells] of linear interpolation between cells, at the centres of `count` equal parts.

    Beyond the centres of the first and the last cell, the other end goes on if cells are periodic; else the nearest
    cell counts alone.
    """
    centres = (torch.arange(count) + 0.5) * (cells / count) - 0.5
    cells_before = centres.floor().long()
    weights = torch.zeros(count, cells)
    for cell, share in ((cells_before, 1 - (centres - cells_before)), (cells_before + 1, centres - cells_before)):
        cell = cell % cells if periodic else cell.clamp(0, cells - 1)
        weights.scatter_add_(1, cell[:, None], share[:, None])
    return weights


def evaluate_by_rows(field: LocalField, theta: Params, places: Tensor, texels: int = STRIP_TEXELS) -> Iterator[Tensor]:
    """Yield the output of a field from the top, some rows [T, outputs, h, width] at a time.

    Args:
        field: the field.
        theta: the parameters of T networks.
        places: the inputs of all texels, [T, inputs, height, width].
        texels: about how many texels are evaluated at a time.
    """
    rows, field_of_cells = max(1, texels // field.width), field._replace(width=field.columns)
    for first in range(0, field.height, rows):
        end = first + rows
        if field.periodic:
            code = field.interpolate_code(theta, first, end)
        else:  # between two cells: a product with all cells of a row takes as long as the network
            code = field_of_cells.interpolate_code(theta, first, end).flatten(0, 1)
            code = interpolate(code, field.width, mode="linear").unflatten(0, theta["z"].shape[:2])
        yield field.evaluate(theta, code, places[..., first:end, :])
