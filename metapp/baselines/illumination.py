"""Baselines of illumination networks: coefficients of the map itself; of a photo, the nearest training map."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import torch
from scipy.fft import dctn, idctn
from torch import Generator, Tensor

from metapp.appearance.latlong import solid_angles
from metapp.baselines.baseline import Allowed, Baseline, Codec, Fitted, Prepared, Training, both_ways, nearest_photo
from metapp.baselines.methods import transforms
from metapp.baselines.methods.transforms import Floats
from metapp.learning.app import App
from metapp.learning.task import Tasks

# the power of solid angle that texels are weighted by before a transform: least error on training maps
EVEN, BY_AREA = 0.0, 0.5


class Transform(NamedTuple):
    """An orthonormal transform of pictures [C, H, W], and the power of solid angle that weights their texels."""

    forward: Callable[[Floats], Floats]
    inverse: Callable[[Floats], Floats]
    power: float

    def encode(self, tasks: Tasks, rung: int) -> Fitted:
        """The largest coefficients: one place more a rung."""
        radiance = _map_of(tasks)
        weights = solid_angles(*radiance.shape[-2:]).double().numpy() ** self.power
        kept = transforms.largest(self.forward(radiance * weights), rung + 1)
        return Fitted(lambda: _answer(self.inverse(kept.coefficients()) / weights), kept.numbers, kept.size)


HAAR = Transform(transforms.haar, transforms.inverse_haar, EVEN)
COSINES = Transform(
    functools.partial(dctn, axes=(-2, -1), norm="ortho"),
    functools.partial(idctn, axes=(-2, -1), norm="ortho"),
    BY_AREA,
)


def baselines(app: App) -> tuple[Baseline, ...]:
    """Of maps, or of photographs, by the protocol."""
    if app.protocol == "photo":
        title = "the training map whose photograph is nearest (mean absolute difference of display values)"
        return (Baseline("nearest", title, "be a map that is not in its set", _nearest),)
    same = "read a map from a photo"
    sun = f"{same}, nor hold a sun in few"
    rings = f"{same}, nor show a sun that does not ring"
    codecs = [
        Codec("haar", "largest Haar wavelets of radiance", same, _texels, HAAR.encode),
        Codec("dct", "largest cosines (DCT) of radiance", sun, _texels, COSINES.encode),
        Codec("sh", "spherical harmonics, least squares by solid angle", rings, _orders, _harmonics),
    ]
    halves = Baseline("halves", "the map itself, in half precision", same, lambda *_: Prepared(_halves), learns=False)
    return (halves, *(baseline for codec in codecs for baseline in both_ways(codec)))


def _map_of(tasks: Tasks) -> Floats:
    """The one task's map, [3, H, W]."""
    (row,) = tasks.rows.tolist()
    return tasks.data["map"][row].double().numpy()


def _answer(radiance: Floats) -> Tensor:
    return torch.from_numpy(radiance).float()[None]


def _texels(tasks: Tasks) -> int:
    return int(_map_of(tasks)[0].size)


def _orders(tasks: Tasks) -> int:
    return transforms.orders(*_map_of(tasks).shape[1:])


def _harmonics(tasks: Tasks, order: int) -> Fitted:
    """Coefficients up to an order, as half floats over their largest."""
    radiance = _map_of(tasks)
    _, height, width = radiance.shape
    coefficients = transforms.harmonics(radiance, order)
    kept = transforms.largest(coefficients[:, None], coefficients.shape[1])

    def answer() -> Tensor:
        return _answer(transforms.from_harmonics(kept.coefficients()[:, 0], height, width))

    return Fitted(answer, kept.values.size, transforms.SCALE + transforms.VALUE * kept.values.size)


def _halves(tasks: Tasks, rng: Generator, allowed: Allowed) -> Fitted:
    radiance = _map_of(tasks)
    scale = radiance.max() or 1.0
    kept = (radiance / scale).astype(np.float16)
    size = transforms.SCALE + kept.nbytes
    return Fitted(lambda: _answer(kept.astype(np.float64) * scale), kept.size, size, size <= allowed.size)


def _nearest(training: Training, allowed: Allowed) -> Prepared:
    return nearest_photo(training, "map", lambda radiance: radiance, Tensor.float)
