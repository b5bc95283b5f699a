"""Real spherical harmonics of latitude-longitude maps, by least squares.

Nothing here knows of tasks or of baselines.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.typing import NDArray
from scipy.special import sph_legendre_p_all

Floats = NDArray[np.float64]


def count_orders(height: int, width: int) -> int:
    """Return how many orders of spherical harmonics, 0 among them, the texels of a lat-long map can tell apart.

    Rows bound the degree. Columns bound the wave along them: a wave of width / 2 periods has no cosine at the texels'
    centres, and a wave of more periods equals one of fewer.
    """
    return min(height, (width + 1) // 2)


def to_harmonics(maps: Floats, order: int) -> Floats:
    """Return the coefficients of lat-long maps in real spherical harmonics up to an order.

    The fit is by least squares, with texels weighted by solid angle. Harmonics are orthonormal over the sphere;
    harmonics of one degree stand together, lower degrees first. Columns are evenly spaced and all texels of a row have
    one weight, so that each wave along the columns is a small fit by itself.

    Args:
        maps: the lat-long maps, [C, H, W].
        order: the highest degree.

    Returns:
        The coefficients, [C, (order + 1)^2].
    """
    channels, height, width = maps.shape
    # the mean of the map times exp(i m phi), doubled for m > 0, where the mean square of a wave is 1/2
    waves = np.fft.rfft(maps, norm="forward")[..., : order + 1].conj() * _phase_factors(order, width)
    waves[..., 1:] *= 2
    coefficients = np.empty((channels, (order + 1) ** 2))
    for m, (_, inverse) in enumerate(_theta_bases(height, order)):
        fitted = waves[..., m] @ inverse.T
        # cosines are written last: m = 0 has no sines, and both slices are the same there
        coefficients[:, _coefficient_indices(order, -m)] = fitted.imag
        coefficients[:, _coefficient_indices(order, m)] = fitted.real
    return coefficients


def from_harmonics(coefficients: Floats, height: int, width: int) -> Floats:
    """Return lat-long maps of coefficients; inverts :func:`to_harmonics` on maps of no higher order.

    Args:
        coefficients: the coefficients, [C, (order + 1)^2].
        height: H, the number of rows.
        width: W, the number of columns.

    Returns:
        The maps, [C, H, W].
    """
    order = math.isqrt(coefficients.shape[1]) - 1
    waves = np.zeros((len(coefficients), height, width // 2 + 1), np.complex128)
    for m, (basis, _) in enumerate(_theta_bases(height, order)):
        cosines, sines = (coefficients[:, _coefficient_indices(order, sign * m)] for sign in (1, -1))
        waves[..., m] = (cosines - 1j * sines) @ basis.T / 2 if m else cosines @ basis.T
    waves[..., : order + 1] *= _phase_factors(order, width)
    return np.fft.irfft(waves, width, norm="forward")


def _coefficient_indices(order: int, m: int) -> NDArray[np.int64]:
    """Return where the coefficients of all degrees up to an order stand: of cosines for m, of sines for -m."""
    degrees = np.arange(abs(m), order + 1)
    return degrees * degrees + (2 * m - 1 if m > 0 else -2 * m)


def _phase_factors(order: int, width: int) -> NDArray[np.complex128]:
    """Return the factors [order + 1], one for each m, that turn a wave from the first texel's edge to its centre."""
    return np.asarray(np.exp(1j * np.arange(order + 1) * (math.pi / width)))


@functools.lru_cache(maxsize=4)
def _theta_bases(height: int, order: int) -> list[tuple[Floats, Floats]]:
    """Return, for each m, the harmonics along rows [H, degrees] from degree m on, and their weighted inverse.

    Inverses are [degrees, H]. Rows tell all these degrees apart well: the weighted bases have condition numbers below
    3.
    """
    theta = (np.arange(height) + 0.5) * (math.pi / height)
    root_weights = np.sqrt(np.sin(theta))
    legendre = sph_legendre_p_all(order, order, theta)[0]
    bases = [legendre[m:, m].T * (math.sqrt(2) if m else 1) for m in range(order + 1)]
    return [(basis, np.linalg.pinv(root_weights[:, None] * basis) * root_weights) for basis in bases]
