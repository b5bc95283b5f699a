"""How strong the finest detail of pictures is, which statistics of features say little of."""

from __future__ import annotations

import math
from functools import lru_cache

import torch
from torch import Tensor
from torch.nn.functional import avg_pool2d, conv2d

SQUARE_PX = 4  # px of the squares whose cosine waves are looked at
STRIDE_PX = 3  # px from one square to the next; odd, so that they see both phases of waves of 2 px
WINDOW_PX = 8  # px of the windows in which waves of 2 px are summed with their signs
FAINTEST_WAVE = 0.003  # display values; what is weaker is noise


def detail(pictures: Tensor) -> Tensor:
    """Root mean squares of waves of 2 to 8 px in display values of pictures [..., C, H, W].

    Of the 15 cosine waves in squares of 4 px, one every 3 px, and of the three waves of 2 px with equal phase over
    8 px: these are strong where a network repeats its own grid, which the squares do not tell from noise.

    Returns:
        [..., C, 18].
    """
    images = pictures.reshape(-1, 1, *pictures.shape[-2:])
    powers = [conv2d(images, _waves().to(images), stride=STRIDE_PX).square().mean((-1, -2))]
    rows, columns = (1 - 2 * (torch.arange(side).to(images) % 2) for side in images.shape[-2:])
    for sign in (rows[:, None], columns, rows[:, None] * columns):
        powers.append(WINDOW_PX * avg_pool2d(images * sign, WINDOW_PX, WINDOW_PX // 2).square().mean((-1, -2)))
    result: Tensor = (torch.cat(powers, 1) + 1e-10).sqrt()  # it has a derivative at 0, too
    return result.reshape(*pictures.shape[:-2], -1)


def softness(made: Tensor, wanted: Tensor) -> Tensor:
    """Mean over channels and waves of how far `detail` [..., C, N] is apart, the logarithm of the ratio, [...]."""
    return ((made + FAINTEST_WAVE) / (wanted + FAINTEST_WAVE)).log().abs().mean((-1, -2))


@lru_cache(maxsize=1)
def _waves() -> Tensor:
    """Orthonormal cosine waves [15, 1, 4, 4] of squares of 4 px, without the mean."""
    at = torch.arange(SQUARE_PX)
    waves = torch.cos(math.pi * (at + 0.5) * at[:, None] / SQUARE_PX)
    waves = waves / waves.norm(dim=1, keepdim=True)
    return torch.einsum("ai,bj->abij", waves, waves).reshape(-1, 1, SQUARE_PX, SQUARE_PX)[1:]
