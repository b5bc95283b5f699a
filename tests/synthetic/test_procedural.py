"""The procedural materials and the patterns they are made of: ranges, periods, statistics."""

from __future__ import annotations

import math

import numpy as np
import pytest

from data_tools.draws import Field, stream
from data_tools.synthetic.patterns.cells import Lattice, isotropic_cells, worley
from data_tools.synthetic.patterns.fields import band_noise, blur, fbm, ramp, share_below, slopes, step, texel_centres
from data_tools.synthetic.patterns.strokes import strokes
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


def test_a_seed_gives_the_same_maps_and_another_one_others() -> None:
    for name, family in FAMILIES.items():
        first, again, other = (family(stream(1, key), 64) for key in (3, 3, 4))
        for one, two in zip(first, again, strict=True):
            assert np.array_equal(one, two), name
        assert np.abs(first.diffuse - other.diffuse).mean() > 1e-3, name


def test_materials_repeat_without_a_border(draws: list[Maps]) -> None:
    for maps in draws:
        for field in (maps.diffuse, maps.height, maps.roughness):
            for axis in (1, 2):
                assert border_jump(field, axis) < 1.25


def test_the_border_test_sees_a_border() -> None:
    field = fbm(stream(0), SIZE, 4, 2.0)
    assert border_jump(field[None], 1) < 1.25
    assert border_jump((field + texel_centres(SIZE)[1])[None], 1) > 1.25


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


def test_worley_distances_agree_with_all_points_and_cells_close() -> None:
    lattice = Lattice(64, 5, 5)
    found = worley(stream(5), lattice, 0.8)
    assert (found.nearest <= found.second).all()
    assert (found.edge >= 0).all()
    # The points again, from where the nearest one lies as seen from each texel, and then all pairs on the torus.
    x, y = texel_centres(64)
    points = {
        int(cell): (float(x[at] - found.across_x[at] / 5) % 1, float(y[at] - found.across_y[at] / 5) % 1)
        for cell in np.unique(found.cell)
        for at in [tuple(np.argwhere(found.cell == cell)[0])]
    }
    assert len(points) == found.total == 25
    apart = [np.hypot((x - px + 0.5) % 1 - 0.5, (y - py + 0.5) % 1 - 0.5) * 5 for px, py in points.values()]
    nearest, second = np.sort(np.stack(apart), 0)[:2]
    np.testing.assert_allclose(found.nearest, nearest, atol=1e-4)
    assert (np.abs(found.second - second) < 1e-4).mean() > 0.99  # a second point may lie beyond the neighbours
    for member in range(4):
        cells = isotropic_cells(stream(6, member), 96, 8, aspect=1.5)
        assert border_jump(cells.nearest[None], 1) < 1.25
        assert border_jump(cells.edge[None], 2) < 1.25


def test_noise_has_the_statistics_it_promises() -> None:
    for field in (band_noise(stream(0), 128, 12), fbm(stream(1), 128, 6, 2.0, 3.0, 0.7)):
        assert field.dtype == np.float32
        assert abs(float(field.mean())) < 1e-3
        assert float(field.std()) == pytest.approx(1, abs=1e-3)
    power = np.abs(np.fft.rfft2(band_noise(stream(2), 128, 20, 0.3))) ** 2
    radius = np.hypot(*np.meshgrid(np.fft.rfftfreq(128, 1 / 128), np.fft.fftfreq(128, 1 / 128)))
    assert power[(radius > 10) & (radius < 40)].sum() > 0.95 * power.sum()
    along, across = slopes(fbm(stream(3), 128, 6, 3.0, 4.0, 0.0))
    assert across.std() > 2 * along.std()


def test_small_functions() -> None:
    field = band_noise(stream(4), 64, 6)
    shares = np.sort(share_below(field).ravel())
    assert np.abs(shares - np.linspace(0, 1, shares.size)).max() < 0.1
    assert blur(field, 0.1).std() < 0.1
    assert blur(field + 3, 0.1).mean() == pytest.approx(3, abs=1e-4)
    colours = np.array([[0, 0, 1], [1, 0, 0], [1, 1, 0]], np.float32)
    values = np.array([[0.0, 0.25], [0.5, 1.0]], np.float32)
    for at, expected in {(0, 0): colours[0], (0, 1): [0.5, 0, 0.5], (1, 1): colours[2]}.items():
        np.testing.assert_allclose(ramp(values, colours)[:, *at], expected)
    np.testing.assert_allclose(ramp(values, colours[:1])[:, 1, 1], colours[0])
    np.testing.assert_allclose(step(values, 0.0, 0.5), [[0, 0.5], [1, 1]])
    np.testing.assert_allclose(step(values, 0.5, 0.0), [[1, 0.5], [0, 0]])


def test_strokes_lie_where_they_should() -> None:
    seen = strokes(stream(8), 64, 1, (0.5, 0.5), (0.1, 0.1), (0.0, 0.0), pointed=0)
    assert seen.covered.mean() == pytest.approx(0.05, rel=0.25)  # length times width
    assert set(np.unique(seen.stroke)) == {-1, 0}
    columns = np.flatnonzero(seen.covered.any(0))
    assert len(columns) == pytest.approx(32, abs=1)
    many = strokes(stream(9), 64, 400, (0.1, 0.3), (0.02, 0.05), (0.0, math.pi), 1.0)
    assert (np.abs(many.across) <= 1).all()
    assert ((many.along >= 0) & (many.along <= 1)).all()
    there = many.stroke >= 0
    assert (many.of_each(np.arange(many.total, dtype=np.float32))[there] == many.stroke[there]).all()
    assert border_jump(many.covered[None], 1) < 1.25
