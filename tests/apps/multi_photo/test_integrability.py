"""Curls of slopes against closed forms, and the equations that couple slopes against dense ones."""

import torch
from torch import Generator, Tensor

from metapp.apps.svbrdf_nonstationary.multi_photo.integrability import find_curl, find_slopes_of_curl, solve_slopes

ROWS, COLUMNS = 5, 6


def draw(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=Generator().manual_seed(seed), dtype=torch.float64)


def draw_equations(rows: int = ROWS, columns: int = COLUMNS) -> tuple[Tensor, Tensor, Tensor]:
    """Positive definite matrices of two tasks, weights of curls and a right side."""
    factor = draw(2, 2, 2, rows, columns, seed=1)
    precision = torch.einsum("tikhw,tjkhw->tijhw", factor, factor) + 0.1 * torch.eye(2)[:, :, None, None].double()
    return precision, draw(2, rows - 1, columns - 1, seed=2).square(), draw(2, 2, rows, columns, seed=3)


def test_slopes_of_a_smooth_height_have_no_curl_and_those_of_a_whirl_have() -> None:
    """Height x^2 + x y has slopes that change linearly, as those of a whirl (-y, x) do, whose curl is -2."""
    y, x = torch.meshgrid(-torch.arange(ROWS).double(), torch.arange(COLUMNS).double(), indexing="ij")
    gradient, whirl = torch.stack([2 * x + y, x])[None], torch.stack([-y, x])[None]
    assert float(find_curl(-gradient).abs().max()) < 1e-12
    torch.testing.assert_close(find_curl(whirl), torch.full((1, ROWS - 1, COLUMNS - 1), -2.0).double())


def test_transpose_of_the_curl() -> None:
    slopes, curl = draw(2, 2, ROWS, COLUMNS), draw(2, ROWS - 1, COLUMNS - 1, seed=4)
    left, right = (find_curl(slopes) * curl).sum(), (slopes * find_slopes_of_curl(curl)).sum()
    torch.testing.assert_close(left, right)


def test_solved_slopes_fulfil_their_equations() -> None:
    precision, weight, right_side = draw_equations()
    slopes = solve_slopes(precision, weight, right_side)
    left = (precision * slopes[:, None]).sum(2) + find_slopes_of_curl(weight * find_curl(slopes))
    assert float((left - right_side).norm() / right_side.norm()) < 2e-3


def test_curls_become_small_as_their_weight_grows() -> None:
    precision, weight, right_side = draw_equations()
    free, bound = (
        find_curl(solve_slopes(precision, factor * torch.ones_like(weight), right_side)) for factor in (1e-6, 1e2)
    )
    assert float(bound.abs().mean()) < 0.05 * float(free.abs().mean())


def test_derivatives_of_solved_slopes() -> None:
    inputs = [value.requires_grad_() for value in draw_equations(3, 4)]

    def symmetric(precision: Tensor, weight: Tensor, right_side: Tensor) -> Tensor:
        precision = (precision + precision.transpose(1, 2)) / 2
        return solve_slopes(precision, weight, right_side, relative_residual=1e-12, max_iterations=200)

    assert torch.autograd.gradcheck(symmetric, inputs)
