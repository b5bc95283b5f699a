"""Directions and angles: identities, gradients, known values."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from metapp.appearance.geometry import (
    above_horizon,
    cosines,
    directions_to_rusinkiewicz,
    gauss_legendre,
    half_difference,
    rusinkiewicz_to_directions,
)

RandomAngles = Callable[..., Tensor]


def random_directions(rng: torch.Generator, count: int = 1000) -> Tensor:
    directions = torch.nn.functional.normalize(torch.randn(count, 3, generator=rng, dtype=torch.float64), dim=-1)
    directions[:, 2].abs_()
    return directions


def test_angles_survive_the_way_to_directions_and_back(random_angles: RandomAngles) -> None:
    angles = random_angles(above=False)
    wi, wo = rusinkiewicz_to_directions(angles)
    torch.testing.assert_close(directions_to_rusinkiewicz(wi, wo), angles, rtol=0, atol=1e-10)
    assert torch.equal(above_horizon(angles), (wi[:, 2] > 0) & (wo[:, 2] > 0))
    assert not above_horizon(angles).all()


def test_swapping_or_turning_the_directions_changes_no_angle(rng: torch.Generator) -> None:
    wi, wo = random_directions(rng), random_directions(rng)
    angles = directions_to_rusinkiewicz(wi, wo)
    assert ((angles[:, 2] >= 0) & (angles[:, 2] < math.pi)).all()
    torch.testing.assert_close(directions_to_rusinkiewicz(wo, wi), angles, rtol=0, atol=1e-10)
    cosine, sine = math.cos(1.2), math.sin(1.2)
    turn = torch.tensor([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]], dtype=torch.float64)
    torch.testing.assert_close(directions_to_rusinkiewicz(wi @ turn, wo @ turn), angles, rtol=0, atol=1e-10)


def test_half_and_difference_vectors_are_what_their_names_say(random_angles: RandomAngles) -> None:
    angles = random_angles()
    wi, wo = rusinkiewicz_to_directions(angles)
    half, difference = half_difference(angles).split(3, -1)
    torch.testing.assert_close(half, torch.nn.functional.normalize(wi + wo, dim=-1), rtol=0, atol=1e-10)
    torch.testing.assert_close((wi * half).sum(-1), angles[:, 1].cos())
    torch.testing.assert_close((wo * half).sum(-1), angles[:, 1].cos())
    torch.testing.assert_close(difference.norm(dim=-1), torch.ones(len(angles), dtype=torch.float64))
    at = cosines(angles)
    torch.testing.assert_close(at.incident, wi[:, 2], rtol=0, atol=1e-12)
    torch.testing.assert_close(at.outgoing, wo[:, 2], rtol=0, atol=1e-12)


def test_known_directions() -> None:
    up, side = torch.tensor([0.0, 0.0, 1.0]), torch.tensor([1.0, 0.0, 0.0])
    torch.testing.assert_close(directions_to_rusinkiewicz(up, up), torch.zeros(3))
    torch.testing.assert_close(directions_to_rusinkiewicz(side, up)[:2], torch.full((2,), math.pi / 4))
    torch.testing.assert_close(directions_to_rusinkiewicz(side, -side)[1], torch.tensor(math.pi / 2))
    wi, wo = rusinkiewicz_to_directions(torch.tensor([0.5, 0.5, 0.0]))
    torch.testing.assert_close(wi, torch.tensor([math.sin(1), 0, math.cos(1)]))
    torch.testing.assert_close(wo, up)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_gradients_are_finite_where_angles_are_undefined(dtype: torch.dtype) -> None:
    up, side = torch.tensor([0.0, 0.0, 1.0], dtype=dtype), torch.tensor([1.0, 0.0, 0.0], dtype=dtype)
    slanted = torch.tensor([0.6, 0.0, 0.8], dtype=dtype)
    for one, other in [(up, up), (slanted, slanted), (slanted, slanted * torch.tensor([-1, 1, 1])), (side, up)]:
        wi, wo = one.clone().requires_grad_(), other.clone().requires_grad_()
        angles = directions_to_rusinkiewicz(wi, wo)
        assert angles.isfinite().all()
        for gradient in torch.autograd.grad(angles.sum(), (wi, wo)):
            assert gradient.isfinite().all()


def test_gauss_legendre_agrees_with_numpy() -> None:
    nodes, weights = np.polynomial.legendre.leggauss(17)
    torch.testing.assert_close(gauss_legendre(17)[0], torch.from_numpy((nodes + 1) / 2), rtol=0, atol=1e-14)
    torch.testing.assert_close(gauss_legendre(17)[1], torch.from_numpy(weights / 2), rtol=0, atol=1e-14)
