"""MERL tables in memory: bins, their angles, interpolation; a table of any BRDF."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from metapp.appearance.geometry import above_horizon

SHAPE = (90, 90, 180)
SCALE = np.array([1.0, 1.15, 1.66]) / 1500.0

Array = NDArray[np.float64]


def merl_valid(table: Array) -> NDArray[np.bool_]:
    """Mask [90, 90, 180] of a table's valid entries: those with a channel that is not negative."""
    return (table[..., 0] >= 0) | (table[..., 1] >= 0) | (table[..., 2] >= 0)


def merl_centres() -> Tensor:
    """Centres of all bins: angles (theta_h, theta_d, phi_d), float32 [90, 90, 180, 3] rad."""
    return torch.stack(torch.meshgrid(*(axis.float() for axis in _axes()), indexing="ij"), dim=-1)


def merl_index(angles: Tensor) -> Tensor:
    """Flat index phi_d + 180 * (theta_d + 90 * theta_h), int64 [...], of the bin of angles [..., 3] rad.

    The thetas are clamped to 0..pi/2, and phi_d + pi is phi_d (reciprocity).
    """
    bins = [position.floor().long().clamp(0, size - 1)
            for position, size in zip(_positions(angles), SHAPE, strict=True)]  # fmt: skip
    return (bins[0] * SHAPE[1] + bins[1]) * SHAPE[2] + bins[2]


def merl_evaluate(table: Array | Tensor, angles: Tensor) -> Tensor:
    """Reflectance [..., 3] of a table [90, 90, 180, 3], interpolated linearly in angles [..., 3] rad, of their type.

    Invalid entries are left out and the rest weighs more; where all eight are invalid the result is 0. phi_d is
    periodic; beyond the outermost centres of theta_h and theta_d the outermost value holds. A float32 table is fastest.
    """
    flat = torch.as_tensor(table, device=angles.device).reshape(-1, 3)
    lower, upper, weight = [], [], []
    for position, size, axis, angle in zip(_positions(angles), SHAPE, _axes(), angles.unbind(-1), strict=True):
        if size == SHAPE[2]:
            first = (position - 0.5).floor()
            weight.append(position - 0.5 - first)
            lower.append(first.long() % size)
            upper.append((lower[-1] + 1) % size)
        else:
            first = (position - 0.5).floor().long().clamp(0, size - 2)
            centres = axis.to(angles)
            weight.append(((angle - centres[first]) / (centres[first + 1] - centres[first])).clamp(0, 1))
            lower.append(first)
            upper.append(first + 1)
    total = angles.new_zeros(angles.shape)
    weights = angles.new_zeros((*angles.shape[:-1], 1))
    for corner in range(8):
        index = torch.zeros_like(lower[0])
        share = torch.ones_like(weight[0])
        for dim, size in enumerate(SHAPE):
            is_upper = corner >> dim & 1
            index = index * size + (upper[dim] if is_upper else lower[dim])
            share = share * (weight[dim] if is_upper else 1 - weight[dim])
        value = flat[index].to(angles.dtype)
        share = (share * (value >= 0).any(-1)).unsqueeze(-1)
        total += share * value
        weights += share
    return (total / weights.clamp_min(1e-12)).clamp_min(0)


def tabulate(evaluate: Callable[[Tensor], Tensor]) -> Array:
    """The table [90, 90, 180, 3] of a BRDF at the centres of all bins; those below the horizon are invalid.

    `evaluate` takes angles float32 [N, 3] rad, all above the horizon, and returns reflectance [N, 3] in 1/sr.

    Raises:
        ValueError: a result of another shape, or one that is not finite.
    """
    table = np.empty((*SHAPE, 3))
    table[:] = -SCALE
    # A few theta_h at a time: a network's hidden layers over all bins at once would take hundreds of megabytes.
    for rows, angles in zip(np.array_split(table, 9), merl_centres().tensor_split(9), strict=True):
        above = above_horizon(angles)
        with torch.no_grad():
            value = evaluate(angles[above])
        if value.shape != angles[above].shape:
            raise ValueError(
                f"evaluate returned {tuple(value.shape)}, expected {tuple(angles[above].shape)}: RGB for each angle."
            )
        if not bool(torch.isfinite(value).all()):
            raise ValueError("evaluate returned NaN or infinite values, expected finite reflectance in 1/sr.")
        rows[above.numpy()] = value.clamp_min(0).double().cpu().numpy()
    return table


def _axes() -> tuple[Tensor, Tensor, Tensor]:
    """Centres of the bins along theta_h, theta_d, phi_d: float64 rad."""
    theta_h, theta_d, phi_d = ((torch.arange(size, dtype=torch.float64) + 0.5) / size for size in SHAPE)
    return theta_h**2 * (math.pi / 2), theta_d * (math.pi / 2), phi_d * math.pi


def _positions(angles: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Positions along the three axes in bins: bin i covers [i, i + 1)."""
    theta_h, theta_d, phi_d = angles.unbind(-1)
    return (
        (theta_h.clamp_min(0) * (2 / math.pi)).sqrt() * SHAPE[0],
        theta_d * (2 / math.pi * SHAPE[1]),
        phi_d.remainder(math.pi) * (SHAPE[2] / math.pi),
    )
