"""The finest detail of pictures: closed forms, energies, gradients."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Generator

from metapp.appearance.detail import FAINTEST_WAVE, detail, softness

COSINES = 15  # of the 18 numbers, the others are of waves of 2 px with equal phase


def waves(kind: str, size: int = 64) -> torch.Tensor:
    """Waves of 2 px, amplitude 1, in pictures [1, 1, size, size]."""
    sign = 1 - 2 * (torch.arange(size, dtype=torch.float64) % 2)
    shown = {"rows": sign[:, None].expand(size, size), "columns": sign.expand(size, size)}
    shown["checkerboard"] = shown["rows"] * shown["columns"]
    return shown[kind][None, None]


@pytest.mark.parametrize(("kind", "place"), [("rows", 0), ("columns", 1), ("checkerboard", 2)])
def test_waves_of_two_pixels_are_one_number_each(kind: str, place: int) -> None:
    """Equal phase everywhere: the window of 8 px sums all of it, the others nothing."""
    found = detail(waves(kind))[0, 0, COSINES:]
    expected = torch.full((3,), 1e-5, dtype=torch.float64)
    expected[place] = math.sqrt(8)
    torch.testing.assert_close(found, expected, atol=1e-6, rtol=1e-9)


def test_cosine_waves_hold_all_power_but_that_of_means(rng: Generator) -> None:
    """Parseval: 16 times the variance in squares of 4 px, the mean over squares."""
    picture = torch.rand(2, 3, 12, 16, generator=rng, dtype=torch.float64)
    variances = picture.unfold(-2, 4, 3).unfold(-2, 4, 3).var((-1, -2), unbiased=False).mean((-1, -2))
    power = detail(picture)[..., :COSINES].square().sum(-1)
    torch.testing.assert_close(power, 16 * variances, atol=1e-6, rtol=1e-6)


def test_softness_is_the_logarithm_of_the_ratio() -> None:
    wanted = torch.rand(2, 3, 18, dtype=torch.float64) + 0.1
    made = (wanted + FAINTEST_WAVE) * 0.5 - FAINTEST_WAVE
    torch.testing.assert_close(softness(made, wanted), torch.full((2,), math.log(2), dtype=torch.float64))
    torch.testing.assert_close(softness(wanted, wanted), torch.zeros(2, dtype=torch.float64))


def test_gradients_are_finite_differences_and_finite_of_nothing(rng: Generator) -> None:
    picture = torch.rand(1, 2, 16, 16, generator=rng, dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(detail, picture)
    grey = torch.full((1, 1, 16, 16), 0.5, requires_grad=True)
    detail(grey).sum().backward()
    assert grey.grad is not None
    assert bool(grey.grad.isfinite().all())
