"""Random draws that are the same on every machine, up to rounding: PCG64's raw uniforms."""

from __future__ import annotations

import numpy as np

Rng = np.random.Generator


def random_stream(*key: int) -> Rng:
    """The random numbers of a key, whole numbers >= 0; others for every other key of the same length.

    >>> stream(7, 0).random() == stream(7, 0).random(), stream(7, 0).random() == stream(7, 1).random()
    (True, False)
    """
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(key)))
