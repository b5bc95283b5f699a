"""The generator of several scales: that it tiles, and that its coarse levels make smaller pictures of the same."""

from __future__ import annotations

import itertools

import pytest
import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d, conv2d

from metapp.learning.task import Params
from metapp.networks import pyramid, strips
from metapp.networks.pyramid import Pyramid
from metapp.networks.tiling import enlarged
from tests.networks.precise import double

NETWORK = Pyramid(4, levels=3, noise=2, code=5)


def test_one_level_written_out(rng: Generator) -> None:
    network = NETWORK._replace(levels=1)
    theta = {key: value + 0.1 for key, value in double(network.init(rng, 1)).items()}
    noise = torch.randn(1, 1, 2, 6, 8, generator=rng, dtype=torch.float64)

    def layer(name: str, x: Tensor) -> Tensor:
        y = torch.zeros(4, *x.shape[1:], dtype=x.dtype)
        for down, across in itertools.product((-1, 0, 1), repeat=2):
            tap = theta[f"{name}.kernel"][0, :, :, down + 1, across + 1]
            y += torch.einsum("oi,ihw->ohw", tap, x.roll((-down, -across), (1, 2)))
        y = (y - y.mean((1, 2), keepdim=True)) / (y.var((1, 2), keepdim=True, correction=0) + 1e-5).sqrt()
        gain, shift = (theta[f"{name}.style"][0] @ theta["z"][0] + theta[f"{name}.shift"][0]).chunk(2)
        y = y * (1 + gain[:, None, None]) + shift[:, None, None]
        return torch.where(y > 0, y, 0.2 * y)

    x = layer("draw0", layer("join0", noise[0, 0]))
    expected = conv2d(x[None], theta["out0.kernel"][0], theta["out0.shift"][0])
    torch.testing.assert_close(network(theta, noise)[0], expected)


@pytest.mark.parametrize("levels", [1, 2, 3, 4])
def test_what_it_makes_moves_with_the_noise_and_round_the_edges(levels: int, rng: Generator) -> None:
    network = NETWORK._replace(levels=levels)
    theta, step = double(network.init(rng, 2)), 2 ** (levels - 1)
    noise = torch.randn(2, 2, 2, 4 * step, 6 * step, generator=rng, dtype=torch.float64)
    made = network(theta, noise)
    for shift in ((step, 0), (0, step), (-2 * step, 3 * step)):
        torch.testing.assert_close(network(theta, noise.roll(shift, (-2, -1))), made.roll(shift, (-2, -1)))


def test_tasks_and_pictures_are_independent(theta: Params, noise: Tensor) -> None:
    together = NETWORK(theta, noise)
    alone = [NETWORK({key: value[i : i + 1] for key, value in theta.items()}, noise[i : i + 1]) for i in range(3)]
    torch.testing.assert_close(together, torch.cat(alone))
    torch.testing.assert_close(together, torch.cat([NETWORK(theta, noise[:, i : i + 1]) for i in range(2)], 1))


def test_a_coarse_level_makes_what_the_finer_ones_correct(theta: Params, noise: Tensor) -> None:
    """Without the finest level's own picture, the whole is the enlarged picture of the level above."""
    silent = theta | {key: torch.zeros_like(theta[key]) for key in ("out0.kernel", "out0.shift")}
    small = NETWORK._replace(finest=1)(theta, 2 * avg_pool2d(noise.flatten(0, 1), 2).unflatten(0, (3, 2)))
    assert small.shape == (3, 2, 3, 8, 12)
    torch.testing.assert_close(NETWORK(silent, noise)[0], enlarged(small[0]))


def test_a_coarse_level_leaves_the_finer_ones_alone(theta: Params, noise: Tensor) -> None:
    leaves = {key: value.requires_grad_() for key, value in theta.items()}
    made = NETWORK._replace(finest=1)(leaves, noise).square().sum()
    grads = torch.autograd.grad(made, list(leaves.values()), materialize_grads=True)
    for key, grad in zip(leaves, grads, strict=True):
        assert bool(grad.any()) != (key.split(".")[0] in ("join0", "draw0", "out0")), key


def test_large_pictures_are_made_by_rows(theta: Params, monkeypatch: pytest.MonkeyPatch, rng: Generator) -> None:
    """The same to rounding, also where the last rows are fewer."""
    noise = torch.randn(3, 2, 2, 40, 24, generator=rng, dtype=torch.float64)
    with torch.no_grad():
        whole = NETWORK(theta, noise)
        monkeypatch.setattr(pyramid, "ROWS", 8)
        monkeypatch.setattr(strips, "ROWS", 16)
        torch.testing.assert_close(NETWORK(theta, noise), whole)


def test_enlarged(rng: Generator) -> None:
    """Means of neighbours by 3 to 1, also across the edges; the mean of the map stays."""
    x = torch.randn(1, 2, 4, 6, generator=rng, dtype=torch.float64)
    made = enlarged(x)
    across = torch.stack([0.25 * x.roll(1, -1) + 0.75 * x, 0.75 * x + 0.25 * x.roll(-1, -1)], -1).flatten(-2)
    down = torch.stack([0.25 * across.roll(1, -2) + 0.75 * across, 0.75 * across + 0.25 * across.roll(-1, -2)], -2)
    torch.testing.assert_close(made, down.flatten(-3, -2))
    torch.testing.assert_close(made.mean((-1, -2)), x.mean((-1, -2)))
