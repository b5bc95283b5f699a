"""Directions at a surface: half and difference angles, their cosines, and quadrature over them.

Everything is differentiable and takes any leading axes, dtype and device. Directions are unit vectors of the local
frame, z the surface normal; `wi` points to the light, `wo` to the viewer. Angles are (theta_h, theta_d, phi_d) in rad
after Rusinkiewicz, "A New Change of Variables for Efficient BRDF Representation" (1998), with phi_h = 0: isotropic. A
fourth angle is phi_h, the azimuth of the half vector from the tangent x, which anisotropic reflection depends on.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor


class Cosines(NamedTuple):
    """The four cosines that isotropic reflection depends on, each [...]; below 0 under the horizon.

    Attributes:
        incident: cosine between light and normal.
        outgoing: cosine between viewer and normal.
        half: cosine between half vector and normal.
        difference: cosine between half vector and light, or viewer.
    """

    incident: Tensor
    outgoing: Tensor
    half: Tensor
    difference: Tensor


def _length(vectors: Tensor) -> Tensor:
    # The clamp keeps the gradient of the square root finite (and zero) at the zero vector.
    return (vectors * vectors).sum(-1).clamp_min(torch.finfo(vectors.dtype).tiny).sqrt()


def _difference_vector(angles: Tensor) -> Tensor:
    _, theta_d, phi_d = angles[..., :3].unbind(-1)
    return torch.stack([theta_d.sin() * phi_d.cos(), theta_d.sin() * phi_d.sin(), theta_d.cos()], dim=-1)


def _rotate_about_y(vectors: Tensor, cosine: Tensor, sine: Tensor) -> Tensor:
    x, y, z = vectors.unbind(-1)
    return torch.stack([cosine * x + sine * z, y, cosine * z - sine * x], dim=-1)


def rotate_about_normal(vectors: Tensor, angle_rad: Tensor) -> Tensor:
    """Rotate vectors [..., 3] about z, the normal, by angles [...] in rad, from x towards y.

    >>> rotate_about_normal(torch.tensor([1.0, 0.0, 0.0]), torch.tensor(torch.pi / 3))
    tensor([0.5000, 0.8660, 0.0000])
    """
    x, y, z = vectors.unbind(-1)
    cosine, sine = angle_rad.cos(), angle_rad.sin()
    return torch.stack([cosine * x - sine * y, sine * x + cosine * y, z], dim=-1)


def rusinkiewicz_to_directions(angles: Tensor) -> tuple[Tensor, Tensor]:
    """Convert half and difference angles to the directions of light and viewer.

    Args:
        angles: [..., 3 or 4], (theta_h, theta_d, phi_d) in rad, and phi_h, which counts as 0 where it is left out.

    Returns:
        wi and wo, [..., 3] each, unit length; below the horizon where the angles say so.

    >>> wi, wo = rusinkiewicz_to_directions(torch.tensor([0.0, torch.pi / 6, 0.0]))
    >>> torch.round(wi @ wo, decimals=4)
    tensor(0.5000)
    """
    theta_h, difference = angles[..., 0], _difference_vector(angles)
    mirrored = difference * difference.new_tensor([-1.0, -1.0, 1.0])
    cosine, sine = theta_h.cos(), theta_h.sin()
    wi, wo = _rotate_about_y(difference, cosine, sine), _rotate_about_y(mirrored, cosine, sine)
    if angles.shape[-1] < 4:
        return wi, wo
    return rotate_about_normal(wi, angles[..., 3]), rotate_about_normal(wo, angles[..., 3])


def directions_to_rusinkiewicz(wi: Tensor, wo: Tensor) -> Tensor:
    """Convert two directions to half and difference angles; gradients are finite also if an angle is undefined.

    Args:
        wi: direction to the light, [..., 3], unit length.
        wo: direction to the viewer, [..., 3], unit length.

    Returns:
        angles [..., 3] in rad: theta_h and theta_d in [0, pi/2] above the horizon, phi_d in [0, pi): by reciprocity
        (swapping wi and wo adds pi to phi_d) the other half of the circle says the same.

    >>> directions_to_rusinkiewicz(torch.tensor([0.6, 0.0, 0.8]), torch.tensor([-0.6, 0.0, 0.8]))[1]
    tensor(0.6435)
    """
    return _to_angles(wi, wo, math.pi)


def directions_to_full_rusinkiewicz(wi: Tensor, wo: Tensor) -> Tensor:
    """Convert two directions to half and difference angles, with phi_d on the full circle.

    So the angles say which of the two directions is the light; :func:`directions_to_rusinkiewicz` folds both into one.

    Args:
        wi: direction to the light, [..., 3], unit length.
        wo: direction to the viewer, [..., 3], unit length.

    Returns:
        angles [..., 3] in rad: theta_h and theta_d in [0, pi/2] above the horizon, phi_d in [0, 2 pi).
    """
    return _to_angles(wi, wo, math.tau)


def directions_to_four_angles(wi: Tensor, wo: Tensor) -> Tensor:
    """Convert two directions to half and difference angles and the half vector's azimuth, for anisotropic reflection.

    Args:
        wi: direction to the light, [..., 3], unit length.
        wo: direction to the viewer, [..., 3], unit length.

    Returns:
        angles [..., 4] in rad: theta_h and theta_d in [0, pi/2] above the horizon, phi_d and phi_h in [0, 2 pi); phi_h
        is 0 if the half vector is the normal.
    """
    total = wi + wo
    tiny = torch.finfo(total.dtype).tiny
    has_azimuth = total[..., 0] ** 2 + total[..., 1] ** 2 > tiny
    phi_h = torch.atan2(torch.where(has_azimuth, total[..., 1], 0.0), torch.where(has_azimuth, total[..., 0], 1.0))
    phi_h = torch.where(phi_h < 0, phi_h + math.tau, phi_h)
    phi_h = torch.where(phi_h >= math.tau, 0.0, phi_h)
    return torch.cat([directions_to_full_rusinkiewicz(wi, wo), phi_h[..., None]], -1)


def _to_angles(wi: Tensor, wo: Tensor, period: float) -> Tensor:
    """Convert two directions [..., 3] to theta_h, theta_d and phi_d in [0, period), [..., 3]."""
    total = wi + wo
    x, y, z = total.unbind(-1)
    sine = _length(total[..., :2])  # sine of theta_h times the length of `total`; z is its cosine times that length
    theta_h = torch.atan2(sine, z)
    theta_d = torch.atan2(_length(wi - wo), _length(total))
    # Where the half vector is the normal, or there is none, any azimuth will do: 0.
    tiny = torch.finfo(total.dtype).tiny
    has_azimuth = x * x + y * y > tiny
    cos_phi, sin_phi = torch.where(has_azimuth, x / sine, 1.0), torch.where(has_azimuth, y / sine, 0.0)
    rotated = torch.stack([cos_phi * wi[..., 0] + sin_phi * wi[..., 1], cos_phi * wi[..., 1] - sin_phi * wi[..., 0]])
    difference_x = theta_h.cos() * rotated[0] - theta_h.sin() * wi[..., 2]
    has_difference = difference_x * difference_x + rotated[1] * rotated[1] > tiny
    phi_d = torch.atan2(torch.where(has_difference, rotated[1], 0.0), torch.where(has_difference, difference_x, 1.0))
    phi_d = torch.where(phi_d < 0, phi_d + period, phi_d)
    phi_d = torch.where(phi_d >= period, 0.0, phi_d)  # a tiny negative angle rounds up to the period itself
    return torch.stack([theta_h, theta_d, phi_d], dim=-1)


def half_difference_vectors(angles: Tensor) -> Tensor:
    """Return half and difference vectors, the input of the network of Sztrajman et al., "Neural BRDF ..." (2021).

    Args:
        angles: [..., 3 or 4] in rad.

    Returns:
        [..., 6]: half vector (sin theta_h, 0, cos theta_h), turned by phi_h if there is one, then difference vector, in
        the frame of the half vector; each of unit length.
    """
    theta_h, theta_d, phi_d = angles[..., :3].unbind(-1)
    sine = theta_d.sin()
    half: tuple[Tensor | float, ...] = (theta_h.sin(), 0.0, theta_h.cos())
    if angles.shape[-1] == 4:
        half = (theta_h.sin() * angles[..., 3].cos(), theta_h.sin() * angles[..., 3].sin(), theta_h.cos())
    difference = (sine * phi_d.cos(), sine * phi_d.sin(), theta_d.cos())
    vectors = angles.new_empty(*angles.shape[:-1], 6)  # written in place: to join the columns takes four times as long
    for i, column in enumerate((*half, *difference)):
        vectors[..., i] = column
    return vectors


def half_difference_and_cosine(angles: Tensor) -> Tensor:
    """Return half vector, difference vector and cos theta_i, [N, 7], of angles [N, 3 or 4] in rad."""
    inputs, vectors = angles.new_empty(len(angles), 7), half_difference_vectors(angles)
    half_x, half_y, half_z, x, _, z = vectors.unbind(1)
    inputs[:, :6] = vectors
    inputs[:, 6] = z * half_z - x * (half_x if angles.shape[1] == 3 else (half_x * half_x + half_y * half_y).sqrt())
    return inputs


def outgoing_cosine(inputs: Tensor) -> Tensor:
    """Return cos theta_o [T, N] of half vectors, difference vectors and cos theta_i, [T, 7, N].

    See :func:`half_difference_and_cosine`, which makes these seven numbers of angles.
    """
    half_x, _, half_z, x, _, z, _ = inputs.unbind(1)
    return torch.addcmul(z * half_z, x, half_x)


def angle_cosines(angles: Tensor) -> Cosines:
    """Compute the four cosines of half and difference angles [..., 3 or 4] in rad, without forming directions."""
    theta_h, theta_d, phi_d = angles[..., :3].unbind(-1)
    half, difference = theta_h.cos(), theta_d.cos()
    mean, half_difference = difference * half, theta_d.sin() * phi_d.cos() * theta_h.sin()
    return Cosines(mean - half_difference, mean + half_difference, half, difference)


def is_above_horizon(angles: Tensor) -> Tensor:
    """Test whether both directions are above the surface: bool [...] of angles [..., 3 or 4] in rad.

    >>> is_above_horizon(torch.tensor([[0.0, 0.1, 0.0], [1.5, 1.5, 0.0]]))
    tensor([ True, False])
    """
    incident, outgoing, *_ = angle_cosines(angles)
    return (incident > 0) & (outgoing > 0)


def quasirandom_angles(count: int) -> Tensor:
    """Return angles [count, 3] in rad that are spread as held-out samples of BRDFs are: uniform, above the horizon."""
    draws = torch.quasirandom.SobolEngine(3).draw(4 * count) * torch.tensor([math.pi / 2, math.pi / 2, math.tau])
    return draws[is_above_horizon(draws)][:count]


def direction_cosines(wi: Tensor, wo: Tensor, normal: Tensor) -> Cosines:
    """Compute the four cosines [...] of two directions and a normal, [..., 3] each, of unit length in one frame."""
    length = _length(wi + wo)
    incident, outgoing = (wi * normal).sum(-1), (wo * normal).sum(-1)
    return Cosines(incident, outgoing, (incident + outgoing) / length, length / 2)


@functools.cache
def gauss_legendre(count: int) -> tuple[Tensor, Tensor]:
    """Return nodes and weights [count], float64, of Gauss-Legendre quadrature on [0, 1]."""
    nodes, weights = map(torch.from_numpy, np.polynomial.legendre.leggauss(count))
    return (nodes + 1) / 2, weights / 2
