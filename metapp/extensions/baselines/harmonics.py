"""Real spherical harmonics of lat-long maps, by least squares."""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import sph_legendre_p_all

Floats = NDArray[np.float64]


def orders(height: int, width: int) -> int:
    """Number of orders of spherical harmonics, 0 among them, that the texels of a lat-long map tell apart.

    Rows bound the degree, columns the wave along them: that of width / 2 has no cosine at the texels' centres, and of
    more is one of less.
    """
    return min(height, (width + 1) // 2)


def harmonics(maps: Floats, order: int) -> Floats:
    """Coefficients of lat-long maps [C, H, W] in real spherical harmonics up to an order, [C, (order + 1)^2].

    Least squares, texels weighted by solid angle. Harmonics are orthonormal over the sphere; those of one degree stand
    together, so that the first are those of less. Columns are evenly spaced and weights are of rows, so that every
    wave along the columns is a small fit of its own.

    Raises:
        ValueError: texels do not tell so many orders apart.
    """
    channels, height, width = maps.shape
    _check(order, height, width)
    # mean of map times exp(i m phi), twice that of waves, whose mean square is 1/2
    waves = np.fft.rfft(maps, norm="forward")[..., : order + 1].conj() * _turn(order, width)
    waves[..., 1:] *= 2
    coefficients = np.empty((channels, (order + 1) ** 2))
    degrees = np.arange(order + 1)
    for m, rows in enumerate(_along_theta(height)[: order + 1]):
        count = order + 1 - m
        fitted = waves[..., m] @ rows.weighted[:, :count]
        fitted = solve_triangular(rows.triangle[:count, :count], fitted.T).T
        # cosines last: 0 has no sines, so that both places are the same
        coefficients[:, places_of(degrees[m:], -m)] = fitted.imag
        coefficients[:, places_of(degrees[m:], m)] = fitted.real
    return coefficients


def from_harmonics(coefficients: Floats, height: int, width: int) -> Floats:
    """Maps [C, H, W] of coefficients [C, (order + 1)^2]; undoes `harmonics` where maps have no higher order.

    Raises:
        ValueError: texels do not tell so many orders apart.
    """
    order = math.isqrt(coefficients.shape[1]) - 1
    _check(order, height, width)
    waves = np.zeros((len(coefficients), height, width // 2 + 1), np.complex128)
    degrees = np.arange(order + 1)
    for m, rows in enumerate(_along_theta(height)[: order + 1]):
        cosines, sines = (coefficients[:, places_of(degrees[m:], sign * m)] for sign in (1, -1))
        along = rows.basis[:, : order + 1 - m].T
        waves[..., m] = (cosines - 1j * sines) @ along / 2 if m else cosines @ along
    waves[..., : order + 1] *= _turn(order, width)
    return np.fft.irfft(waves, width, norm="forward")


def places_of(degrees: NDArray[np.int64], m: int) -> NDArray[np.int64]:
    """Where the harmonics of some degrees stand: cosines of m, sines of -m."""
    return degrees * degrees + (2 * m - 1 if m > 0 else -2 * m)


def _check(order: int, height: int, width: int) -> None:
    if order >= (count := orders(height, width)):
        asked = f"Spherical harmonics of order {order} from {height}x{width} texels"
        raise ValueError(f"{asked}, expected at most {count - 1}; take fewer or a larger map.")


def _turn(order: int, width: int) -> NDArray[np.complex128]:
    """Of each m what turns a wave from the first texel's edge to its centre, [order + 1]."""
    return np.asarray(np.exp(1j * np.arange(order + 1) * (math.pi / width)))


class _Rows(NamedTuple):
    """Harmonics of one m along the rows of a map, of all degrees that these tell apart.

    Attributes:
        basis: [H, degrees], from degree m on.
        weighted: [H, degrees], Q of the QR decomposition of the basis times roots of solid angles, times these roots.
        triangle: [degrees, degrees], R of it; its first columns fit a lower order.
    """

    basis: Floats
    weighted: Floats
    triangle: Floats


@functools.lru_cache(maxsize=4)
def _along_theta(height: int) -> list[_Rows]:
    """Of each m.

    Rows tell all these degrees apart well: the weighted bases have condition numbers below 3.
    """
    theta = (np.arange(height) + 0.5) * (math.pi / height)
    root = np.sqrt(np.sin(theta))[:, None]
    legendre = sph_legendre_p_all(height - 1, height - 1, theta)[0]
    by_order = []
    for m in range(height):
        basis = legendre[m:, m].T * (math.sqrt(2) if m else 1)
        orthogonal, triangle = np.linalg.qr(root * basis)
        by_order.append(_Rows(basis, root * orthogonal, triangle))
    return by_order
