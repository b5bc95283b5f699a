"""How sure General is of the maps that it reads from a photograph.

A map's difference from the truth, at COARSE texels, is taken to have Laplace's distribution, whose scale General
predicts in each place by maximum likelihood (Kendall & Gal 2017). As a prior of fits of photographs it was no use:
validation errors rise with its weight.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d

from metapp.appearance.flash import Maps
from metapp.apps.svbrdf_nonstationary.maps import shades
from metapp.learning.task import Params

COARSE = 64
PARTS = {"diffuse": 3, "specular": 3, "roughness": 1, "normal": 3}  # channels
LEAST = 0.01  # scale that counts as sure
UNKNOWN = 10.0  # log of a scale that says nothing
UNSURE = 0.2  # deviation of a map that is told
ONE_DEVIATION = -math.log(1 - 0.6827)  # of Laplace's scales, within which 68 % lie


def coarse(maps: Maps) -> Tensor:
    """Maps [T, C, H, W] as they are compared, colours as the eye spaces them, [T, 10, COARSE, COARSE]."""
    parts = torch.cat([shades(maps.diffuse), shades(maps.specular), maps.roughness, maps.normal], 1)
    return adaptive_avg_pool2d(parts, COARSE)


def unknown(count: int, device: torch.device) -> Params:
    """The parameter of `count` fits of whose maps nothing is known; no step moves it."""
    return {"deviation": torch.full((count, len(PARTS), COARSE, COARSE), UNKNOWN, device=device)}


def scales(theta: Params) -> Tensor:
    """Laplace's scale of the difference of each map, mean over its channels, [T, 4, COARSE, COARSE]."""
    return LEAST + theta["deviation"].exp()


def surprise(maps: Tensor, truth: Tensor, theta: Params) -> Tensor:
    """Negative log likelihood of the true `coarse` maps where others were predicted, but for a constant, [T]."""
    scale = scales(theta)
    return (_apart(truth, maps) / scale + scale.log()).mean((1, 2, 3))


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


def _apart(maps: Tensor, others: Tensor) -> Tensor:
    """Mean difference over each map's channels, [T, 4, COARSE, COARSE]."""
    parts = (maps - others).abs().split(list(PARTS.values()), 1)
    return torch.cat([part.mean(1, keepdim=True) for part in parts], 1)
