"""The generator: that it tiles, that tasks and pictures beside each other change nothing, and what it starts from."""

from __future__ import annotations

import itertools
import math

import pytest
import torch
from torch import Generator, Tensor

from metapp.learning.task import Params
from metapp.networks import strips
from metapp.networks.layers import LocalField, UNet
from tests.networks.precise import double

NETWORK = UNet(4, levels=3, noise=2, code=5)


def one(params: Params, task: int) -> Params:
    return {key: value[task : task + 1] for key, value in params.items()}


# What it computes


def by_hand(theta: Params, noise: Tensor) -> Tensor:
    """One picture [C, H, W] by a network of two levels, without a task axis."""

    def layer(name: str, x: Tensor) -> Tensor:
        kernel = theta[f"{name}.kernel"]
        y = torch.zeros(kernel.shape[0], *x.shape[1:], dtype=x.dtype)
        for down, across in itertools.product((-1, 0, 1), repeat=2):
            tap = kernel[:, :, down + 1, across + 1]
            y += torch.einsum("oi,ihw->ohw", tap, x.roll((-down, -across), (1, 2)))
        y = (y - y.mean((1, 2), keepdim=True)) / (y.var((1, 2), keepdim=True, correction=0) + 1e-5).sqrt()
        gain, shift = (theta[f"{name}.style"] @ theta["z"] + theta[f"{name}.shift"]).chunk(2)
        y = y * (1 + gain[:, None, None]) + shift[:, None, None]
        return torch.where(y > 0, y, 0.2 * y)

    fine = layer("down0", noise)
    coarse = layer("down1", fine.unflatten(1, (-1, 2)).unflatten(3, (-1, 2)).mean((2, 4)))
    both = torch.cat([coarse.repeat_interleave(2, 1).repeat_interleave(2, 2), fine])
    made = torch.einsum("oi,ihw->ohw", theta["out.kernel"][:, :, 0, 0], layer("up0", both))
    return made + theta["out.shift"][:, None, None]


def test_two_levels_written_out(rng: Generator) -> None:
    network = NETWORK._replace(levels=2)
    theta = {key: value + 0.1 for key, value in double(network.init(rng, 2)).items()}
    noise = torch.randn(2, 3, 2, 6, 8, generator=rng, dtype=torch.float64)
    made = network(theta, noise)
    for task, picture in itertools.product(range(2), range(3)):
        own = {key: value[task] for key, value in theta.items()}
        torch.testing.assert_close(made[task, picture], by_hand(own, noise[task, picture]))


# What it promises


@pytest.mark.parametrize("levels", [1, 2, 3, 4])
def test_what_it_makes_moves_with_the_noise_and_round_the_edges(levels: int, rng: Generator) -> None:
    network = NETWORK._replace(levels=levels)
    theta, step = double(network.init(rng, 2)), 2 ** (levels - 1)
    noise = torch.randn(2, 2, 2, 4 * step, 6 * step, generator=rng, dtype=torch.float64)
    made = network(theta, noise)
    for down, across in ((step, 0), (0, step), (-2 * step, 3 * step)):
        moved = network(theta, noise.roll((down, across), (-2, -1)))
        torch.testing.assert_close(moved, made.roll((down, across), (-2, -1)))
    if levels > 1:  # the coarser grids have their places; a network of one level has none
        moved = network(theta, noise.roll(1, -1))
        assert (moved - made.roll(1, -1)).abs().mean() > 0.05 * made.std()


def test_what_it_makes_does_not_know_the_place(theta: Params) -> None:
    """Noise that is alike in every cell of the coarsest grid is treated alike."""
    noise = torch.randn(3, 1, 2, 4, 4, dtype=torch.float64).repeat(1, 1, 1, 4, 6)
    made = NETWORK(theta, noise)
    torch.testing.assert_close(made, made[..., :4, :4].repeat(1, 1, 1, 4, 6))


