"""The confidence of General in the maps that it reads from a photograph.

A map's difference from the truth, at COARSE texels, is taken to have Laplace's distribution, whose scale General
predicts in each place by maximum likelihood (Kendall & Gal 2017). As a prior of fits of photographs it was no use:
validation errors rise with its weight.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d

from metapp.learning.task import Params

COARSE = 64
PARTS = ("diffuse", "specular", "roughness", "normal")  # in the order of `differences`
LEAST = 0.01  # scale that counts as sure
UNKNOWN = 10.0  # log of a scale that says nothing
UNSURE = 0.2  # deviation of a map that is told
ONE_DEVIATION = -math.log(1 - 0.6827)  # of Laplace's scales, within which 68 % lie


def unknown(count: int, device: torch.device) -> Params:
    """The parameter of `count` fits of whose maps nothing is known; no step moves it."""
    return {"deviation": torch.full((count, len(PARTS), COARSE, COARSE), UNKNOWN, device=device)}


def scales(theta: Params) -> Tensor:
    """Laplace's scale of the difference of each map, mean over its channels, [T, 4, COARSE, COARSE]."""
    return LEAST + theta["deviation"].exp()


def surprise(apart: Sequence[Tensor], theta: Params) -> Tensor:
    """Negative log likelihood of how far maps are off, as of `differences`, but for a constant, [T].

    Only `deviation` has a gradient of it.
    """
    scale = scales(theta)
    size = (scale.shape[-2], scale.shape[-1])  # COARSE, or that of a part of the maps
    off = [adaptive_avg_pool2d(part.detach(), size).abs().mean(1, keepdim=True) for part in apart]
    return (torch.cat(off, 1) / scale + scale.log()).mean((1, 2, 3))


def deviations(theta: Params) -> dict[str, Tensor]:
    """By map, what it is farther off than with a chance of 32 %, [T, COARSE, COARSE]; colours at gamma 2.2."""
    return dict(zip(PARTS, (ONE_DEVIATION * scales(theta)).unbind(1), strict=True))


def unsure(theta: Params) -> list[list[str]]:
    """Clauses of each fit on maps whose mean deviation is above UNSURE; none where nothing is known."""
    means = {name: part.mean((1, 2)).tolist() for name, part in deviations(theta).items()}
    return [
        [
            f"{name} may be off by {values[i]:.2f} on average: the photo says little of it"
            for name, values in means.items()
            if UNSURE < values[i] < 1
        ]
        for i in range(len(theta["deviation"]))
    ]
