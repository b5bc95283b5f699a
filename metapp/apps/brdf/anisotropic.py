"""The input of learned features for anisotropic reflection: the full frame of half and difference vector.

Half vectors are turned into a material's own axes, so that learned grooves and threads do not depend on
how the sample lay. All inputs are the same for light and viewer exchanged: such a network is reciprocal by
construction.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from metapp.learning.task import Batch

ANISOTROPIC_INPUTS = 28
REFLECTANCE_FLOOR = 0.01  # below which a sample's f cos theta_i says little about axes
TWOFOLD_SHARE = 0.3  # share of the fourfold harmonic, below which the twofold one says nothing about axes


def anisotropic_inputs(where: Tensor, turn: Tensor) -> Tensor:
    """The network's input.

    Args:
        where: half vector, difference vector in the half vector's frame and cos theta_i, [T, 7, N].
        turn: azimuth of the material's axes in rad, [T, 1].

    Returns:
        [T, INPUTS, N]: of both cosines, of theta_h as the isotropic network, of the half vector's place along and
        across the axes, of the difference vector in the frame of the half vector and in that of the axes.
    """
    half_x, half_y, half_z, x, y, z, incident = where.unbind(1)
    cosine, sine = turn.cos(), turn.sin()
    half_x, half_y = cosine * half_x + sine * half_y, cosine * half_y - sine * half_x
    length_squared = half_x * half_x + half_y * half_y
    length = length_squared.clamp_min(1e-12).sqrt()
    above = length_squared > 1e-12
    cos_phi, sin_phi = torch.where(above, half_x / length, 1.0), torch.where(above, half_y / length, 0.0)
    angle = torch.atan2(length, half_z)
    outgoing = 2 * z * half_z - incident
    along, across = angle * cos_phi, angle * sin_phi
    squares = [angle.square(), along.square(), across.square()]
    diagonals = [(along + across).square() / 2, (along - across).square() / 2]
    # the difference of the directions, along the surface
    first, second = cos_phi * half_z * x - sin_phi * y, sin_phi * half_z * x + cos_phi * y
    both = (incident * outgoing).clamp_min(1e-6)
    logs = [square + floor for square in squares for floor in (1e-4, 1e-2)]
    logs += [*(square + 1e-3 for square in diagonals), both]
    more = [half_x, half_y, half_z, z, x * x - y * y, x * y, z * z, both, (incident - outgoing).square()]
    more += [angle.sqrt(), *(1 / (1 + 100 * square) for square in (*squares, *diagonals))]
    more += [first.square() - second.square(), first * second]
    more += [(squares[1] - squares[2]) / (squares[0] + 1e-3), along * across / (squares[0] + 1e-3)]
    return torch.cat([torch.stack(more, 1), 0.4 * torch.stack(logs, 1).log() + 1], 1)


def find_axes(samples: Batch) -> Tensor:
    """The azimuth of a material's axes in rad, [T, 1], in (-pi/2, pi/2]: where its highlight reaches farthest.

    Least squares of log reflectance on functions of theta_h and the cosines and on cos 2 phi_h and sin 2 phi_h; where
    these do not stand out, as of two threads that are alike, on those of 4 phi_h.

    Args:
        samples: `where` [T, 7, N] and `target` [T, 3, N] = log(1 + f cos theta_i).
    """
    where = samples["where"].double()
    half_x, half_y, half_z, _, _, z, incident = where.unbind(1)
    square = torch.atan2(torch.hypot(half_x, half_y), half_z).square()
    phi = torch.atan2(half_y, half_x)
    outgoing = 2 * z * half_z - incident
    plain = [torch.ones_like(phi), (square + 1e-4).log(), (square + 1e-2).log(), square, z]
    plain += [(incident * outgoing).clamp_min(1e-4).log()]
    harmonics = [(2 * phi).cos(), (2 * phi).sin(), (4 * phi).cos(), (4 * phi).sin()]
    columns = torch.stack(plain + harmonics, -1)
    values = (torch.expm1(samples["target"].double()).mean(1) + REFLECTANCE_FLOOR).log()[..., None]
    gram = columns.mT @ columns
    ridge = 1e-6 * gram.diagonal(dim1=-2, dim2=-1).mean(-1)[:, None, None]
    solved = torch.linalg.solve(gram + ridge * torch.eye(columns.shape[-1], dtype=gram.dtype, device=gram.device),
                                columns.mT @ values)[..., 0]  # fmt: skip
    cos2, sin2, cos4, sin4 = solved[:, -4:].unbind(1)
    twofold = torch.hypot(cos2, sin2) >= TWOFOLD_SHARE * torch.hypot(cos4, sin4)
    turn = torch.where(twofold, torch.atan2(sin2, cos2) / 2, torch.atan2(sin4, cos4) / 4)
    return turn[:, None].to(samples["where"])


def fixed_azimuths(count: int) -> Tensor:
    """phi_h [count] in rad for samples of an isotropic material, the same for each: any would do."""
    return torch.rand(count, generator=torch.Generator().manual_seed(0)) * math.tau
