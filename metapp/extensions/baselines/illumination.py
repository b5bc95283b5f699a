"""Baselines of illumination networks: coefficients of the map itself; of a photo, the nearest training map.

Coefficients are the largest of orthonormal transforms: Haar wavelets, cosines, spherical harmonics.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.fft import dctn, idctn
from torch import Generator, Tensor

from metapp.appearance.latlong import solid_angles
from metapp.extensions.baselines.baseline import (
    Allowed,
    Baseline,
    BaselineFit,
    PreparedBaseline,
    Training,
    nearest_photo,
    within_size,
)
from metapp.extensions.baselines.harmonics import from_harmonics, harmonics, orders
from metapp.extensions.baselines.mirror_balls import gaussian, unwrapped
from metapp.learning.app import App
from metapp.learning.task import Tasks

Floats = NDArray[np.float64]

ROOT = math.sqrt(0.5)
SCALE, VALUE = 4, 2  # bytes of a picture's scale, a float, and of a value, half a float
# the power of solid angle that texels are weighted by before a transform: least error on training maps
EVEN, BY_AREA = 0.0, 0.5


class Kept(NamedTuple):
    """Coefficients that are kept, the others 0.

    Attributes:
        values: [C, K] over the scale, in half precision.
        scale: the largest.
        places: in a plane, [K], row-major.
        shape: of a plane.
    """

    values: NDArray[np.float16]
    scale: float
    places: NDArray[np.int64]
    shape: tuple[int, int]

    @property
    def numbers(self) -> int:
        """Values and places."""
        return self.values.size + self.places.size

    @property
    def size(self) -> int:
        """Bytes: places as a list or as a bit for each there is, whichever is less."""
        total = math.prod(self.shape)
        place = 2 if total <= 2**16 else 4
        return SCALE + VALUE * self.values.size + min(place * self.places.size, -(-total // 8))

    def coefficients(self) -> Floats:
        """All of them, [C, H, W]."""
        flat = np.zeros((len(self.values), math.prod(self.shape)))
        flat[:, self.places] = self.values.astype(np.float64) * self.scale
        return flat.reshape(-1, *self.shape)


def largest(coefficients: Floats, count: int) -> Kept:
    """The places where coefficients [C, H, W] of all channels together have most energy."""
    channels, *shape = coefficients.shape
    flat = coefficients.reshape(channels, -1)
    places = np.sort(np.argsort(-(flat * flat).sum(0), kind="stable")[:count])
    scale = float(np.abs(flat).max()) or 1.0
    return Kept((flat[:, places] / scale).astype(np.float16), scale, places, (shape[0], shape[1]))


def haar(pictures: Floats) -> Floats:
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


def inverse_haar(coefficients: Floats) -> Floats:
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
    sides = []
    while height > 1 or width > 1:
        sides.append((height, width))
        height, width = max(1, height // 2), max(1, width // 2)
    return sides


def _apart(values: Floats, axis: int) -> Floats:
    """Averages, then differences, of neighbours."""
    values = values.swapaxes(axis, -1)
    first, second = values[..., ::2], values[..., 1::2]
    return np.concatenate([(first + second) * ROOT, (first - second) * ROOT], -1).swapaxes(axis, -1)


def _together(values: Floats, axis: int) -> Floats:
    """The inverse of `_apart`."""
    first, second = np.split(values.swapaxes(axis, -1), 2, -1)
    both = np.stack([(first + second) * ROOT, (first - second) * ROOT], -1)
    return both.reshape(*both.shape[:-2], -1).swapaxes(axis, -1)


class Transform(NamedTuple):
    """An orthonormal transform of pictures [C, H, W], and the power of solid angle that weights their texels."""

    forward: Callable[[Floats], Floats]
    inverse: Callable[[Floats], Floats]
    power: float

    def encode(self, tasks: Tasks, rung: int) -> BaselineFit:
        """The largest coefficients: one place more a rung."""
        radiance = _map_of(tasks)
        weights = solid_angles(*radiance.shape[-2:]).double().numpy() ** self.power
        kept = largest(self.forward(radiance * weights), rung + 1)
        return BaselineFit(lambda: _answer(self.inverse(kept.coefficients()) / weights), kept.numbers, kept.size)


HAAR = Transform(haar, inverse_haar, EVEN)
COSINES = Transform(
    functools.partial(dctn, axes=(-2, -1), norm="ortho"),
    functools.partial(idctn, axes=(-2, -1), norm="ortho"),
    BY_AREA,
)


def baselines(app: App) -> tuple[Baseline, ...]:
    """Of maps, or of photographs, by the protocol."""
    if app.protocol == "photo":
        title = "the training map whose photograph is nearest (mean absolute difference of display values)"
        fill = "tell what the photo does not show"
        return (
            Baseline("nearest", title, "be a map that is not in its set", _nearest),
            Baseline("unwrap", "what a mirror ball shows, as it is", fill, unwrapped, learns=False, stored="seen"),
            Baseline("gaussian", "the same, its clipped light put back as one Gaussian", fill, gaussian, stored="seen"),
        )
    same = "read a map from a photo"
    sun = f"{same}, nor hold a sun in few"
    rings = f"{same}, nor show a sun that does not ring"
    halves = Baseline(
        "halves", "the map itself, in half precision", same, lambda *_: PreparedBaseline(_halves), learns=False
    )
    return (
        halves,
        within_size("haar", "largest Haar wavelets of radiance", same, _texels, HAAR.encode),
        within_size("dct", "largest cosines (DCT) of radiance", sun, _texels, COSINES.encode),
        within_size("sh", "spherical harmonics, least squares by solid angle", rings, _orders, _harmonics),
    )


def _map_of(tasks: Tasks) -> Floats:
    """The one task's map, [3, H, W]."""
    (row,) = tasks.rows.tolist()
    return tasks.data["map"][row].double().numpy()


def _answer(radiance: Floats) -> Tensor:
    return torch.from_numpy(radiance).float()[None]


def _texels(tasks: Tasks) -> int:
    return int(_map_of(tasks)[0].size)


def _orders(tasks: Tasks) -> int:
    return orders(*_map_of(tasks).shape[1:])


def _harmonics(tasks: Tasks, order: int) -> BaselineFit:
    """Coefficients up to an order, as half floats over their largest."""
    radiance = _map_of(tasks)
    _, height, width = radiance.shape
    coefficients = harmonics(radiance, order)
    kept = largest(coefficients[:, None], coefficients.shape[1])

    def answer() -> Tensor:
        return _answer(from_harmonics(kept.coefficients()[:, 0], height, width))

    return BaselineFit(answer, kept.values.size, SCALE + VALUE * kept.values.size)


def _halves(tasks: Tasks, rng: Generator, allowed: Allowed) -> BaselineFit:
    radiance = _map_of(tasks)
    scale = radiance.max() or 1.0
    kept = (radiance / scale).astype(np.float16)
    size = SCALE + kept.nbytes
    return BaselineFit(lambda: _answer(kept.astype(np.float64) * scale), kept.size, size, size <= allowed.size)


def _nearest(training: Training, allowed: Allowed) -> PreparedBaseline:
    return nearest_photo(training, "map", lambda radiance: radiance, Tensor.float)
