"""Fits of instruments that do not reach grazing angles, beyond these."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

import metapp
from metapp.appearance.geometry import cosines, rusinkiewicz_to_directions, spread_angles

MEASURED, BEYOND = 60, (65, 82)  # degrees


def plastic(angles: Tensor, roughness: float, colour: tuple[float, float, float]) -> Tensor:
    """A colour under a clear coat: GGX with height-correlated masking, Fresnel after Schlick, F0 .04."""
    c = cosines(angles)
    alpha = roughness**2
    density = alpha**2 / (math.pi * (c.half**2 * (alpha**2 - 1) + 1) ** 2)
    masked = [((1 + alpha**2 * (1 / z**2 - 1)).sqrt() - 1) / 2 for z in (c.incident, c.outgoing)]
    coat = density * (0.04 + 0.96 * (1 - c.difference) ** 5) / (4 * c.incident * c.outgoing * (1 + sum(masked)))
    return torch.tensor(colour) / math.pi + coat[..., None]


@pytest.mark.parametrize("roughness", [0.3, 0.8])
@pytest.mark.parametrize("colour", [(0.4, 0.2, 0.1), (0.05, 0.3, 0.1)])
def test_colours_go_on_beyond_what_was_measured(roughness: float, colour: tuple[float, float, float]) -> None:
    """Fits trained on complete materials alone are off by .3 to 1.1 in the channels' log ratios, green rims."""
    angles = spread_angles(16_000).double()
    c = cosines(angles)
    steepest = torch.minimum(c.incident, c.outgoing).clamp(-1, 1).arccos().rad2deg()
    values = plastic(angles, roughness, colour)
    wi, wo = rusinkiewicz_to_directions(angles)
    seen, beyond = steepest < MEASURED, (steepest > BEYOND[0]) & (steepest < BEYOND[1])
    fit = metapp.fit("brdf", (wi[seen].numpy(), wo[seen].numpy(), values[seen].numpy()))
    predicted = torch.as_tensor(fit(wi[beyond].numpy(), wo[beyond].numpy())).double()
    off = (predicted.clamp_min(1e-4) / values[beyond]).log()
    assert float((off - off.mean(1, keepdim=True)).abs().mean()) < 0.05
    assert abs(float(off.mean())) < 0.1