def test_tasks_are_independent(theta: Params, noise: Tensor) -> None:
    together = NETWORK(theta, noise)
    alone = [NETWORK(one(theta, task), noise[task : task + 1]) for task in range(3)]
    torch.testing.assert_close(together, torch.cat(alone))
    other = {key: torch.cat([value[:1], 2 * value[1:] + 1]) for key, value in theta.items()}
    torch.testing.assert_close(NETWORK(other, noise)[0], together[0])


def test_pictures_are_independent(theta: Params, noise: Tensor) -> None:
    together = NETWORK(theta, noise)
    alone = [NETWORK(theta, noise[:, picture : picture + 1]) for picture in range(2)]
    torch.testing.assert_close(together, torch.cat(alone, 1))


def test_a_task_gets_no_gradient_from_another(theta: Params, noise: Tensor) -> None:
    leaves = {key: value.clone().requires_grad_() for key, value in theta.items()}
    grads = torch.autograd.grad(NETWORK(leaves, noise)[1].square().sum(), list(leaves.values()))
    for key, grad in zip(leaves, grads, strict=True):
        assert not grad[[0, 2]].any(), key
        assert grad[1].any(), key  # and every parameter matters


@pytest.mark.parametrize("size", [(4, 8), (8, 8), (20, 12), (64, 32)])
def test_sizes(size: tuple[int, int], rng: Generator) -> None:
    network = UNet(4, levels=3, noise=3, code=2, outputs=6)
    assert network(network.init(rng, 2), torch.randn(2, 3, 3, *size, generator=rng)).shape == (2, 3, 6, *size)


def test_channels_double_up_to_four_times_the_width() -> None:
    network = UNet(16, levels=5)
    assert [network.channels(level) for level in range(5)] == [16, 32, 64, 64, 64]
    assert network.layers() == {
        "down0": (8, 16),
        "down1": (16, 32),
        "down2": (32, 64),
        "down3": (64, 64),
        "down4": (64, 64),
        "up3": (128, 64),
        "up2": (128, 64),
        "up1": (96, 32),
        "up0": (48, 16),
    }


def test_expanded_parameters_do_as_well(theta: Params, noise: Tensor) -> None:
    """As a start that all tasks share comes."""
    shared = {key: value[:1].expand(3, *value.shape[1:]) for key, value in theta.items()}
    copied = {key: value.contiguous() for key, value in shared.items()}
    assert torch.equal(NETWORK(shared, noise), NETWORK(copied, noise))


def test_the_code_changes_what_is_made(theta: Params, noise: Tensor) -> None:
    made = NETWORK(theta, noise)
    other = NETWORK(theta | {"z": theta["z"].flip(1)}, noise)
    assert (made - other).abs().mean() > 0.05 * made.std()
    nothing = NETWORK(theta | {"z": torch.zeros_like(theta["z"])}, noise)
    assert (made - nothing).abs().mean() > 0.05 * made.std()


def test_gradients(rng: Generator) -> None:
    network = UNet(2, levels=2, noise=1, code=2, outputs=1)
    theta = double(network.init(rng, 2))
    noise = torch.randn(2, 1, 1, 4, 4, generator=rng, dtype=torch.float64)

    def made(noise: Tensor, *values: Tensor) -> Tensor:
        return network(dict(zip(theta, values, strict=True)), noise)

    inputs = tuple(value.clone().requires_grad_() for value in (noise, *theta.values()))
    assert torch.autograd.gradcheck(made, inputs)


# What it starts from


def test_initial_parameters(rng: Generator) -> None:
    network = UNet(16)
    theta = network.init(rng, 8)
    expected = {"z", "out.kernel", "out.shift"}
    expected |= {f"{name}.{part}" for name in network.layers() for part in ("kernel", "style", "shift")}
    assert set(theta) == expected
    assert {value.shape[0] for value in theta.values()} == {8}
    assert {value.dtype for value in theta.values()} == {torch.float32}
    scales = {"z": 1.0, "out.kernel": 1 / 4}
    for name, (inputs, outputs) in network.layers().items():
        assert theta[f"{name}.kernel"].shape == (8, outputs, inputs, 3, 3)
        scales |= {f"{name}.kernel": math.sqrt(2 / (9 * inputs)), f"{name}.style": 0.3 / math.sqrt(32)}
    for key, scale in scales.items():
        value = theta[key]
        few = 4 / math.sqrt(value.numel())  # four deviations of a mean of so many draws
        assert abs(float(value.mean())) < scale * few, key
        assert float(value.std()) == pytest.approx(scale, rel=few), key
        assert not torch.equal(value[0], value[1]), key
    assert not any(theta[key].any() for key in expected - scales.keys())


