"""Fields with a code in every place: what a code reaches, and that a finer grid stands for the same."""

from __future__ import annotations

import pytest
import torch
from torch import Generator, Tensor

from metapp.learning.task import Params
from metapp.networks import field as fields
from metapp.networks.field import LocalField, regridded
from tests.networks.precise import double

FIELD = LocalField(8, 16, rows=4, columns=8, code=3, hidden=8, layers=2)


def blind(rng: Generator, count: int, field: LocalField = FIELD) -> Params:
    """Parameters of networks that see their code alone."""
    theta = field.init(rng, count)
    return {key: torch.zeros_like(value) if key.endswith(".kernel") else value for key, value in theta.items()}


def places(count: int, field: LocalField = FIELD) -> Tensor:
    return torch.rand(count, field.inputs, field.height, field.width, generator=Generator().manual_seed(1))


def test_a_code_without_variation_is_the_same_everywhere(rng: Generator) -> None:
    theta = blind(rng, 2) | {"z": torch.randn(2, 3, 1, 1, generator=rng).expand(-1, -1, 4, 8)}
    made = FIELD(theta, places(2))
    assert made.shape == (2, 3, 8, 16)
    torch.testing.assert_close(made, made[..., :1, :1].expand_as(made))


def test_a_large_field_is_made_by_rows(rng: Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same to rounding, also where the last rows are fewer, and each row where it belongs."""
    field = FIELD._replace(height=21, width=16)
    theta, seen = double(field.init(rng, 2)), places(2, field).double()
    whole = field(theta, seen)
    monkeypatch.setattr(fields, "STRIP_TEXELS", 5 * 16)
    rows = list(fields.field_by_rows(field, theta, seen))
    assert [part.shape[-2] for part in rows] == [5, 5, 5, 5, 1]
    torch.testing.assert_close(torch.cat(rows, -2), whole)


def test_a_code_goes_on_at_the_other_edge_where_it_is_periodic(rng: Generator) -> None:
    for periodic in (True, False):
        field = FIELD._replace(periodic=periodic)
        theta = blind(rng, 1, field)
        turned = field({**theta, "z": theta["z"].roll(3, -1)}, places(1))
        assert torch.allclose(turned, field(theta, places(1)).roll(6, -1), atol=1e-5) == periodic


def test_a_cell_of_the_code_reaches_its_neighbourhood_only(rng: Generator) -> None:
    theta = FIELD.init(rng, 1)
    moved = {**theta, "z": theta["z"].clone()}
    moved["z"][0, :, 2, 5] += 1
    rows, columns = (FIELD(moved, places(1)) - FIELD(theta, places(1))).abs().sum((0, 1)).nonzero().T
    assert set(rows.tolist()) == {3, 4, 5, 6}
    assert set(columns.tolist()) == {9, 10, 11, 12}


# A code on a finer grid


def test_values_on_a_finer_grid(rng: Generator) -> None:
    """Linear between centres, also across the edges of a periodic grid; the same grid is left alone."""
    values = torch.randn(1, 2, 4, 8, generator=rng)
    assert regridded(values, 4, 8, periodic=True) is values
    fine, turned = (regridded(each, 8, 16, periodic=True) for each in (values, values.roll(3, -1)))
    torch.testing.assert_close(fine.roll(6, -1), turned)
    for periodic in (True, False):
        constant = regridded(torch.full((1, 2, 3, 5), 0.7), 12, 20, periodic=periodic)
        torch.testing.assert_close(constant, torch.full((1, 2, 12, 20), 0.7))
    fine = regridded(torch.arange(4.0).expand(1, 1, 3, 4), 3, 8, periodic=False)
    torch.testing.assert_close(fine[0, 0, 1], torch.tensor([0, 0.25, 0.75, 1.25, 1.75, 2.25, 2.75, 3]))


def test_a_code_for_each_texel_needs_no_interpolation(rng: Generator) -> None:
    field = FIELD._replace(rows=8, columns=16, periodic=True)
    theta = field.init(rng, 2)
    down, across = fields._interpolation(field, theta["z"].device)
    whole = down @ (field.gain * theta["z"]) @ across
    assert torch.equal(field.code_at(theta, 0, 8), whole)
    assert torch.equal(field.code_at(theta, 3, 5), whole[:, :, 3:5])
