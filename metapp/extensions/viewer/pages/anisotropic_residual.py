"""The residual of anisotropic samples beyond a fit, on a smooth grid of four coordinates for the page's shader.

The coordinates have no pole at the normal, where the azimuth of the half vector means nothing: the half vector is a
place on a disc, and the difference vector's azimuth is counted from the material's axes, phi_h + phi_d. By reciprocity
the latter has the period pi.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import embedding_bag, pad

CELLS = (40, 40, 8, 12)  # of the disc along and across the axes, phi_h + phi_d, and theta_d
PERIODIC = 2  # the axis of an azimuth
BEND, SHRINK = 0.01, 3e-4  # weights of squared second differences and of squares beside those of the samples' errors
STEPS = 40  # of conjugate gradients; more change little
ROUNDED = 1024  # steps of 1/1024 deflate to a third of the bytes
MOST = 1 << 18  # samples, which come in random order


class Corners(NamedTuple):
    """The cells about samples [N, 16], and their shares in what is interpolated there, which add up to 1."""

    cells: Tensor
    shares: Tensor


def gridded(angles: Tensor, values: Tensor, turn: float) -> Tensor:
    """A grid [*CELLS, 4], float16, that interpolates smoothly between values: a penalised least-squares spline.

    Args:
        angles: theta_h, theta_d, phi_d and phi_h, [N, 4] in rad.
        values: [N, 3].
        turn: azimuth of the material's axes in rad.
    """
    places = corners(angles, turn)
    at, back = _interpolation(places)
    squares = torch.zeros(math.prod(CELLS)).index_add_(0, places.cells.flatten(), places.shares.flatten().square())
    most = squares[:, None] + SHRINK + 6 * BEND * len(CELLS)
    grid = solved(lambda grid: back(at(grid)) + _bending(grid), back(values.float()), most, STEPS)
    rounded = (grid.reshape(*CELLS, 3) * ROUNDED).round() / ROUNDED
    return pad(torch.where(reached()[..., None], rounded, 0.0), (0, 1)).half()


@functools.cache
def reached() -> Tensor:
    """Cells, bool [*CELLS], that any two directions above the horizon may touch, and some more: others may be 0.

    Both are above it where tan theta_h tan theta_d |cos phi_d| < 1, here at what is least within a cell of the centre.
    """
    x, y, azimuth, grazing = torch.meshgrid(*((torch.arange(count) + 0.5) / count for count in CELLS), indexing="ij")
    x, y, aside = 2 * x - 1, 2 * y - 1, math.sqrt(2) * 2 / CELLS[0]
    radius = torch.hypot(x, y)
    theta_h = (radius - aside).clamp_min(0).square() * (math.pi / 2)
    theta_d = (1 - (1 - (grazing - 1 / CELLS[3]).clamp_min(0)).square()) * (math.pi / 2)
    phi_d = (math.pi * azimuth - torch.atan2(y, x)) % math.pi
    across = (phi_d - math.pi / 2).abs() - math.pi / CELLS[2] - (aside / radius).clamp_max(1).asin()
    return (radius < 1 + aside) & (theta_h.tan() * theta_d.tan() * across.clamp_min(0).sin() < 1)


def corners(angles: Tensor, turn: float) -> Corners:
    """Where samples lie between the centres of cells, as the shader finds it; angles [N, 4] in rad."""
    theta_h, theta_d, phi_d, phi_h = angles.float().unbind(1)
    azimuth = phi_h - turn
    # samples that are uniform in theta_h and phi_h are so on the disc; towards grazing angles cells are smaller
    radius = (theta_h / (math.pi / 2)).sqrt()
    grazing = (1 - theta_d / (math.pi / 2)).clamp_min(0).sqrt()
    shares = [(1 + radius * azimuth.cos()) / 2, (1 + radius * azimuth.sin()) / 2]
    shares += [(azimuth + phi_d) / math.pi % 1, 1 - grazing]
    places = torch.stack(shares, 1) * angles.new_tensor(CELLS, dtype=torch.float32) - 0.5
    first = places.floor()
    cells, weights = [], []
    for corner in itertools.product((0, 1), repeat=len(CELLS)):
        cell = first + first.new_tensor(corner)
        weights.append((1 - (places - cell).abs()).prod(1))
        cells.append(_index(cell.long()))
    return Corners(torch.stack(cells, 1), torch.stack(weights, 1))


def _index(cell: Tensor) -> Tensor:
    """The place [N] in a flat grid of cells [N, 4], which at its borders go on as the last ones."""
    index = torch.zeros_like(cell[:, 0])
    for axis, (count, column) in enumerate(zip(CELLS, cell.unbind(1), strict=True)):
        index = index * count + (column % count if axis == PERIODIC else column.clamp(0, count - 1))
    return index


Map = Callable[[Tensor], Tensor]


def _interpolation(places: Corners) -> tuple[Map, Map]:
    """Values at samples [N, 3] of a grid [cells, 3], and the transposed map."""
    flat = places.cells.flatten()
    order = flat.argsort(stable=True)
    rows, shares = order // places.cells.shape[1], places.shares.flatten()[order]
    counts = torch.bincount(flat, minlength=math.prod(CELLS))
    starts = counts.cumsum(0) - counts

    def at(grid: Tensor) -> Tensor:
        return embedding_bag(places.cells, grid, per_sample_weights=places.shares, mode="sum")

    def back(values: Tensor) -> Tensor:
        return embedding_bag(rows, values, starts, per_sample_weights=shares, mode="sum")

    return at, back


def _bending(grid: Tensor) -> Tensor:
    """Half the gradient of both penalties at a grid [cells, 3]."""
    cells = grid.reshape(*CELLS, 3)
    total = SHRINK * cells
    for axis in range(len(CELLS)):
        if axis == PERIODIC:
            bent = _second_difference(_second_difference(cells, axis), axis)
        else:
            lines = cells.movedim(axis, -1)
            bent = pad(lines.diff(n=2), (2, 2)).diff(n=2).movedim(-1, axis)
        total = total + BEND * bent
    return total.reshape(-1, 3)


def _second_difference(cells: Tensor, axis: int) -> Tensor:
    return cells.roll(1, axis) + cells.roll(-1, axis) - 2 * cells


def solved(matrix: Map, right: Tensor, diagonal: Tensor, steps: int) -> Tensor:
    """An approximate solution of a symmetric positive definite system by conjugate gradients, scaled by a diagonal."""
    solution, rest = torch.zeros_like(right), right.clone()
    scaled = rest / diagonal
    direction, product = scaled, (rest * scaled).sum()
    for _ in range(steps):
        image = matrix(direction)
        step = product / (direction * image).sum().clamp_min(1e-30)
        solution, rest = solution + step * direction, rest - step * image
        scaled = rest / diagonal
        before, product = product, (rest * scaled).sum()
        direction = scaled + product / before.clamp_min(1e-30) * direction
    return solution
