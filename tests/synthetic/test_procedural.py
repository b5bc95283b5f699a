"""The procedural materials and the patterns they are made of: ranges, periods, statistics."""

from __future__ import annotations

import math

import numpy as np
import pytest

from data_tools.draws import stream
from data_tools.synthetic.draws import Field
from data_tools.synthetic.patterns.cells import Lattice
from data_tools.synthetic.patterns.fields import slopes
from data_tools.synthetic.stationary.families import FAMILIES, Maps

SIZE = 128
BOUNDS = {"diffuse": (0.0, 1.0), "specular": (0.02, 0.9), "roughness": (0.05, 1.0)}


@pytest.fixture(scope="module", params=FAMILIES)
def draws(request: pytest.FixtureRequest) -> list[Maps]:
    """Eight draws of a family."""
    return [FAMILIES[request.param](stream(7, member), SIZE) for member in range(8)]


def border_jump(field: Field, axis: int) -> float:
    """The step over the border, from the last row or column to the first, over the largest step inside."""
    steps = np.abs(np.roll(field, -1, axis) - field).mean(tuple({0, 1, 2} - {axis}))
    return float(steps[-1] / max(steps[:-1].max(), 1e-6))


def test_maps_have_their_shapes_and_ranges(draws: list[Maps]) -> None:
    for maps in draws:
        assert [each.shape for each in maps] == [(channels, SIZE, SIZE) for channels in (3, 1, 1, 1)]
        assert all(each.dtype == np.float32 for each in maps)
        assert all(np.isfinite(each).all() for each in maps)
        for name, (low, high) in BOUNDS.items():
            values = getattr(maps, name)
            assert low <= values.min() + 1e-6, name
            assert values.max() <= high + 1e-6, name
        assert maps.diffuse.std() > 1e-3
        assert maps.diffuse.mean() > 0.01
        steepness = np.sqrt(sum(slope**2 for slope in slopes(maps.height[0])).mean())
        assert 1e-3 < steepness < 1.5


def test_materials_repeat_without_a_border(draws: list[Maps]) -> None:
    for maps in draws:
        for field in (maps.diffuse, maps.height, maps.roughness):
            for axis in (1, 2):
                assert border_jump(field, axis) < 1.25


@pytest.mark.parametrize("angle", [0.0, 0.4, math.pi / 4, 2.2])
@pytest.mark.parametrize(("shift", "multiple"), [(0.0, 1), (0.5, 2), (1 / 3, 3)])
def test_lattices_close_over_the_border(angle: float, shift: float, multiple: int) -> None:
    """Wherever a cell goes on over the border it is the same cell: as many pieces of cells as there are cells."""
    lattice = Lattice(96, 6, 9, angle, shift, multiple)
    assert set(np.unique(lattice.cell)) == set(range(lattice.count))
    assert 0.5 < lattice.count / 54 < 2
    assert lattice.width * lattice.height == pytest.approx(1 / lattice.count)
    assert min(lattice.u.min(), lattice.v.min()) >= 0
    assert max(lattice.u.max(), lattice.v.max()) <= 1
    values = stream(3).random(lattice.count, dtype=np.float32)[lattice.cell]
    for axis in (1, 2):
        assert border_jump(values[None], axis) < 1.25
    assert abs(math.remainder(lattice.direction_rad - angle, math.tau)) < 0.25
    areas = np.bincount(lattice.cell.ravel()) / lattice.cell.size * lattice.count
    assert areas.min() > 0.5
    assert areas.max() < 1.5
