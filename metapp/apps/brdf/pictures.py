"""Samples of BRDFs as pictures."""

from __future__ import annotations

import itertools
import math

import torch
from torch import Tensor

from metapp.appearance.colour import linear_to_srgb

SIDE, DOT = 96, 3  # px, of a picture of samples and of a sample


def dots(angles: Tensor, reflectance: Tensor) -> Tensor:
    """Draw samples in the half-vector plane: theta_h from left to right, by its root, theta_d from the bottom up.

    Args:
        angles: theta_h, theta_d, phi_d [N, 3] in rad.
        reflectance: linear RGB [N, 3] in 1/sr.

    Returns:
        [SIDE, SIDE, 4], pi f as linear RGB on black, and coverage.
    """
    picture = reflectance.new_zeros(SIDE, SIDE, 4)
    shares = angles[:, :2] / (math.pi / 2)
    x, y = ((SIDE - DOT) * torch.stack([shares[:, 0].sqrt(), 1 - shares[:, 1]])).round().long().clamp(0, SIDE - DOT)
    colour = torch.cat([math.pi * reflectance, torch.ones_like(reflectance[:, :1])], 1)
    for row, column in itertools.product(range(DOT), repeat=2):
        picture[y + row, x + column] = colour
    return picture


def on_white(linear: Tensor) -> Tensor:
    """Linear RGB on black with coverage, [H, W, 4], as sRGB [1, 3, H, W] on white."""
    coverage = linear[..., 3:]
    display = coverage * linear_to_srgb((linear[..., :3] / coverage.clamp_min(1e-6)).clamp(0, 1)) + 1 - coverage
    return display.permute(2, 0, 1)[None]
