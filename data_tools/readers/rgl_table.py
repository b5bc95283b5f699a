"""BRDFs as the `measured` BSDF of Mitsuba 3 tabulates them: a file of the RGL database (Dupuy and Jakob 2018).

For each angle of the viewer there is a grid over half vectors m, in u = sqrt(2 theta_m / pi), which is dense at the
normal, and v = phi_m / (2 pi) + 1/2, the azimuth to the viewer's. The database warps it by the visible normals of a
microfacet model; here that warp is the identity (`vndf` is 1), and `luminance` alone says how Mitsuba samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from data_tools.readers.tensor_file import write_tensor_file
from metapp.appearance.geometry import directions_to_full_circle

NODES = 40  # angles of the viewer
GRID = 160  # half vectors along u and v
LAST_DEGREES = 89.5
LEAST_LUMINANCE = 1e-3  # of the mean: where a value is 0, directions are drawn all the same


def viewer_angles() -> NDArray[np.float64]:
    """Angles of the viewer in rad, [NODES], from the normal to LAST_DEGREES and denser there."""
    rest = 1 - np.linspace(0, 1, NODES)
    angles: NDArray[np.float64] = math.radians(LAST_DEGREES) * (1 - rest * rest)
    return angles


def half_vectors() -> Tensor:
    """The grid's half vectors, [GRID (v), GRID (u), 3]."""
    line = torch.linspace(0, 1, GRID, dtype=torch.float64)
    v, u = torch.meshgrid(line, line, indexing="ij")
    theta, phi = u * u * (math.pi / 2), (2 * v - 1) * math.pi
    return torch.stack([theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()], -1)


def write_rgl(path: str | Path, evaluate: Callable[[Tensor], Tensor], description: str) -> None:
    """Tabulate a BRDF as a file that `measured` loads in RGB variants, whole or not at all.

    Args:
        path: the file, 6 MB.
        evaluate: linear RGB [N, 3] in 1/sr, of angles (theta_h, theta_d, phi_d) [N, 3] in rad.
        description: kept in the file.

    Raises:
        ValueError: a value that is not finite.
    """
    half, angles = half_vectors(), viewer_angles()
    tables = np.stack([_table(evaluate, half, float(angle)) for angle in angles])
    if not np.isfinite(tables).all():
        raise ValueError(f"{path}: values that are NaN or infinite, expected finite reflectance; fit again.")
    luminance = tables.mean(1)
    # densities per area of the grid, so that what counts is the light a cell reflects
    area = _area(half, angles)
    luminance = luminance / np.maximum(np.cos(angles), 1e-3)[:, None, None] * area
    luminance += LEAST_LUMINANCE * luminance.mean((1, 2), keepdims=True) + 1e-12
    ones = np.ones((1, NODES, 2, 2), np.float32)
    fields: dict[str, NDArray[np.number]] = {
        "description": np.frombuffer(description.encode() or b" ", np.uint8),
        "phi_i": np.zeros(1, np.float32),
        "theta_i": angles.astype(np.float32),
        "sigma": np.ones((2, 2), np.float32),
        "ndf": np.ones((2, 2), np.float32),
        "vndf": ones,
        "luminance": luminance[None].astype(np.float32),
        "rgb": tables[None].astype(np.float32),
        "jacobian": np.zeros(1, np.uint8),
    }
    write_tensor_file(path, fields)


def _table(evaluate: Callable[[Tensor], Tensor], half: Tensor, angle: float) -> NDArray[np.float64]:
    """f cos theta of the light, [3, GRID, GRID], of one viewer at azimuth 0; 0 where the light is below the surface."""
    viewer = torch.tensor([math.sin(angle), 0.0, math.cos(angle)], dtype=torch.float64)
    light = 2 * (half @ viewer)[..., None] * half - viewer
    up = (light[..., 2] > 0) & (half @ viewer > 0)
    pairs = directions_to_full_circle(light[up], viewer.expand_as(light[up]))
    values = torch.zeros_like(light)
    with torch.no_grad():
        values[up] = evaluate(pairs.float()).double() * light[up][:, 2:]
    return values.movedim(-1, 0).numpy()


def _area(half: Tensor, angles: NDArray[np.float64]) -> NDArray[np.float64]:
    """Solid angle of lights over area of the grid, but for factors that rows share, [NODES, GRID, GRID]."""
    line = torch.linspace(0, 1, GRID, dtype=torch.float64)
    jacobian = line * (1 - half[..., 2] ** 2).sqrt()
    viewers = torch.tensor(np.stack([np.sin(angles), 0 * angles, np.cos(angles)], -1))
    cosine = torch.einsum("vuc,nc->nvu", half, viewers).clamp_min(0)
    return (4 * cosine * jacobian).numpy()
