"""Quilts of patterns: they repeat without a seam, and keep the pattern's order."""

import math

import numpy as np
import pytest
import torch
from torch import Generator, Tensor

from metapp.appearance.lattice import find_lattice, kept_order_share
from metapp.appearance.stretch import stretch_to_tile
from metapp.apps.exemplar.octaves import Octaves
from metapp.apps.exemplar.quilts import choose_quilt, make_piece_source, quilt_places, resize_tile
from metapp.apps.texture.app import GramStatistics

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
def test_regular_patterns_alone_are_stretched_until_they_tile(down: float, across: float) -> None:
    tiling, frequencies = stretch_to_tile(pattern(down, across), (SIZE, SIZE))
    torch.testing.assert_close(frequencies * SIZE, (frequencies * SIZE).round())
    assert all(0.85 * SIZE <= side <= SIZE for side in tiling.shape[1:])
    whole = [SIZE / float(period) for vector in find_lattice(tiling).vectors if (period := vector.norm())]
    assert all(abs(count - round(count)) < 0.1 for count in whole)
    noise = torch.rand(3, SIZE, SIZE, generator=Generator().manual_seed(1))
    unchanged, frequencies = stretch_to_tile(noise, (SIZE, SIZE))
    assert unchanged is noise
    assert not len(frequencies)


def choose(exemplar: Tensor) -> Tensor:
    """Return the best of eight quilts of a pattern, [3, SIZE, SIZE]."""
    statistics = GramStatistics(Octaves(SIZE, SIZE, ("relu1_1", "relu2_1"), count=2))
    places, picture = choose_quilt(exemplar, exemplar, (SIZE, SIZE), statistics, 8)
    assert places.shape == (2, SIZE, SIZE)
    return picture


def test_quilts_of_regular_patterns_repeat_without_a_seam() -> None:
    picture = choose(pattern(17.3, 22.7))
    assert across_edges(picture) < 1.5
    larger = resize_tile(picture, picture, (SIZE, 2 * SIZE)).layers
    assert larger.shape == (3, SIZE, 2 * SIZE)
    assert across_edges(larger) < 1.5
    assert torch.equal(picture, choose(pattern(17.3, 22.7)))


def checkers(side: int, turned: float) -> Tensor:
    """A checkerboard [3, SIZE, SIZE] of squares of `side` px whose shades differ, turned by an angle in rad."""
    y, x = torch.meshgrid(torch.arange(SIZE), torch.arange(SIZE), indexing="ij")
    rows = ((math.cos(turned) * y - math.sin(turned) * x) / side).floor().long()
    columns = ((math.sin(turned) * y + math.cos(turned) * x) / side).floor().long()
    shades = torch.rand(64, 64, generator=Generator().manual_seed(2))[rows % 64, columns % 64]
    return (0.3 + 0.4 * ((rows + columns) % 2) + 0.3 * (shades - 0.5)).expand(3, -1, -1)


@pytest.mark.parametrize(("side", "turned"), [(29, 0.0), (29, 0.06), (13, 0.1)])
def test_quilts_keep_the_order_of_a_checkerboard(side: int, turned: float) -> None:
    """Its own size and twice that are tested.

    A single quilt of blocks of any phase keeps 0.2 to 0.5 at twice the size.
    """
    exemplar = checkers(side, turned)
    lattice, picture = find_lattice(exemplar), choose(exemplar)
    share, larger = kept_order_share(lattice, picture), resize_tile(picture, picture, (2 * SIZE, 2 * SIZE)).layers
    assert share > 0.58
    assert kept_order_share(lattice, larger) > 0.9 * share


def test_pieces_that_are_to_be_avoided_are_not_shown() -> None:
    noise = torch.rand(3, SIZE, SIZE, generator=Generator().manual_seed(3))
    avoided = torch.zeros(SIZE, SIZE, dtype=torch.bool)
    avoided[40:80, 50:90] = True
    shares = []
    for mask in (None, avoided):
        source = make_piece_source(noise, (SIZE, SIZE), stretches=False, avoided=mask)
        places = quilt_places(source, (SIZE, SIZE), (32, 10), np.random.default_rng(0))
        y, x = (places * SIZE).long()
        shares.append(float(avoided[y, x].float().mean()))
    assert shares[0] > 0.03
    assert shares[1] < 0.02
