"""How radiance of any range is shown."""

from __future__ import annotations

import torch

from metapp.appearance.colour import linear_to_srgb, srgb_to_linear, stretched, tone_map


def test_srgb_is_the_standards() -> None:
    """IEC 61966-2-1: 12.92 times the value up to 0.0031308, a power above, each the inverse of the other."""
    linear = torch.tensor([0.0, 0.001, 0.003, 0.0031308, 0.2140411, 1.0], dtype=torch.float64)
    display = torch.tensor([0.0, 0.01292, 0.03876, 0.0404499, 0.5, 1.0], dtype=torch.float64)
    torch.testing.assert_close(linear_to_srgb(linear), display, atol=1e-6, rtol=0)
    torch.testing.assert_close(srgb_to_linear(display), linear, atol=1e-6, rtol=0)
    shades = torch.arange(256, dtype=torch.float64) / 255
    torch.testing.assert_close(linear_to_srgb(srgb_to_linear(shades)), shades)


def test_tone_map_keeps_order_and_any_radiance_displays() -> None:
    radiance = torch.cat([torch.zeros(1), torch.logspace(-4, 6, 400)]).double()
    shown = tone_map(radiance)
    assert shown[0] == 0
    assert (shown.diff() > 0).all()
    assert shown[-1] < 1
    torch.testing.assert_close(tone_map(torch.ones(2, 3)), linear_to_srgb(torch.full((2, 3), 0.5)))
    assert tone_map(torch.tensor(-1.0)) == 0


def test_stretched_values_come_back_and_a_plane_is_black() -> None:
    values = torch.randn(7, 5, generator=torch.Generator().manual_seed(0), dtype=torch.float64) * 30 - 4
    shown, low, high = stretched(values)
    assert (shown.min(), shown.max()) == (0, 1)
    torch.testing.assert_close(low + shown * (high - low), values)
    shown, low, high = stretched(torch.full((2, 2), -3.0))
    assert (shown.tolist(), low, high) == ([[0, 0], [0, 0]], -3, -3)
