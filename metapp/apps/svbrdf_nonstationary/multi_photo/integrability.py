"""Integrability: slopes of one surface are the gradient of its height, so that their curl is 0 but at edges.

Each texel has two slopes, but only one height. So neighbours tell something of slopes that photographs leave open. Real
normal maps are not integrable everywhere: heights jump at edges, and slopes of reduced maps are means. So curls are
made small by their rounded absolute value, which lets few of them be large (as robust integration of normals does,
Durou et al. 2009).
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn.functional import pad
from typing_extensions import override

MAX_ITERATIONS = 40  # of conjugate gradients
RELATIVE_RESIDUAL = 1e-3  # the length of the residual, over that of the right side, at which iterations end


def find_curl(slopes: Tensor) -> Tensor:
    """Return the curl of slopes at the corners between four texels each.

    Args:
        slopes: x and y over z of normals, [T, 2, H, W]; y points up, rows go down.

    Returns:
        The change of the first slope from texel to texel upwards minus that of the second to the right,
        [T, H - 1, W - 1].
    """
    x, y = slopes.unbind(1)
    upwards, to_the_right = x[:, :-1] - x[:, 1:], y[:, :, 1:] - y[:, :, :-1]
    curl: Tensor = (upwards[:, :, 1:] + upwards[:, :, :-1] - to_the_right[:, 1:] - to_the_right[:, :-1]) / 2
    return curl


def find_slopes_of_curl(curl: Tensor) -> Tensor:
    """Apply the transpose of :func:`find_curl`: curls [T, H - 1, W - 1] become slopes [T, 2, H, W]."""
    padded = pad(curl, (1, 1, 1, 1)) / 2
    upper, lower = padded[:, :-1], padded[:, 1:]
    x = lower[:, :, 1:] + lower[:, :, :-1] - upper[:, :, 1:] - upper[:, :, :-1]
    y = upper[:, :, 1:] + lower[:, :, 1:] - upper[:, :, :-1] - lower[:, :, :-1]
    return torch.stack([x, y], 1)


class _SolveSlopes(torch.autograd.Function):
    """The solution of :func:`solve_slopes`, whose derivatives take another solution of these equations."""

    @staticmethod
    @override
    def forward(
        ctx: Any,
        precision: Tensor,
        curl_weight: Tensor,
        right_side: Tensor,
        relative_residual: float,
        max_iterations: int,
    ) -> Tensor:
        solution = _conjugate_gradients(precision, curl_weight, right_side, relative_residual, max_iterations)
        ctx.save_for_backward(precision, curl_weight, solution)
        ctx.relative_residual, ctx.max_iterations = relative_residual, max_iterations
        return solution

    @staticmethod
    @once_differentiable
    @override
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, Tensor, Tensor, None, None]:
        precision, curl_weight, solution = ctx.saved_tensors
        adjoint = _conjugate_gradients(precision, curl_weight, gradients[0], ctx.relative_residual, ctx.max_iterations)
        by_precision = -adjoint[:, :, None] * solution[:, None]
        by_weight = -find_curl(adjoint) * find_curl(solution)
        return by_precision, by_weight, adjoint, None, None


def solve_slopes(
    precision: Tensor,
    curl_weight: Tensor,
    right_side: Tensor,
    *,
    relative_residual: float = RELATIVE_RESIDUAL,
    max_iterations: int = MAX_ITERATIONS,
) -> Tensor:
    """Solve linear equations for the slopes of all texels, which their curls couple.

    Args:
        precision: symmetric positive definite matrices of the texels, [T, 2, 2, H, W].
        curl_weight: weights of squared curls, [T, H - 1, W - 1].
        right_side: of the equations, [T, 2, H, W].
        relative_residual: the length of the residual, over that of the right side, at which iterations end.
        max_iterations: the number of iterations of conjugate gradients, at most.

    Returns:
        The slopes s [T, 2, H, W] with precision s + K' (curl_weight K s) = right_side, where K is :func:`find_curl` and
        K' its transpose.
    """
    slopes: Tensor = _SolveSlopes.apply(  # type: ignore[no-untyped-call]
        precision, curl_weight, right_side, relative_residual, max_iterations
    )
    return slopes


def _conjugate_gradients(
    precision: Tensor, curl_weight: Tensor, right_side: Tensor, relative_residual: float, max_iterations: int
) -> Tensor:
    """Solve the equations of :func:`solve_slopes` by conjugate gradients, preconditioned by each texel's own block."""
    corners = pad(curl_weight, (1, 1, 1, 1))
    own_curl_weight = (corners[:, :-1, :-1] + corners[:, :-1, 1:] + corners[:, 1:, :-1] + corners[:, 1:, 1:]) / 4
    a, b, c = precision[:, 0, 0] + own_curl_weight, precision[:, 0, 1], precision[:, 1, 1] + own_curl_weight
    determinant = a * c - b * b

    def multiply(slopes: Tensor) -> Tensor:
        by_texel = (precision * slopes[:, None]).sum(2)
        return by_texel + find_slopes_of_curl(curl_weight * find_curl(slopes))

    def precondition(residual: Tensor) -> Tensor:
        x, y = residual.unbind(1)
        return torch.stack([c * x - b * y, a * y - b * x], 1) / determinant[:, None]

    def dot(first: Tensor, second: Tensor) -> Tensor:
        return (first * second).sum((1, 2, 3), keepdim=True)

    solution = precondition(right_side)
    residual = right_side - multiply(solution)
    tiny = torch.finfo(right_side.dtype).tiny
    bound = relative_residual**2 * dot(right_side, right_side) + tiny
    direction = preconditioned = precondition(residual)
    product = dot(residual, preconditioned)
    for _ in range(max_iterations):
        if bool((dot(residual, residual) <= bound).all()):
            break
        image = multiply(direction)
        length = product / (dot(direction, image) + tiny)
        solution, residual = solution + length * direction, residual - length * image
        preconditioned = precondition(residual)
        next_product = dot(residual, preconditioned)
        direction = preconditioned + next_product / (product + tiny) * direction
        product = next_product
    return solution
