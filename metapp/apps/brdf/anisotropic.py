"""The input of the feature network for anisotropic reflection: the full frame of half and difference vector.

Half vectors are turned into a material's own axes, so that learned grooves and threads do not depend on how the sample
lay in the instrument. No input changes if light and viewer are exchanged: a network that reads these inputs is
reciprocal by construction.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from metapp.learning.task import Batch

ANISOTROPIC_INPUTS = 28  # numbers that the network reads of a pair of directions
REFLECTANCE_FLOOR = 0.01  # f cos theta_i in 1/sr, below which a sample says little about axes
# amplitude of the harmonic of 2 phi_h over the harmonic of 4 phi_h, below which the former says nothing about axes
TWOFOLD_SHARE = 0.3


def anisotropic_inputs(where: Tensor, axes_azimuth_rad: Tensor) -> Tensor:
    """Return the input of a network of anisotropic BRDFs, [T, ANISOTROPIC_INPUTS, N].

    Inputs are functions of both cosines, of theta_h, of the half vector's projections along and across the axes, and of
    the difference vector, both in the frame of the half vector and in the frame of the axes.

    Args:
        where: half vector, difference vector in the half vector's frame and cos theta_i, [T, 7, N].
        axes_azimuth_rad: azimuth of the material's axes, [T, 1].
    """
    half_x, half_y, half_z, x, y, z, cos_in = where.unbind(1)
    cosine, sine = axes_azimuth_rad.cos(), axes_azimuth_rad.sin()
    half_x, half_y = cosine * half_x + sine * half_y, cosine * half_y - sine * half_x
    half_sine_squared = half_x * half_x + half_y * half_y
    half_sine = half_sine_squared.clamp_min(1e-12).sqrt()
    is_tilted = half_sine_squared > 1e-12
    cos_phi, sin_phi = torch.where(is_tilted, half_x / half_sine, 1.0), torch.where(is_tilted, half_y / half_sine, 0.0)
    theta_h = torch.atan2(half_sine, half_z)
    cos_out = 2 * z * half_z - cos_in
    along, across = theta_h * cos_phi, theta_h * sin_phi
    squares = [theta_h.square(), along.square(), across.square()]
    diagonals = [(along + across).square() / 2, (along - across).square() / 2]
    # light minus viewer, projected on the surface
    difference_along, difference_across = cos_phi * half_z * x - sin_phi * y, sin_phi * half_z * x + cos_phi * y
    cosine_product = (cos_in * cos_out).clamp_min(1e-6)
    logs = [square + floor for square in squares for floor in (1e-4, 1e-2)]
    logs += [*(square + 1e-3 for square in diagonals), cosine_product]
    inputs = [half_x, half_y, half_z, z, x * x - y * y, x * y, z * z, cosine_product, (cos_in - cos_out).square()]
    inputs += [theta_h.sqrt(), *(1 / (1 + 100 * square) for square in (*squares, *diagonals))]
    inputs += [difference_along.square() - difference_across.square(), difference_along * difference_across]
    inputs += [(squares[1] - squares[2]) / (squares[0] + 1e-3), along * across / (squares[0] + 1e-3)]
    return torch.cat([torch.stack(inputs, 1), 0.4 * torch.stack(logs, 1).log() + 1], 1)


def find_axes(samples: Batch) -> Tensor:
    """Find the azimuth of each material's axes in rad, [T, 1], in (-pi/2, pi/2], where its highlight reaches farthest.

    Log reflectance is fitted by least squares: by functions of theta_h and of both cosines, by cos 2 phi_h and sin 2
    phi_h, and by cos 4 phi_h and sin 4 phi_h. The axes follow from the harmonic of 2 phi_h, or, where this does not
    stand out, from the harmonic of 4 phi_h, as for cloth of two threads that are alike.

    Args:
        samples: `where` [T, 7, N] and `target` [T, 3, N] = log(1 + f cos theta_i).
    """
    where = samples["where"].double()
    half_x, half_y, half_z, _, _, z, cos_in = where.unbind(1)
    polar_square = torch.atan2(torch.hypot(half_x, half_y), half_z).square()
    phi_h = torch.atan2(half_y, half_x)
    cos_out = 2 * z * half_z - cos_in
    plain_columns = [torch.ones_like(phi_h), (polar_square + 1e-4).log(), (polar_square + 1e-2).log(), polar_square, z]
    plain_columns += [(cos_in * cos_out).clamp_min(1e-4).log()]
    harmonic_columns = [(2 * phi_h).cos(), (2 * phi_h).sin(), (4 * phi_h).cos(), (4 * phi_h).sin()]
    columns = torch.stack(plain_columns + harmonic_columns, -1)
    log_reflectance = (torch.expm1(samples["target"].double()).mean(1) + REFLECTANCE_FLOOR).log()[..., None]
    gram = columns.mT @ columns
    ridge = 1e-6 * gram.diagonal(dim1=-2, dim2=-1).mean(-1)[:, None, None]
    identity = torch.eye(columns.shape[-1], dtype=gram.dtype, device=gram.device)
    coefficients = torch.linalg.solve(gram + ridge * identity, columns.mT @ log_reflectance)[..., 0]
    cos2, sin2, cos4, sin4 = coefficients[:, -4:].unbind(1)
    is_twofold = torch.hypot(cos2, sin2) >= TWOFOLD_SHARE * torch.hypot(cos4, sin4)
    axes_azimuth_rad = torch.where(is_twofold, torch.atan2(sin2, cos2) / 2, torch.atan2(sin4, cos4) / 4)
    return axes_azimuth_rad[:, None].to(samples["where"])


def fixed_azimuths(count: int) -> Tensor:
    """Return azimuths phi_h of half vectors, [count] in rad, for samples of isotropic materials, where any would do.

    All materials get the same azimuths.
    """
    return torch.rand(count, generator=torch.Generator().manual_seed(0)) * math.tau
