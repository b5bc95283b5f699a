"""Generators of pictures: pictures tile, and tasks and pictures beside each other are independent."""

import functools
import itertools
from collections.abc import Callable

import pytest
import torch
from torch import Generator, Tensor
from torch.nn.functional import avg_pool2d

from metapp.learning.task import Params
from metapp.networks import layers
from metapp.networks.field import LocalField, evaluate_by_rows, regrid
from metapp.networks.generators import Pyramid, UNet
from metapp.networks.layers import enlarge_periodic

UNET, PYRAMID = UNet(4, levels=3, noise=2, code=5), Pyramid(4, levels=3, noise=2, code=5)


@pytest.fixture(params=[UNET, PYRAMID], ids=["U-Net", "pyramid"])
def network(request: pytest.FixtureRequest) -> UNet | Pyramid:
    return request.param


def double(params: Params) -> Params:
    return {key: value.double() for key, value in params.items()}


@pytest.fixture
def theta(network: UNet | Pyramid, rng: Generator) -> Params:
    return double(network.init(rng, 3))


@pytest.fixture
def noise(rng: Generator) -> Tensor:
    return torch.randn(3, 2, 2, 16, 24, generator=rng, dtype=torch.float64)


def one(params: Params, task: int) -> Params:
    return {key: value[task : task + 1] for key, value in params.items()}


# What they compute


def layer(theta: Params, name: str, x: Tensor) -> Tensor:
    """A styled convolution written out, without a task axis."""
    kernel = theta[f"{name}.kernel"]
    y = torch.zeros(kernel.shape[0], *x.shape[1:], dtype=x.dtype)
    for down, across in itertools.product((-1, 0, 1), repeat=2):
        y += torch.einsum("oi,ihw->ohw", kernel[:, :, down + 1, across + 1], x.roll((-down, -across), (1, 2)))
    y = (y - y.mean((1, 2), keepdim=True)) / (y.var((1, 2), keepdim=True, correction=0) + 1e-5).sqrt()
    gain, shift = (theta[f"{name}.style"] @ theta["z"] + theta[f"{name}.shift"]).chunk(2)
    y = y * (1 + gain[:, None, None]) + shift[:, None, None]
    return torch.where(y > 0, y, 0.2 * y)


def out(theta: Params, name: str, x: Tensor) -> Tensor:
    return torch.einsum("oi,ihw->ohw", theta[f"{name}.kernel"][:, :, 0, 0], x) + theta[f"{name}.shift"][:, None, None]


def unet_by_hand(theta: Params, noise: Tensor) -> Tensor:
    """Return one picture [C, H, W] by a U-Net of two levels, written out."""
    fine = layer(theta, "down0", noise)
    coarse = layer(theta, "down1", fine.unflatten(1, (-1, 2)).unflatten(3, (-1, 2)).mean((2, 4)))
    both = torch.cat([coarse.repeat_interleave(2, 1).repeat_interleave(2, 2), fine])
    return out(theta, "out", layer(theta, "up0", both))


def pyramid_by_hand(theta: Params, noise: Tensor) -> Tensor:
    """Return one picture [C, H, W] by a pyramid of one level, written out."""
    return out(theta, "out0", layer(theta, "draw0", layer(theta, "join0", noise)))


@pytest.mark.parametrize(
    ("network", "by_hand"),
    [(UNET._replace(levels=2), unet_by_hand), (PYRAMID._replace(levels=1), pyramid_by_hand)],
    ids=["U-Net", "pyramid"],
)
def test_small_network_agrees_with_one_written_by_hand(
    network: UNet | Pyramid, by_hand: Callable[[Params, Tensor], Tensor], rng: Generator
) -> None:
    theta = {key: value + 0.1 for key, value in double(network.init(rng, 2)).items()}
    noise = torch.randn(2, 3, 2, 6, 8, generator=rng, dtype=torch.float64)
    result = network(theta, noise)
    for task, picture in itertools.product(range(2), range(3)):
        task_theta = {key: value[task] for key, value in theta.items()}
        torch.testing.assert_close(result[task, picture], by_hand(task_theta, noise[task, picture]))


@pytest.mark.parametrize("levels", [1, 2, 3, 4])
def test_pictures_shift_with_their_noise_and_wrap_around(network: UNet | Pyramid, levels: int, rng: Generator) -> None:
    network = network._replace(levels=levels)
    theta, step = double(network.init(rng, 2)), 2 ** (levels - 1)
    noise = torch.randn(2, 2, 2, 4 * step, 6 * step, generator=rng, dtype=torch.float64)
    result = network(theta, noise)
    for shift in ((step, 0), (0, step), (-2 * step, 3 * step)):
        torch.testing.assert_close(network(theta, noise.roll(shift, (-2, -1))), result.roll(shift, (-2, -1)))
    if levels > 1:  # the coarser grids have their places; a network of one level has none
        assert (network(theta, noise.roll(1, -1)) - result.roll(1, -1)).abs().mean() > 0.05 * result.std()


def test_tasks_and_pictures_are_independent(network: UNet | Pyramid, theta: Params, noise: Tensor) -> None:
    """No gradient reaches another task; tasks may share expanded parameters, as those of an initialisation."""
    together = network(theta, noise)
    torch.testing.assert_close(together, torch.cat([network(one(theta, i), noise[i : i + 1]) for i in range(3)]))
    torch.testing.assert_close(together, torch.cat([network(theta, noise[:, i : i + 1]) for i in range(2)], 1))
    other = {key: torch.cat([value[:1], 2 * value[1:] + 1]) for key, value in theta.items()}
    torch.testing.assert_close(network(other, noise)[0], together[0])
    shared = {key: value[:1].expand(3, *value.shape[1:]) for key, value in theta.items()}
    copied = {key: value.contiguous() for key, value in shared.items()}
    assert torch.equal(network(shared, noise), network(copied, noise))
    leaves = {key: value.clone().requires_grad_() for key, value in theta.items()}
    grads = torch.autograd.grad(network(leaves, noise)[1].square().sum(), list(leaves.values()))
    for key, grad in zip(leaves, grads, strict=True):
        assert not grad[[0, 2]].any(), key
        assert grad[1].any(), key  # and every parameter matters


