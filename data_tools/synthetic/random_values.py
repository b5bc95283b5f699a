"""Random numbers, choices and arrays for the embedded sets, from streams of `data_tools.random_streams`.

Streams give uniform numbers, of which the other draws are computed here by formulas. So draws are equal on every
machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypeVar

import numpy as np
import numpy.typing as npt

from data_tools.random_streams import Rng

Field = npt.NDArray[np.floating]  # float32 in all maps
Ids = npt.NDArray[np.int64]
Split = Literal["train", "test"]  # of an embedded set

_Item = TypeVar("_Item")


def between(rng: Rng, low: float, high: float) -> float:
    """Draw a number evenly from [low, high)."""
    return low + (high - low) * float(rng.random())


def log_between(rng: Rng, low: float, high: float) -> float:
    """Draw a number from [low, high), evenly over its logarithm."""
    return float(low * (high / low) ** float(rng.random()))


def integer_between(rng: Rng, low: int, high: int) -> int:
    """Draw a whole number from low to high, both included."""
    return low + int(float(rng.random()) * (high - low + 1))


def chance(rng: Rng, probability: float) -> bool:
    """Return True in a share of draws."""
    return float(rng.random()) < probability


def pick(rng: Rng, items: Sequence[_Item]) -> _Item:
    """Draw one of some items, all equally likely."""
    return items[integer_between(rng, 0, len(items) - 1)]


def uniforms(rng: Rng, *shape: int) -> Field:
    """Draw an array of numbers in [0, 1)."""
    return rng.random(shape, dtype=np.float32)
