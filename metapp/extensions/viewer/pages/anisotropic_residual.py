"""The residual of anisotropic samples beyond a fit, on a smooth grid of four coordinates for the page's shader.

The coordinates have no pole at the normal, where the azimuth of the half vector means nothing: the half vector is a
place on a disc, and the difference vector's azimuth is counted from the material's axes, phi_h + phi_d. By reciprocity
the latter has the period pi.
"""

from __future__ import annotations

import functools
import itertools
import math

import numpy as np
import torch
from scipy import sparse
from scipy.sparse.linalg import cg
from torch import Tensor
from torch.nn.functional import pad

RESIDUAL_GRID_CELLS = (40, 40, 8, 12)  # of the disc along and across the axes, phi_h + phi_d, and theta_d
PERIODIC_AXIS = 2  # the axis of an azimuth
BEND_WEIGHT, SHRINK_WEIGHT = (
    0.01,
    3e-4,
)  # weights of squared second differences and of squares beside those of the samples' errors
CG_STEPS = 40  # of conjugate gradients; more change little
ROUNDING_STEPS_PER_UNIT = 1024  # steps of 1/1024 deflate to a third of the bytes
MAX_RESIDUAL_SAMPLES = 1 << 18  # samples, which come in random order


def fit_residual_grid(angles: Tensor, values: Tensor, turn: float) -> Tensor:
    """A grid [*CELLS, 4], float16, that interpolates smoothly between values: a penalised least-squares spline.

    Args:
        angles: theta_h, theta_d, phi_d and phi_h, [N, 4] in rad.
        values: [N, 3].
        turn: azimuth of the material's axes in rad.
    """
    at = interpolation_matrix(angles, turn)
    back = at.T.tocsr()
    normal = back @ at + penalty_matrix()
    right, scale = back @ values.float().numpy(), sparse.diags_array(1 / normal.diagonal())
    columns = [cg(normal, column, rtol=0.0, maxiter=CG_STEPS, M=scale)[0] for column in right.T]
    grid = torch.from_numpy(np.stack(columns, 1)).reshape(*RESIDUAL_GRID_CELLS, 3)
    rounded = (grid * ROUNDING_STEPS_PER_UNIT).round() / ROUNDING_STEPS_PER_UNIT
    return pad(torch.where(reachable_cells()[..., None], rounded, 0.0), (0, 1)).half()


@functools.cache
def penalty_matrix() -> sparse.csr_array:
    """The matrix [cells, cells] of the weighted sum of squared second differences along each axis and of squares."""
    total = SHRINK_WEIGHT * sparse.eye_array(math.prod(RESIDUAL_GRID_CELLS), dtype=np.float32)
    for axis, count in enumerate(RESIDUAL_GRID_CELLS):
        second = sparse.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(count - 2, count))
        if axis == PERIODIC_AXIS:
            unit = np.eye(count)
            second = sparse.csr_array(np.roll(unit, 1, 0) + np.roll(unit, -1, 0) - 2 * unit)
        before, after = (
            sparse.eye_array(math.prod(sizes))
            for sizes in (RESIDUAL_GRID_CELLS[:axis], RESIDUAL_GRID_CELLS[axis + 1 :])
        )
        total = total + BEND_WEIGHT * sparse.kron(sparse.kron(before, second.T @ second), after)
    return sparse.csr_array(total.astype(np.float32))


@functools.cache
def reachable_cells() -> Tensor:
    """Cells, bool [*CELLS], that any two directions above the horizon may touch, and some more: others may be 0.

    Both are above it where tan theta_h tan theta_d |cos phi_d| < 1, here at the least one within a cell of the centre.
    """
    x, y, azimuth, grazing = torch.meshgrid(
        *((torch.arange(count) + 0.5) / count for count in RESIDUAL_GRID_CELLS), indexing="ij"
    )
    x, y, aside = 2 * x - 1, 2 * y - 1, math.sqrt(2) * 2 / RESIDUAL_GRID_CELLS[0]
    radius = torch.hypot(x, y)
    theta_h = (radius - aside).clamp_min(0).square() * (math.pi / 2)
    theta_d = (1 - (1 - (grazing - 1 / RESIDUAL_GRID_CELLS[3]).clamp_min(0)).square()) * (math.pi / 2)
    phi_d = (math.pi * azimuth - torch.atan2(y, x)) % math.pi
    across = (phi_d - math.pi / 2).abs() - math.pi / RESIDUAL_GRID_CELLS[2] - (aside / radius).clamp_max(1).asin()
    return (radius < 1 + aside) & (theta_h.tan() * theta_d.tan() * across.clamp_min(0).sin() < 1)


def interpolation_matrix(angles: Tensor, turn: float) -> sparse.csr_array:
    """The matrix [N, cells] from a flat grid to samples at angles [N, 4] in rad, as the shader interpolates."""
    theta_h, theta_d, phi_d, phi_h = angles.float().unbind(1)
    azimuth = phi_h - turn
    # samples that are uniform in theta_h and phi_h are so on the disc; towards grazing angles cells are smaller
    radius = (theta_h / (math.pi / 2)).sqrt()
    grazing = (1 - theta_d / (math.pi / 2)).clamp_min(0).sqrt()
    shares = [(1 + radius * azimuth.cos()) / 2, (1 + radius * azimuth.sin()) / 2]
    shares += [(azimuth + phi_d) / math.pi % 1, 1 - grazing]
    places = torch.stack(shares, 1) * angles.new_tensor(RESIDUAL_GRID_CELLS, dtype=torch.float32) - 0.5
    first = places.floor()
    cells, weights = [], []
    for corner in itertools.product((0, 1), repeat=len(RESIDUAL_GRID_CELLS)):
        cell = first + first.new_tensor(corner)
        weights.append((1 - (places - cell).abs()).prod(1))
        index = torch.zeros_like(cell[:, 0], dtype=torch.int32)
        for axis, (count, column) in enumerate(zip(RESIDUAL_GRID_CELLS, cell.int().unbind(1), strict=True)):
            index = index * count + (column % count if axis == PERIODIC_AXIS else column.clamp(0, count - 1))
        cells.append(index)
    parts = (torch.stack(each, 1).numpy().ravel() for each in (weights, cells))
    ends = np.arange(len(angles) + 1, dtype=np.int32) * len(cells)
    return sparse.csr_array((*parts, ends), shape=(len(angles), math.prod(RESIDUAL_GRID_CELLS)))