# The levels of a pyramid


@pytest.mark.parametrize("network", [PYRAMID], indirect=True)
def test_a_coarse_level_makes_what_the_finer_ones_correct(theta: Params, noise: Tensor) -> None:
    """Without the finest level's own picture, the whole is the enlarged picture of the level above."""
    silent = theta | {key: torch.zeros_like(theta[key]) for key in ("out0.kernel", "out0.shift")}
    small = PYRAMID._replace(finest=1)(theta, 2 * avg_pool2d(noise.flatten(0, 1), 2).unflatten(0, (3, 2)))
    assert small.shape == (3, 2, 3, 8, 12)
    torch.testing.assert_close(PYRAMID(silent, noise)[0], enlarge_periodic(small[0]))


@pytest.mark.parametrize("network", [PYRAMID], indirect=True)
def test_large_pictures_are_generated_by_rows(theta: Params, rng: Generator) -> None:
    """Results agree to rounding with those that gradients are kept of, also where the last rows are fewer."""
    noise = torch.randn(3, 1, 2, 5 * layers.STRIP_ROWS // 2, 8, generator=rng, dtype=torch.float64)
    whole = PYRAMID(theta, noise)  # the finer two of its three levels have more rows than a strip
    with torch.no_grad():
        torch.testing.assert_close(PYRAMID(theta, noise), whole)


def test_maps_above_are_convolved_as_if_enlarged(rng: Generator) -> None:
    """Values and gradients, for tasks beside each other."""
    draw = functools.partial(torch.randn, generator=rng, dtype=torch.float64)
    above, x, kernel = draw(2, 3 * 4, 5, 6), draw(2, 3 * 2, 10, 12), draw(3, 7, 6, 3, 3)
    parameters = {"z": draw(3, 5), "a.kernel": kernel, "a.style": draw(3, 14, 5), "a.shift": draw(3, 14)}
    leaves = [tensor.requires_grad_() for tensor in (above, x, kernel)]
    joined = torch.cat([part.unflatten(1, (3, -1)) for part in (enlarge_periodic(above), x)], 2).flatten(1, 2)
    expected, result = layers.apply_styled(parameters, "a", joined), layers.apply_styled(parameters, "a", x, above)
    torch.testing.assert_close(result, expected)
    pull = draw(*result.shape)
    for first, other in zip(*(torch.autograd.grad(of, leaves, pull) for of in (result, expected)), strict=True):
        torch.testing.assert_close(first, other)


# Maps enlarged across their edges


def test_bilinear_enlargement_wraps_around(rng: Generator) -> None:
    """Means of neighbours by 3 to 1, also across the edges; the mean of the map stays."""
    x = torch.randn(1, 2, 4, 6, generator=rng, dtype=torch.float64)
    result = enlarge_periodic(x)
    across = torch.stack([0.25 * x.roll(1, -1) + 0.75 * x, 0.75 * x + 0.25 * x.roll(-1, -1)], -1).flatten(-2)
    down = torch.stack([0.25 * across.roll(1, -2) + 0.75 * across, 0.75 * across + 0.25 * across.roll(-1, -2)], -2)
    torch.testing.assert_close(result, down.flatten(-3, -2))
    torch.testing.assert_close(result.mean((-1, -2)), x.mean((-1, -2)))


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
    result = FIELD(theta, places(2))
    assert result.shape == (2, 3, 8, 16)
    torch.testing.assert_close(result, result[..., :1, :1].expand_as(result))


def test_large_fields_are_evaluated_by_rows(rng: Generator) -> None:
    """Results agree to rounding, in the order of the rows, also where the last rows are fewer."""
    field = FIELD._replace(height=21, width=16)
    theta, seen = double(field.init(rng, 2)), places(2, field).double()
    whole = field(theta, seen)
    rows = list(evaluate_by_rows(field, theta, seen, texels=5 * 16))
    assert [part.shape[-2] for part in rows] == [5, 5, 5, 5, 1]
    torch.testing.assert_close(torch.cat(rows, -2), whole)


def test_periodic_codes_wrap_around(rng: Generator) -> None:
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


# A code on a finer grid


def test_fields_are_evaluated_on_finer_grids(rng: Generator) -> None:
    """Linear between centres, also across the edges of a periodic grid; the same grid is left alone."""
    values = torch.randn(1, 2, 4, 8, generator=rng)
    assert regrid(values, 4, 8, periodic=True) is values
    fine, turned = (regrid(grid_values, 8, 16, periodic=True) for grid_values in (values, values.roll(3, -1)))
    torch.testing.assert_close(fine.roll(6, -1), turned)
    for periodic in (True, False):
        constant = regrid(torch.full((1, 2, 3, 5), 0.7), 12, 20, periodic=periodic)
        torch.testing.assert_close(constant, torch.full((1, 2, 12, 20), 0.7))
    fine = regrid(torch.arange(4.0).expand(1, 1, 3, 4), 3, 8, periodic=False)
    torch.testing.assert_close(fine[0, 0, 1], torch.tensor([0, 0.25, 0.75, 1.25, 1.75, 2.25, 2.75, 3]))
