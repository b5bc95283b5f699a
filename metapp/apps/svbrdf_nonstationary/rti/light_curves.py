"""What the values of a texel under many lamps tell: its light curve, and its normal and albedo by least squares.

T is tasks, N photographs, P texels.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from metapp.apps.svbrdf_nonstationary.maps import MIN_NORMAL_Z, decode_photo
from metapp.apps.svbrdf_nonstationary.rti.light_process import LightProcess

CURVE_DIRECTIONS = 64  # directions to lamps, at which light curves are known whatever the lamps were
LOWEST_DIRECTION_RAD = math.radians(12)  # of the curves; few domes have lower lamps
CURVE_PROCESS = LightProcess(1.8, 1.6, 1e-2)  # one for all objects, so that equal curves mean equal materials
MIDDLE_RANKS = (0.3, 0.8)  # ranks among the values of a texel below which it lies in shadow, and above which it shines
BRIGHT_RANK = 0.9  # rank from which on values show the colour of the highlight
QUANTILES = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)  # of a texel's values, which a network reads
LEAST_CURVE = 0.02  # display value by which the curves of darker texels are divided
TEXEL_INPUTS = CURVE_DIRECTIONS + 1 + len(QUANTILES) + 3  # numbers of a light curve that a network reads


class TexelReading(NamedTuple):
    """What the values of texels under all lamps tell.

    Attributes:
        curves: the inputs of a network, [T, TEXEL_INPUTS, P], in about -1 to 1.
        slopes: x and y over z of the normals by least squares, [T, 2, P].
        albedo: the diffuse albedo by least squares, relative to the exposure, [T, 3, P], at least 0.
    """

    curves: Tensor
    slopes: Tensor
    albedo: Tensor


def curve_directions() -> Tensor:
    """Return the unit vectors [CURVE_DIRECTIONS, 3] at which light curves are read, evenly spread."""
    lowest = math.sin(LOWEST_DIRECTION_RAD)
    number = torch.arange(CURVE_DIRECTIONS, dtype=torch.float64)
    z = lowest + (1 - lowest) * (number + 0.5) / CURVE_DIRECTIONS
    turn_rad, sine = number * (math.pi * (3 - math.sqrt(5))), (1 - z * z).sqrt()
    return torch.stack([sine * turn_rad.cos(), sine * turn_rad.sin(), z], 1).float()


def curve_weights(lamps: Tensor) -> Tensor:
    """Return the weights of photographs under lamps [N, 3] in light curves, [CURVE_DIRECTIONS, N]."""
    return CURVE_PROCESS.interpolation(curve_directions(), lamps)


def read_texels(colours: Tensor, lamps: Tensor, weights: Tensor) -> TexelReading:
    """Read texels of photographs.

    Args:
        colours: the values of texels, sRGB uint8 [T, N, 3, P].
        lamps: unit vectors towards the lamps, [T, N, 3].
        weights: the weights of photographs in light curves, [T, CURVE_DIRECTIONS, N]; see :func:`curve_weights`.
    """
    display = colours.float() / 255
    gray, linear = display.mean(2), decode_photo(colours)
    linear_gray = linear.mean(2)
    ordered = gray.sort(1).values
    last = gray.shape[1] - 1
    lower, upper, bright = (
        ordered[:, math.floor(rank * last) : math.floor(rank * last) + 1] for rank in (*MIDDLE_RANKS, BRIGHT_RANK)
    )
    is_middle = ((gray >= lower) & (gray <= upper)).float()
    normal, albedo = _solve_least_squares(linear, linear_gray, is_middle, lamps)
    slopes = normal[:, :2] / normal[:, 2:].clamp_min(MIN_NORMAL_Z)
    curves = weights @ gray
    peak = curves.amax(1, keepdim=True).clamp_min(LEAST_CURVE)
    quantiles = ordered[:, [round(rank * last) for rank in QUANTILES]]
    is_bright = (gray >= bright).float()[:, :, None]
    highlight = (linear * is_bright).sum(1) / is_bright.sum(1)
    return TexelReading(torch.cat([2 * curves / peak - 1, peak, quantiles, highlight], 1), slopes, albedo)


def _solve_least_squares(linear: Tensor, gray: Tensor, weights: Tensor, lamps: Tensor) -> tuple[Tensor, Tensor]:
    """Return unit normals [T, 3, P] and albedo [T, 3, P] of matt texels (Woodham 1980), by weighted least squares.

    Args:
        linear: linear values [T, N, 3, P].
        gray: their means over channels, [T, N, P].
        weights: the weights of the values, [T, N, P].
        lamps: unit vectors towards the lamps, [T, N, 3].
    """
    products = (lamps[:, :, :, None] * lamps[:, :, None]).flatten(2)  # [T, N, 9]
    normal_matrix = (products.mT @ weights).mT.unflatten(-1, (3, 3))  # [T, P, 3, 3]
    normal_matrix = normal_matrix + 1e-4 * torch.eye(3)
    right_side = (lamps.mT @ (weights * gray)).mT
    scaled = torch.linalg.solve(normal_matrix, right_side).mT
    normal = scaled / scaled.norm(dim=1, keepdim=True).clamp_min(1e-6)
    shading = weights * (lamps @ normal).clamp_min(0)
    # a matt white texel that faces the lamp has radiance 1
    albedo = (linear * shading[:, :, None]).sum(1) / (shading * (lamps @ normal)).sum(1).clamp_min(1e-4)[:, None]
    return normal, albedo.clamp_min(0)
