"""A code on a finer grid: what it stands for stays."""

from __future__ import annotations

import pytest
import torch
from torch import Generator

from metapp.appearance.latlong import directions
from metapp.networks.layers import LocalField, regridded


def test_the_same_grid_is_left_alone(rng: Generator) -> None:
    values = torch.randn(2, 3, 4, 8, generator=rng)
    assert regridded(values, 4, 8, periodic=True) is values


@pytest.mark.parametrize("periodic", [True, False])
def test_a_constant_stays_a_constant(*, periodic: bool) -> None:
    torch.testing.assert_close(
        regridded(torch.full((1, 2, 3, 5), 0.7), 12, 20, periodic=periodic), torch.full((1, 2, 12, 20), 0.7)
    )


def test_between_centres_it_is_linear() -> None:
    ramp = torch.arange(4.0).expand(1, 1, 3, 4)
    fine = regridded(ramp, 3, 8, periodic=False)
    torch.testing.assert_close(fine[0, 0, 1], torch.tensor([0, 0.25, 0.75, 1.25, 1.75, 2.25, 2.75, 3]))


def test_columns_may_go_on_at_the_other_edge(rng: Generator) -> None:
    values = torch.randn(1, 2, 4, 8, generator=rng)
    fine, turned = (regridded(each, 8, 16, periodic=True) for each in (values, values.roll(3, -1)))
    torch.testing.assert_close(fine.roll(6, -1), turned)


def test_a_field_makes_nearly_the_same_picture_of_it(rng: Generator) -> None:
    """To within a tenth of how far it varies, of a code that is smooth."""
    coarse = LocalField(32, 64, rows=8, columns=16)
    theta = coarse.init(rng, 1)
    theta["z"] = regridded(torch.randn(1, 8, 4, 8, generator=rng) / 30, 8, 16, periodic=True)
    finer = theta | {"z": regridded(theta["z"], 16, 32, periodic=True)}
    places = directions(32, 64)[None]
    one, other = coarse(theta, places), coarse._replace(rows=16, columns=32)(finer, places)
    assert float((one - other).abs().mean()) < 0.1 * float(one.std())
