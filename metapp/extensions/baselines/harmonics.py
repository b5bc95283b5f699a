"""Real spherical harmonics of lat-long maps, by least squares."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import sph_legendre_p_all

Floats = NDArray[np.float64]


def count_orders(height: int, width: int) -> int:
    """Number of orders of spherical harmonics, 0 among them, that the texels of a lat-long map tell apart.

    Rows bound the degree, columns the wave along them: that of width / 2 has no cosine at the texels' centres, and of
    more is one of less.
    """
    return min(height, (width + 1) // 2)


def to_harmonics(maps: Floats, order: int) -> Floats:
    """Coefficients of lat-long maps [C, H, W] in real spherical harmonics up to an order, [C, (order + 1)^2].

    Least squares, texels weighted by solid angle. Harmonics are orthonormal over the sphere; those of one degree stand
    together, so that the first are those of less. Columns are evenly spaced and weights are of rows, so that every
    wave along the columns is a small fit of its own.
    """
    channels, height, width = maps.shape
    # mean of map times exp(i m phi), twice that of waves, whose mean square is 1/2
    waves = np.fft.rfft(maps, norm="forward")[..., : order + 1].conj() * _turn(order, width)
    waves[..., 1:] *= 2
    coefficients = np.empty((channels, (order + 1) ** 2))
    for m, (_, inverse) in enumerate(_along_theta(height, order)):
        fitted = waves[..., m] @ inverse.T
        # cosines last: 0 has no sines, so that both places are the same
        coefficients[:, _places(order, -m)] = fitted.imag
        coefficients[:, _places(order, m)] = fitted.real
    return coefficients


def from_harmonics(coefficients: Floats, height: int, width: int) -> Floats:
    """Maps [C, H, W] of coefficients [C, (order + 1)^2]; undoes `to_harmonics` if maps have no higher order."""
    order = math.isqrt(coefficients.shape[1]) - 1
    waves = np.zeros((len(coefficients), height, width // 2 + 1), np.complex128)
    for m, (basis, _) in enumerate(_along_theta(height, order)):
        cosines, sines = (coefficients[:, _places(order, sign * m)] for sign in (1, -1))
        waves[..., m] = (cosines - 1j * sines) @ basis.T / 2 if m else cosines @ basis.T
    waves[..., : order + 1] *= _turn(order, width)
    return np.fft.irfft(waves, width, norm="forward")


def _places(order: int, m: int) -> NDArray[np.int64]:
    """Where the harmonics of all degrees up to an order stand: cosines of m, sines of -m."""
    degrees = np.arange(abs(m), order + 1)
    return degrees * degrees + (2 * m - 1 if m > 0 else -2 * m)


def _turn(order: int, width: int) -> NDArray[np.complex128]:
    """Of each m the factor that turns a wave from the first texel's edge to its centre, [order + 1]."""
    return np.asarray(np.exp(1j * np.arange(order + 1) * (math.pi / width)))


@functools.lru_cache(maxsize=4)
def _along_theta(height: int, order: int) -> list[tuple[Floats, Floats]]:
    """Of each m the harmonics along rows, from degree m on, [H, degrees], and their weighted inverse [degrees, H].

    Rows tell all these degrees apart well: the weighted bases have condition numbers below 3.
    """
    theta = (np.arange(height) + 0.5) * (math.pi / height)
    root = np.sqrt(np.sin(theta))
    legendre = sph_legendre_p_all(order, order, theta)[0]
    bases = [legendre[m:, m].T * (math.sqrt(2) if m else 1) for m in range(order + 1)]
    return [(basis, np.linalg.pinv(root[:, None] * basis) * root) for basis in bases]
