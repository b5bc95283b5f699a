"""Maps that tile: padded and enlarged across their edges, at the cost of one copy each way.

What autograd would record for circular padding is a copy for each edge, whose gradient fills a whole map with zeros.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import interpolate, pad


class _Tiled(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        return pad(x, (1, 1, 1, 1), mode="circular")

    @staticmethod
    def backward(ctx: Any, pull: Tensor) -> Tensor:
        apply: Callable[[Tensor], Tensor] = _Folded.apply
        return apply(pull)


class _Folded(torch.autograd.Function):
    """The adjoint of padding: what lies outside is added to what it is a copy of."""

    @staticmethod
    def forward(ctx: Any, x: Tensor) -> Tensor:
        rows = x[..., 1:-1, :].clone()
        rows[..., 0, :] += x[..., -1, :]
        rows[..., -1, :] += x[..., 0, :]
        folded = rows[..., 1:-1].contiguous()
        folded[..., 0] += rows[..., -1]
        folded[..., -1] += rows[..., 0]
        return folded

    @staticmethod
    def backward(ctx: Any, pull: Tensor) -> Tensor:
        return tiled(pull)


def tiled(x: Tensor) -> Tensor:
    """Maps [..., H, W] with one row and column of the opposite edge around them, [..., H + 2, W + 2]."""
    apply: Callable[[Tensor], Tensor] = _Tiled.apply
    return apply(x)


def enlarged(x: Tensor) -> Tensor:
    """Maps [B, C, H, W] twice as high and wide, interpolated linearly across their edges, [B, C, 2H, 2W]."""
    # cropped by padding, whose gradient is one copy
    return pad(interpolate(tiled(x), scale_factor=2, mode="bilinear"), (-2, -2, -2, -2))
