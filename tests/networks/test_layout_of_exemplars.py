"""Layouts: that they tile, that regular patterns go on across their edges, that others are left as they are."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Generator, Tensor

from metapp.appearance.order import lattice_of
from metapp.networks.layout import as_tile, quilted_layout, requilted

SIZE = 128


def pattern(down: float, across: float) -> Tensor:
    """A picture [3, SIZE, SIZE] of bumps, `down` and `across` px apart; 0: the same everywhere along that axis."""
    y, x = torch.meshgrid(torch.arange(SIZE), torch.arange(SIZE), indexing="ij")
    waves = [(2 * math.pi * at / period).cos() for at, period in ((y, down), (x, across)) if period]
    bumps = torch.stack([0.5 + wave / 4 for wave in waves]).prod(0)
    noise = 0.01 * torch.randn(3, SIZE, SIZE, generator=Generator().manual_seed(0))
    return torch.stack([bumps, 0.8 * bumps, 1 - bumps]) + noise


def across_edges(picture: Tensor) -> float:
    """The mean step between neighbours across the edges over that between all neighbours."""
    steps = [(picture.roll(1, axis) - picture).abs() for axis in (1, 2)]
    edges = torch.cat([steps[0][:, 0].flatten(), steps[1][:, :, 0].flatten()])
    return float(edges.mean() / torch.cat([step.flatten() for step in steps]).mean())


@pytest.mark.parametrize(("down", "across"), [(17.3, 22.7), (19.0, 13.1), (14.6, 27.2)])
def test_regular_patterns_are_stretched_until_they_tile(down: float, across: float) -> None:
    picture = pattern(down, across)
    tiling = as_tile(picture, (SIZE, SIZE))
    assert all(0.85 * SIZE <= side <= SIZE for side in tiling.shape[1:])
    periods = [float(tile) for vector in lattice_of(tiling).vectors if (tile := vector.norm())]
    whole = [SIZE / period for period in periods]
    assert all(abs(count - round(count)) < 0.1 for count in whole)


def test_pictures_without_order_are_left_as_they_are() -> None:
    noise = torch.rand(3, SIZE, SIZE, generator=Generator().manual_seed(1))
    assert as_tile(noise, (SIZE, SIZE)) is noise


def test_layouts_of_regular_patterns_repeat_without_a_seam() -> None:
    layout = quilted_layout(pattern(17.3, 22.7), (32, 32))
    assert layout.shape == (3, 32, 32)
    assert across_edges(layout) < 1.5
    larger = requilted(layout, (64, 96))
    assert larger.shape == (3, 64, 96)
    assert across_edges(larger) < 1.5
    assert torch.equal(layout, quilted_layout(pattern(17.3, 22.7), (32, 32)))
