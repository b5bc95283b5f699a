"""Image quilting: blocks of the exemplar, cuts where neighbours agree, pictures that tile."""

from __future__ import annotations

import numpy as np
import pytest

from metapp.appearance.quilting import quilted


def waves(size: int = 48, period: int = 8) -> np.ndarray:
    """A picture [size, size, 3] that repeats every `period` px."""
    at = np.arange(size) * (2 * np.pi / period)
    wave = 0.5 + 0.25 * np.sin(at)[:, None] + 0.25 * np.cos(at)
    return np.stack([wave, 1 - wave, 0.3 + 0.4 * wave], 2).astype(np.float32)


def steepest(picture: np.ndarray) -> float:
    """The greatest step between neighbours, across the edges too."""
    return max(float(np.abs(np.roll(picture, 1, axis) - picture).max()) for axis in (0, 1))


@pytest.mark.parametrize("tiles", [False, True])
def test_a_picture_is_made_of_pixels_of_the_exemplar(tiles: bool) -> None:
    exemplar = np.random.default_rng(1).random((20, 24, 3)).astype(np.float32)
    made = quilted(exemplar, (33, 41), np.random.default_rng(0), block=8, overlap=2, tiles=tiles)
    assert made.shape == (33, 41, 3)
    assert made.dtype == np.float32
    assert {*map(tuple, made.reshape(-1, 3).tolist())} <= {*map(tuple, exemplar.reshape(-1, 3).tolist())}


@pytest.mark.parametrize("size", [(48, 48), (64, 32), (40, 56)])
def test_what_repeats_is_quilted_without_seams(size: tuple[int, int]) -> None:
    """Of sizes that its period divides; across the edges where it tiles."""
    exemplar = waves()
    made = quilted(exemplar, size, np.random.default_rng(0), block=12, overlap=4, tiles=True)
    assert steepest(made) <= 1.01 * steepest(exemplar)
