"""Orthonormal transforms of pictures, and their largest coefficients: Haar wavelets, cosines, spherical harmonics."""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.special import sph_harm_y

ROOT = math.sqrt(0.5)
SCALE, VALUE = 4, 2  # bytes of a picture's scale, a float, and of a value, half a float


class Kept(NamedTuple):
    """Coefficients that are kept, the others 0.

    Attributes:
        values: [C, K] over the scale, in half precision.
        scale: the largest.
        places: in a plane, [K], as `str_` of row-major numbers.
        shape: of a plane.
    """

    values: np.ndarray
    scale: float
    places: np.ndarray
    shape: tuple[int, int]

    @property
    def numbers(self) -> int:
        """Values and places."""
        return self.values.size + self.places.size

    @property
    def size(self) -> int:
        """Bytes: places as a list or as a bit for each there is, whichever is less."""
        total = math.prod(self.shape)
        return SCALE + VALUE * self.values.size + min(places_size(total) * self.places.size, -(-total // 8))

    def coefficients(self) -> np.ndarray:
        """All of them, [C, H, W]."""
        flat = np.zeros((len(self.values), math.prod(self.shape)))
        flat[:, self.places] = self.values.astype(np.float64) * self.scale
        return flat.reshape(-1, *self.shape)


def places_size(total: int) -> int:
    """Bytes of a place among so many."""
    return 2 if total <= 2**16 else 4


def largest(coefficients: np.ndarray, count: int) -> Kept:
    """The places where coefficients [C, H, W] of all channels together have most energy."""
    channels, *shape = coefficients.shape
    flat = coefficients.reshape(channels, -1)
    places = np.sort(np.argsort(-(flat * flat).sum(0), kind="stable")[:count])
    scale = float(np.abs(flat).max()) or 1.0
    return Kept((flat[:, places] / scale).astype(np.float16), scale, places, (shape[0], shape[1]))


def haar(pictures: np.ndarray) -> np.ndarray:
    """Haar wavelets of pictures [C, H, W], orthonormal: averages and differences, of averages again and again.

    Raises:
        ValueError: a side is no power of two.
    """
    result = pictures.astype(np.float64)
    for height, width in _levels(*result.shape[-2:]):
        part = result[..., :height, :width]
        part = _apart(part, -2) if height > 1 else part
        result[..., :height, :width] = _apart(part, -1) if width > 1 else part
    return result


def inverse_haar(coefficients: np.ndarray) -> np.ndarray:
    """The inverse of `haar`."""
    result = coefficients.astype(np.float64)
    for height, width in reversed(_levels(*result.shape[-2:])):
        part = result[..., :height, :width]
        part = _together(part, -1) if width > 1 else part
        result[..., :height, :width] = _together(part, -2) if height > 1 else part
    return result


def _levels(height: int, width: int) -> list[tuple[int, int]]:
    """Sides of the averages, from the finest on."""
    for side in (height, width):
        if side & (side - 1):
            raise ValueError(f"Haar wavelets of {height}x{width} texels, expected powers of two; resample first.")
    found = []
    while height > 1 or width > 1:
        found.append((height, width))
        height, width = max(1, height // 2), max(1, width // 2)
    return found


def _apart(values: np.ndarray, axis: int) -> np.ndarray:
    """Averages, then differences, of neighbours."""
    values = values.swapaxes(axis, -1)
    first, second = values[..., ::2], values[..., 1::2]
    return np.concatenate([(first + second) * ROOT, (first - second) * ROOT], -1).swapaxes(axis, -1)


def _together(values: np.ndarray, axis: int) -> np.ndarray:
    """The inverse of `_apart`."""
    first, second = np.split(values.swapaxes(axis, -1), 2, -1)
    both = np.stack([(first + second) * ROOT, (first - second) * ROOT], -1)
    return both.reshape(*both.shape[:-2], -1).swapaxes(axis, -1)


@functools.lru_cache(maxsize=64)
def harmonics(order: int, height: int, width: int) -> np.ndarray:
    """Real spherical harmonics up to an order at the texels' centres of a lat-long map, [H * W, (order + 1)^2].

    Orthonormal over the sphere; those of one degree stand together, so that the first columns are those of less.
    """
    theta = (np.arange(height) + 0.5) * (math.pi / height)
    phi = (np.arange(width) + 0.5) * (math.tau / width)
    columns = []
    for degree in range(order + 1):
        for m in range(degree + 1):
            along_theta = sph_harm_y(degree, m, theta, 0.0).real * (math.sqrt(2) if m else 1)
            waves = (np.cos(m * phi), np.sin(m * phi)) if m else (np.ones(width),)
            columns += [np.outer(along_theta, wave).ravel() for wave in waves]
    return np.stack(columns, 1)


@functools.lru_cache(maxsize=64)
def projection(order: int, height: int, width: int) -> np.ndarray:
    """What takes a map [H * W] to its coefficients: least squares, texels weighted by solid angle, [K, H * W].

    Below the order that rows tell apart the normal equations are well-conditioned: 5 at order 31 of 32 rows.
    """
    basis = harmonics(order, height, width)
    theta = (np.arange(height) + 0.5) * (math.pi / height)
    weighted = basis * np.repeat(np.sin(theta), width)[:, None]
    found: np.ndarray = cho_solve(cho_factor(basis.T @ weighted), weighted.T)
    return found
