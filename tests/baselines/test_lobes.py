"""GGX lobes: they recover their own parameters."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from metapp.appearance.geometry import cosines
from metapp.appearance.reflection import fresnel_schlick, microfacet_lobe
from metapp.baselines import lobes


@pytest.fixture
def at(random_angles: Callable[..., Tensor]) -> lobes.Cosines:
    return cosines(random_angles(3000))


def seen(numbers: Tensor, at: lobes.Cosines) -> lobes.Samples:
    return lobes.Samples(at, torch.log1p(lobes.reflectance(numbers, at) * at.incident[:, None]))


def test_a_lobe_is_that_of_the_microfacet_model(at: lobes.Cosines) -> None:
    numbers = torch.tensor([0.3, 0.2, 0.1, math.log(0.2), 0.04, 1.0, 1.0, 1.0], dtype=torch.float64)
    expected = microfacet_lobe(at, 0.2, lambda cos: fresnel_schlick(cos, 0.04)) + numbers[:3] / math.pi
    torch.testing.assert_close(lobes.reflectance(numbers, at), expected)


def test_slopes_are_those_of_finite_differences(at: lobes.Cosines) -> None:
    numbers = torch.tensor([0.3, 0.2, 0.1, math.log(0.2), 0.04, 1.0, 0.7, 0.4, math.log(0.5), 0.3, 0.2, 0.1, 0.6])
    numbers, step = numbers.double(), 1e-6
    found = lobes.slopes(numbers, at)
    for i, unit in enumerate(torch.eye(len(numbers), dtype=torch.float64)):
        above, below = (lobes.reflectance(numbers + sign * step * unit, at) for sign in (1, -1))
        torch.testing.assert_close(found[..., i], (above - below) / (2 * step), atol=1e-7, rtol=1e-5)


@pytest.mark.parametrize("alpha", [0.05, 0.3])
def test_one_lobe_recovers_its_own_parameters(at: lobes.Cosines, alpha: float) -> None:
    numbers = torch.tensor([0.3, 0.05, 0.6, math.log(alpha), 0.1, 0.5, 0.8, 0.2], dtype=torch.float64)
    found = lobes.fit(seen(numbers, at), 1)
    torch.testing.assert_close(found, numbers, atol=0.01, rtol=0.01)


def test_two_lobes_fit_their_own_material(at: lobes.Cosines) -> None:
    wide, narrow = [math.log(0.4), 0.05, 0.9, 0.5, 0.4], [math.log(0.06), 0.04, 0.3, 0.3, 0.3]
    numbers = torch.tensor([0.1, 0.2, 0.05, *wide, *narrow], dtype=torch.float64)
    target = seen(numbers, at)
    errors = [(seen(lobes.fit(target, count), at).target - target.target).abs().mean().item() for count in (1, 2)]
    assert errors[1] < 2e-4
    assert errors[1] < 0.1 * errors[0]


def test_a_fit_is_a_brdf(at: lobes.Cosines, rng: torch.Generator) -> None:
    target = lobes.Samples(at, torch.rand(len(at.half), 3, generator=rng, dtype=torch.float64))
    found = lobes.fit(target, 1)
    assert len(found) == 3 + lobes.LOBE == 8
    assert lobes.reflectance(found, at).min() >= 0
