"""The residual of anisotropic samples after a fit, on a smooth grid of four coordinates for the page's shader.

The coordinates have no pole at the normal, where the azimuth of the half vector means nothing: the half vector is a
place on a disc, and the azimuth of the difference vector is counted from the material's axes, phi_h + phi_d. By
reciprocity this azimuth has the period pi. The shader of the page interpolates in the same coordinates.
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
# weights of squared second differences and of squares of the grid, where squared errors of samples have the weight 1
BEND_WEIGHT, SHRINK_WEIGHT = 0.01, 3e-4
CG_STEPS = 40  # of conjugate gradients; more steps change little
ROUNDING_STEPS_PER_UNIT = 1024  # rounded to 1/1024, a grid deflates to a third of the bytes
MAX_RESIDUAL_SAMPLES = 1 << 18  # the first of a task, whose samples are in random order


def fit_residual_grid(angles: Tensor, values: Tensor, axes_azimuth_rad: float) -> Tensor:
    """Fit a grid that interpolates smoothly between values: a penalised least-squares spline.

    Args:
        angles: theta_h, theta_d, phi_d and phi_h of the samples, [N, 4] in rad.
        values: values of three channels at the samples, [N, 3].
        axes_azimuth_rad: azimuth of the material's axes.

    Returns:
        The grid, [*RESIDUAL_GRID_CELLS, 4], float16; the fourth channel is 0, since textures have four.
    """
    interpolation = interpolation_matrix(angles, axes_azimuth_rad)
    transposed = interpolation.T.tocsr()
    normal_matrix = transposed @ interpolation + penalty_matrix()
    right_sides = transposed @ values.float().numpy()
    preconditioner = sparse.diags_array(1 / normal_matrix.diagonal())
    columns = [cg(normal_matrix, column, rtol=0.0, maxiter=CG_STEPS, M=preconditioner)[0] for column in right_sides.T]
    grid = torch.from_numpy(np.stack(columns, 1)).reshape(*RESIDUAL_GRID_CELLS, 3)
    rounded = (grid * ROUNDING_STEPS_PER_UNIT).round() / ROUNDING_STEPS_PER_UNIT
    return pad(torch.where(reachable_cells()[..., None], rounded, 0.0), (0, 1)).half()


@functools.cache
def penalty_matrix() -> sparse.csr_array:
    """Return the matrix [cells, cells] of the penalty: the weighted sum of squared second differences and of squares.

    Second differences are taken along each axis of the grid.
    """
    total = SHRINK_WEIGHT * sparse.eye_array(math.prod(RESIDUAL_GRID_CELLS), dtype=np.float32)
    for axis, count in enumerate(RESIDUAL_GRID_CELLS):
        second_difference = sparse.diags_array([1.0, -2.0, 1.0], offsets=[0, 1, 2], shape=(count - 2, count))
        if axis == PERIODIC_AXIS:
            unit = np.eye(count)
            second_difference = sparse.csr_array(np.roll(unit, 1, 0) + np.roll(unit, -1, 0) - 2 * unit)
        identity_before, identity_after = (
            sparse.eye_array(math.prod(sizes))
            for sizes in (RESIDUAL_GRID_CELLS[:axis], RESIDUAL_GRID_CELLS[axis + 1 :])
        )
        total = total + BEND_WEIGHT * sparse.kron(
            sparse.kron(identity_before, second_difference.T @ second_difference), identity_after
        )
    return sparse.csr_array(total.astype(np.float32))


@functools.cache
def reachable_cells() -> Tensor:
    """Return the cells that samples of any two directions above the horizon may touch, [*RESIDUAL_GRID_CELLS].

    Both directions are above the horizon where tan theta_h tan theta_d |cos phi_d| < 1. A cell counts if this holds for
    the least such product within a cell of its centre, so that some more cells count; all others may be 0.
    """
    x, y, azimuth, grazing = torch.meshgrid(
        *((torch.arange(count) + 0.5) / count for count in RESIDUAL_GRID_CELLS), indexing="ij"
    )
    x, y, cell_diagonal = 2 * x - 1, 2 * y - 1, math.sqrt(2) * 2 / RESIDUAL_GRID_CELLS[0]
    radius = torch.hypot(x, y)
    theta_h = (radius - cell_diagonal).clamp_min(0).square() * (math.pi / 2)
    theta_d = (1 - (1 - (grazing - 1 / RESIDUAL_GRID_CELLS[3]).clamp_min(0)).square()) * (math.pi / 2)
    phi_d = (math.pi * azimuth - torch.atan2(y, x)) % math.pi
    azimuth_from_90_degrees = (
        (phi_d - math.pi / 2).abs() - math.pi / RESIDUAL_GRID_CELLS[2] - (cell_diagonal / radius).clamp_max(1).asin()
    )
    return (radius < 1 + cell_diagonal) & (
        theta_h.tan() * theta_d.tan() * azimuth_from_90_degrees.clamp_min(0).sin() < 1
    )


def interpolation_matrix(angles: Tensor, axes_azimuth_rad: float) -> sparse.csr_array:
    """Return the matrix that interpolates a flat grid at samples, as the shader does.

    Args:
        angles: theta_h, theta_d, phi_d and phi_h of the samples, [N, 4] in rad.
        axes_azimuth_rad: azimuth of the material's axes.

    Returns:
        The sparse matrix, [N, cells].
    """
    theta_h, theta_d, phi_d, phi_h = angles.float().unbind(1)
    azimuth = phi_h - axes_azimuth_rad
    # samples that are uniform in theta_h and phi_h are uniform on the disc; cells are smaller towards grazing angles
    radius = (theta_h / (math.pi / 2)).sqrt()
    grazing = (1 - theta_d / (math.pi / 2)).clamp_min(0).sqrt()
    shares = [(1 + radius * azimuth.cos()) / 2, (1 + radius * azimuth.sin()) / 2]
    shares += [(azimuth + phi_d) / math.pi % 1, 1 - grazing]
    places = torch.stack(shares, 1) * angles.new_tensor(RESIDUAL_GRID_CELLS, dtype=torch.float32) - 0.5
    first_cells = places.floor()
    cells, weights = [], []
    for corner in itertools.product((0, 1), repeat=len(RESIDUAL_GRID_CELLS)):
        cell = first_cells + first_cells.new_tensor(corner)
        weights.append((1 - (places - cell).abs()).prod(1))
        index = torch.zeros_like(cell[:, 0], dtype=torch.int32)
        for axis, (count, column) in enumerate(zip(RESIDUAL_GRID_CELLS, cell.int().unbind(1), strict=True)):
            index = index * count + (column % count if axis == PERIODIC_AXIS else column.clamp(0, count - 1))
        cells.append(index)
    data_and_indices = (torch.stack(columns, 1).numpy().ravel() for columns in (weights, cells))
    row_ends = np.arange(len(angles) + 1, dtype=np.int32) * len(cells)
    return sparse.csr_array((*data_and_indices, row_ends), shape=(len(angles), math.prod(RESIDUAL_GRID_CELLS)))
