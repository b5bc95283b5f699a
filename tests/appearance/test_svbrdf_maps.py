"""Statistics of maps."""

import math

import torch

from metapp.appearance.svbrdf_maps import Maps, map_statistics
from tests.surfaces import flat_maps


def test_statistics_of_two_halves_agree_with_worked_values() -> None:
    """Half of the patch bright, shiny and level, half dark, dull and tilted by 30 degrees."""
    bright = flat_maps(1.0, 1.0, 0.9)
    dark = flat_maps(0.25, 0.25, 0.5, normal=(0.0, -0.5, math.sqrt(0.75)))
    found = map_statistics(Maps(*(torch.cat(pair, -1) for pair in zip(bright, dark, strict=True))))
    low = 0.25 ** (1 / 2.2)
    shown = ((1 + low) / 2, (1 - low) / 2)
    expected = torch.tensor([[shown[0]] * 4 + [0.7, 0.25], [shown[1]] * 4 + [0.2, 0.25]], dtype=torch.float64)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-3)
