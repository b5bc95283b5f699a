"""The procedural materials and the patterns they are made of: ranges, periods, statistics."""

from __future__ import annotations

import numpy as np
import pytest

from data_tools.draws import stream
from data_tools.synthetic.draws import Field
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