def test_the_same_seed_the_same_network() -> None:
    first, again, other = (NETWORK.init(Generator().manual_seed(seed), 2) for seed in (1, 1, 2))
    assert all(torch.equal(first[key], again[key]) for key in first)
    assert not torch.equal(first["z"], other["z"])


def test_what_it_makes_at_first_is_neither_flat_nor_extreme(rng: Generator) -> None:
    network = UNet(16)
    made = network(network.init(rng, 8), torch.randn(8, 1, 8, 32, 32, generator=rng))
    spread = made.std((-2, -1))
    assert spread.min() > 0.1
    assert spread.mean() < 2
    assert made.abs().max() < 12


# Fields with a code in every place

FIELD = LocalField(8, 16, rows=4, columns=8, code=3, hidden=8, layers=2)


def blind(rng: Generator, count: int, field: LocalField = FIELD) -> Params:
    """Parameters of networks that see their code alone."""
    theta = field.init(rng, count)
    return {key: torch.zeros_like(value) if key.endswith(".kernel") else value for key, value in theta.items()}


def places(count: int, field: LocalField = FIELD) -> Tensor:
    return torch.rand(count, field.inputs, field.height, field.width, generator=Generator().manual_seed(1))


def test_a_code_without_variation_is_the_same_everywhere(rng: Generator) -> None:
    theta = blind(rng, 2) | {"z": torch.randn(2, 3, 1, 1, generator=rng).expand(-1, -1, 4, 8)}
    made = FIELD(theta, places(2))
    assert made.shape == (2, 3, 8, 16)
    torch.testing.assert_close(made, made[..., :1, :1].expand_as(made))


def test_a_large_field_is_made_by_rows(rng: Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same to rounding, also where the last rows are fewer, and each row where it belongs."""
    field = FIELD._replace(height=21, width=16)
    theta, seen = double(field.init(rng, 2)), places(2, field).double()
    whole = field(theta, seen)
    monkeypatch.setattr(strips, "TEXELS", 5 * 16)
    rows = list(strips.field_by_rows(field, theta, seen))
    assert [part.shape[-2] for part in rows] == [5, 5, 5, 5, 1]
    torch.testing.assert_close(torch.cat(rows, -2), whole)


def test_a_code_wraps_around_where_it_is_told(rng: Generator) -> None:
    for periodic in (True, False):
        field = FIELD._replace(periodic=periodic)
        theta = blind(rng, 1, field)
        turned = field({**theta, "z": theta["z"].roll(3, -1)}, places(1))
        assert torch.allclose(turned, field(theta, places(1)).roll(6, -1), atol=1e-5) == periodic


def test_a_cell_of_the_code_reaches_its_neighbourhood_only(rng: Generator) -> None:
    theta = FIELD.init(rng, 1)
    moved = {**theta, "z": theta["z"].clone()}
    moved["z"][0, :, 2, 5] += 1
    rows, columns = (FIELD(moved, places(1)) - FIELD(theta, places(1))).abs().sum((0, 1)).nonzero().T
    assert set(rows.tolist()) == {3, 4, 5, 6}
    assert set(columns.tolist()) == {9, 10, 11, 12}


def test_fields_beside_each_other_are_independent(rng: Generator) -> None:
    theta = FIELD.init(rng, 3)
    alone = FIELD({key: value[1:2] for key, value in theta.items()}, places(3)[1:2])
    torch.testing.assert_close(FIELD(theta, places(3))[1:2], alone)
