"""The cache of directions: what it draws is as dense as it says, and what it learns is where light comes from."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from metapp.rendering.guide_cache import (
    AXES,
    CELLS,
    GRID,
    PLACES,
    SHARE,
    SIDE,
    SLOTS,
    GuideCache,
    moments,
    slots_of,
    words_of,
)
from tests.needs_mitsuba import needs_mitsuba


def weights(places: int) -> torch.Tensor:
    return torch.rand(places, CELLS, generator=torch.Generator().manual_seed(0), dtype=torch.float64) ** 4


LEAST = SLOTS // CELLS // SHARE


def test_every_cell_has_slots_and_the_others_go_by_weight() -> None:
    wanted = weights(5)
    slots = slots_of(wanted)
    assert (slots.sum(1) == SLOTS).all()
    assert int(slots.min()) >= LEAST
    expected = LEAST + wanted / wanted.sum(1, keepdim=True) * (SLOTS - CELLS * LEAST)
    assert float((slots - expected).abs().max()) <= 1


def test_one_bright_cell_gets_all_free_slots() -> None:
    one = torch.zeros(1, CELLS, dtype=torch.float64)
    one[0, 77] = 1e-30
    assert int(slots_of(one)[0, 77]) == SLOTS - (CELLS - 1) * LEAST


def test_words_draw_each_cell_as_often_as_it_has_slots() -> None:
    some = torch.cat([weights(50), torch.ones(1, CELLS), torch.eye(CELLS)[7:8]]).double()
    slots = slots_of(some).numpy()
    words = words_of(slots).astype(np.int64)
    assert np.array_equal(words >> 16, slots)
    own, other = words >> 8 & 0xFF, words & 0xFF
    drawn = own.copy()
    np.add.at(drawn, (np.arange(len(slots))[:, None], other), CELLS - own)
    assert np.array_equal(drawn, slots)


VOXELS = torch.tensor([[x, y, z, axis] for x in (0, 1) for y in (0, 1) for z in (0, 1) for axis in (0, 3)])


def test_the_moment_of_even_light_is_even_however_it_was_sampled() -> None:
    counts = 50 * weights(len(VOXELS)).reshape(-1, SIDE, SIDE)
    found = moments(4.0 * counts, counts, VOXELS)
    assert torch.allclose(found, torch.full_like(found, 4.0))


def test_with_many_paths_the_moments_are_their_means() -> None:
    expected = 1 + weights(len(VOXELS)).reshape(-1, SIDE, SIDE)
    counts = torch.full_like(expected, 1e6)
    assert torch.allclose(moments(expected * counts, counts, VOXELS), expected, rtol=1e-3)


def test_cells_without_paths_lean_on_those_around_them() -> None:
    squares, counts = torch.zeros(2, 1, SIDE, SIDE, dtype=torch.float64)
    counts += 1000
    squares[:, : SIDE // 2, : SIDE // 2] = 1000  # a bright quarter
    for row, column in ((3, 3), (12, 12)):  # one of it and one of the dark ones that nothing is known of
        squares[:, row, column] = counts[:, row, column] = 0
    found = moments(squares, counts, VOXELS[:1])[0]
    assert float(found[3, 3]) == pytest.approx(1, abs=0.1)
    assert float(found[12, 12]) == pytest.approx(0, abs=0.1)
    assert float(found[5, 5]) == pytest.approx(1, abs=0.1)


def test_voxels_without_paths_lean_on_those_about_them_of_their_side() -> None:
    shapes = weights(2).reshape(2, SIDE, SIDE)
    counts = torch.full((len(VOXELS), SIDE, SIDE), 1e5, dtype=torch.float64)
    squares = shapes.repeat(8, 1, 1) * counts  # one shape on each axis
    squares[5] = counts[5] = 0
    assert torch.allclose(moments(squares, counts, VOXELS)[5], shapes[1], rtol=0.05, atol=1e-3)


@pytest.fixture(scope="module")
def mi() -> Any:
    from metapp.rendering.variant import load_mitsuba

    return load_mitsuba()


@pytest.fixture(scope="module")
def cache(mi: Any) -> GuideCache:
    """One that has learned of weights in its first places, of which the last few were hardly met."""
    made = GuideCache(mi, [-1, -1, -1], [1, 1, 1])
    known = torch.zeros(PLACES, CELLS, 2, dtype=torch.float64)
    known[:7, :, 0], known[:7, :, 1] = 1e3 * weights(7), 1e3
    known[5:7] *= 1e-3
    met = torch.arange(PLACES) < 7
    made.sums, made.met = mi.Float64(known.flatten().numpy()), mi.UInt32(met.int().numpy().view(np.uint32))
    assert made.learn() == 6 + 5  # voxels of twice the side, whose axes are six, and places of their own
    return made


@needs_mitsuba
def test_places_that_few_paths_met_share_the_row_of_those_about_them(cache: GuideCache) -> None:
    rows = cache.rows.numpy()
    assert len(set(rows[:5])) == 5
    assert (rows[:5] > 6).all()
    first, beside, above, beyond = rows[:6], rows[AXES:][:6], rows[GRID**2 * AXES :][:6], rows[2 * AXES :][:6]
    assert np.array_equal(beside, above)
    assert sorted(beside) == list(range(1, 7))
    assert first[5] == beside[5]
    assert (beyond == 0).all()


@needs_mitsuba
def test_of_nothing_nothing_is_learned(mi: Any) -> None:
    nothing = GuideCache(mi, [-1, -1, -1], [1, 1, 1])
    assert nothing.learn() == 0
    assert (nothing.rows.numpy() == 0).all()
    assert (nothing.density(mi.UInt32(0), mi.UInt32(5), mi.Bool(True)).numpy() == 1).all()


@needs_mitsuba
@pytest.mark.parametrize("place", [4, 6, 1000])
def test_directions_are_drawn_as_densely_as_it_says(mi: Any, cache: GuideCache, place: int) -> None:
    count = 200_000
    rng = np.random.default_rng(0)
    point = mi.Point2f(*(mi.Float(each) for each in rng.random((2, count), np.float32)))
    row, yes = mi.UInt32(np.full(count, cache.rows.numpy()[place], np.uint32)), mi.Bool(True)
    cell, local = cache.draw(row, point, yes)
    density = cache.density(row, cell, yes)
    assert (cache.cell(local).numpy() == cell.numpy()).mean() > 0.9999  # but on the cells' edges
    cosine = local.numpy()[2]
    assert (cosine >= 0).all()
    every = mi.UInt32(np.arange(CELLS, dtype=np.uint32))
    shares = cache.density(row[0], every, yes).numpy() / CELLS
    assert shares.sum() == pytest.approx(1, abs=1e-6)
    assert shares.min() >= 1 / (SHARE * CELLS) - 1e-9
    found = np.bincount(cell.numpy(), minlength=CELLS)
    chi_square = ((found - count * shares) ** 2 / (count * shares)).sum()
    assert abs(chi_square - (CELLS - 1)) < 5 * np.sqrt(2 * (CELLS - 1))
    # within a cell as the cosine: the mean of 1 / density is the hemisphere
    assert (np.pi / (cosine * density.numpy())).mean() == pytest.approx(2 * np.pi, rel=0.02)
    # evenly within a cell
    square = mi.warp.uniform_disk_to_square_concentric(mi.Point2f(local.x, local.y)).numpy() * SIDE
    for within in square % 1:
        eighths = np.bincount((within * 8).astype(int), minlength=8)[:8]
        assert ((eighths - count / 8) ** 2 / (count / 8)).sum() < 7 + 5 * np.sqrt(14)


@needs_mitsuba
def test_places_are_voxels_and_sides(mi: Any, cache: GuideCache) -> None:
    rng = np.random.default_rng(1)
    points, normals = rng.uniform(-1.2, 1.2, (2, 3, 5000)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=0)
    spot = cache.spot(mi.Point3f(points), mi.Vector3f(normals))
    frame = np.stack([each.numpy() for each in (spot.frame.s, spot.frame.t, spot.frame.n)])
    assert np.allclose(np.einsum("ikn,jkn->ijn", frame, frame), np.eye(3)[..., None], atol=1e-5)
    assert np.allclose(np.linalg.det(frame.transpose(2, 0, 1)), 1, atol=1e-5)
    assert np.allclose(frame[2], normals, atol=1e-6)
    axis = np.abs(normals).argmax(0)
    side = 2 * axis + (np.take_along_axis(normals, axis[None], 0)[0] < 0)
    x, y, z = np.clip(np.floor((points + 1) * GRID / 2).astype(int), 0, GRID - 1)
    place = ((z * GRID + y) * GRID + x) * AXES + side
    assert (spot.place.numpy() == place).mean() > 0.999
    assert np.array_equal(spot.row.numpy(), cache.rows.numpy()[spot.place.numpy()])
