"""Draws of the sets, by random numbers of `data_tools.random_streams.random_stream`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from data_tools.random_streams import Rng

Field = npt.NDArray[np.floating]  # float32 in all maps
Ids = npt.NDArray[np.int64]

_Item = TypeVar("_Item")


def between(rng: Rng, low: float, high: float) -> float:
    """A number evenly drawn from [low, high)."""
    return low + (high - low) * float(rng.random())


def log_between(rng: Rng, low: float, high: float) -> float:
    """A number from [low, high), evenly drawn over its logarithm."""
    return float(low * (high / low) ** float(rng.random()))


def integer_between(rng: Rng, low: int, high: int) -> int:
    """A whole number from low to high, both included."""
    return low + int(float(rng.random()) * (high - low + 1))


def chance(rng: Rng, probability: float) -> bool:
    """True in this share of draws."""
    return float(rng.random()) < probability


def pick(rng: Rng, items: Sequence[_Item]) -> _Item:
    """One of the items."""
    return items[integer_between(rng, 0, len(items) - 1)]


def uniforms(rng: Rng, *shape: int) -> Field:
    """Numbers in [0, 1) of this shape."""
    return rng.random(shape, dtype=np.float32)
