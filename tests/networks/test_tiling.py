"""Maps padded and enlarged across their edges: against their definition, and their derivatives."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Generator, Tensor

from metapp.networks.tiling import enlarged, tiled


@pytest.fixture
def rand(rng: Generator) -> Callable[..., Tensor]:
    return lambda *shape: torch.randn(*shape, generator=rng, dtype=torch.float64, requires_grad=True)


@pytest.mark.parametrize("size", [(1, 1), (1, 4), (5, 2), (3, 3)])
def test_padding_continues_on_the_other_side(size: tuple[int, int], rand: Callable[..., Tensor]) -> None:
    x = rand(2, 3, *size)
    rows, columns = ((torch.arange(-1, each + 1) % each) for each in size)
    torch.testing.assert_close(tiled(x), x[..., rows, :][..., columns], rtol=0, atol=0)


@pytest.mark.parametrize("size", [(1, 1), (2, 5), (4, 3)])
@pytest.mark.parametrize("function", [tiled, enlarged])
def test_derivatives_of_both_orders(
    function: Callable[[Tensor], Tensor], size: tuple[int, int], rand: Callable[..., Tensor]
) -> None:
    x = rand(1, 2, *size)
    assert torch.autograd.gradcheck(function, (x,))
    assert torch.autograd.gradgradcheck(lambda each: function(each).sin(), (x,))


def test_the_gradient_does_not_depend_on_how_maps_lie_in_memory(rand: Callable[..., Tensor]) -> None:
    x, weights = rand(2, 3, 4, 5), torch.arange(2 * 3 * 6 * 7, dtype=torch.float64).reshape(2, 3, 6, 7)
    plain, *others = (
        torch.autograd.grad((tiled(each) * weights).sum(), x)[0]
        for each in (x, x.contiguous(memory_format=torch.channels_last), x.transpose(0, 1).contiguous().transpose(0, 1))
    )
    for other in others:
        torch.testing.assert_close(other, plain, rtol=0, atol=0)
