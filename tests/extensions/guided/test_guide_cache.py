"""What the cache of path guiding makes of recorded bounces, and how it turns directions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from metapp.extensions.guided.histogram import AXES, BINS, ENTRIES, GRID
from tests.extensions.guided.test_guide_prior import empty


def test_frames_of_an_entry_are_turned_alike(mi: Any) -> None:
    """Normals that differ by little have tangents that differ by little, also near the axes."""
    rng = np.random.default_rng(0)
    normals = rng.standard_normal((3, 2000)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=0)
    near = normals + 1e-3 * rng.standard_normal((3, 2000)).astype(np.float32)
    near /= np.linalg.norm(near, axis=0)
    cache = empty()
    found, beside = (cache.locate(mi.Point3f(0, 0, 0), mi.Vector3f(each)) for each in (normals, near))
    same = found.entry.numpy() == beside.entry.numpy()
    assert same.mean() > 0.99
    assert np.linalg.norm(found.frame.s.numpy() - beside.frame.s.numpy(), axis=0)[same].max() < 0.05


@pytest.mark.parametrize("points", [np.zeros((3, 0)), np.random.default_rng(0).uniform(-1, 1, (3, 100_000))])
def test_voxels_are_alike_where_points_are(mi: Any, points: Any) -> None:
    from metapp.extensions.guided.cache import GuideCache

    place = np.random.default_rng(1).uniform(-1, 1, (3, 1000)).astype(np.float32)
    place = place[:, (np.abs((place + 1) * GRID / 2 % 1 - 0.5) < 0.4).all(0)]  # not at a boundary
    found = GuideCache([-1] * 3, [1] * 3, points).locate(mi.Point3f(place), mi.Vector3f(1, 0, 0)).entry.numpy()
    x, y, z = ((place + 1) * GRID / 2).astype(int)
    assert (found == ((z * GRID + y) * GRID + x) * AXES).all()


def test_voxels_are_narrower_where_there_are_many_points(mi: Any) -> None:
    from metapp.extensions.guided.cache import CROWDED, GuideCache

    rng = np.random.default_rng(0)
    points = np.stack([rng.uniform(0, 0.1, 20_000), *rng.uniform(0, 1, (2, 20_000))])
    x = np.float32(np.linspace(-0.5, 1.5, 4001))
    cache = GuideCache([0] * 3, [1] * 3, points)
    entry = cache.locate(mi.Point3f(mi.Float(x), 0.5, 0.5), mi.Vector3f(1, 0, 0)).entry.numpy()
    voxel = entry // AXES % GRID
    assert (np.diff(voxel.astype(int)) >= 0).all()
    assert set(voxel) == set(range(GRID))
    within = len(set(voxel[(x > 0) & (x < 0.1)]))
    assert within == pytest.approx(GRID * (CROWDED + (1 - CROWDED) * 0.1), abs=1)


def test_flat_scenes_have_voxels_too(mi: Any) -> None:
    cache = empty((0, 0, 5), (1, 1, 5))
    x = np.float32((np.arange(GRID) + 0.5) / GRID)
    location = cache.locate(mi.Point3f(mi.Float(x), 0.5, 5.0), mi.Vector3f(0, 0, 1))
    entry = location.entry.numpy()
    assert len(set(entry)) == GRID
    assert entry.max() < ENTRIES
    assert np.array_equal(np.diff(entry.astype(int)), np.full(GRID - 1, AXES))


def bounce(mi: Any, **more: Any) -> tuple[Any, ...]:
    usual = {"index": mi.UInt32(1), "density": 1.0, "throughput": 1.0, "radiance": 0.0, "unlit": 0.0}
    return *(mi.Float(each) if isinstance(each, float | list) else each for each in (usual | more).values()), *6 * (0,)


def learned(cache: Any) -> dict[int, tuple[float, float]]:
    """Squares and counts of the bins that have any, by entry * BINS + bin."""
    visited, squares, counts = cache.statistics()
    cells = [(int(entry) * BINS + b, float(squares.flatten(1)[i, b]), float(counts.flatten(1)[i, b]))
             for i, entry in enumerate(visited) for b in counts.flatten(1)[i].nonzero()[:, 0].tolist()]  # fmt: skip
    return {cell: (square, count) for cell, square, count in cells}


def test_a_bounce_carries_what_its_path_gains_after_it(mi: Any) -> None:
    """Radiance in the end less that before, over the throughput; of it the square, times the density, is added."""
    from metapp.extensions.guided.cache import Records

    records, cache = Records(3), empty()
    cells = [0, 7 * BINS + 3, 4]  # the first bin of the first entry among them
    index = mi.UInt32(np.array(cells, np.uint32) + 1)
    records.add(mi.UInt32(0), bounce(mi, index=index, density=[2.0, 4.0, 1.0], throughput=[0.5, 1.0, 1.0],
                                     radiance=[1.0, 0.25, 5.0]), mi.Bool(True))  # fmt: skip
    records.train(cache, mi.Color3f(mi.Float([3.0, 1.25, 2.0])))
    found = learned(cache)
    assert sorted(found) == sorted(cells)
    for cell, (square, count) in {0: (4.0**2 * 2, 1 / 2), cells[1]: (1.0**2 * 4, 1 / 4), 4: (0.0, 1.0)}.items():
        assert found[cell] == pytest.approx((square, count))  # of rounding that makes it darker, 0


def test_bounces_are_recorded_by_depth_as_far_as_there_is_room(mi: Any) -> None:
    from metapp.extensions.guided.cache import RECORDED, Records

    records, cache = Records(2), empty()
    for depth in range(RECORDED + 2):
        index = mi.UInt32(np.array([1 + depth, 1 + 100 + depth], np.uint32))
        records.add(mi.UInt32(depth), bounce(mi, index=index), mi.Bool([True, depth % 2 == 0]))
    records.train(cache, mi.Color3f(1.0, 1.0, 1.0))
    assert sorted(learned(cache)) == [*range(RECORDED), *range(100, 100 + RECORDED, 2)]


def test_what_cannot_be_weighed_is_left_out(mi: Any) -> None:
    """No bounce, a density of 0, radiance that is not finite."""
    from metapp.extensions.guided.cache import Records

    records, cache = Records(4), empty()
    records.add(mi.UInt32(0), bounce(mi, index=mi.UInt32([0, 6, 7, 8]), density=[1.0, 0.0, 1.0, 1.0]), mi.Bool(True))
    records.train(cache, mi.Color3f(mi.Float([1.0, 1.0, float("inf"), 1.0])))
    assert sorted(learned(cache)) == [7]


def test_what_paths_are_expected_to_bring_is_the_mean_of_those_before(mi: Any) -> None:
    """Of outgoing radiance with next-event estimation, the mean; of what is carried, the root mean square."""
    import drjit as dr

    from metapp.extensions.guided.cache import KNOWN, Records

    rng, cache = np.random.default_rng(0), empty()
    cells = np.array([3] * 40 + [7 * BINS] * (KNOWN - 1), np.uint32)  # entries 0, which is known, and 7
    throughput, unlit, lit, after = rng.uniform(0.1, 1, (4, len(cells))).astype(np.float32)
    records = Records(len(cells))
    records.add(
        mi.UInt32(0),
        bounce(mi, index=mi.UInt32(cells + 1), throughput=mi.Float(throughput), unlit=mi.Float(unlit),
               radiance=mi.Float(unlit + lit)),
        mi.Bool(True),
    )  # fmt: skip
    records.train(cache, mi.Color3f(mi.Float(unlit + lit + after)))
    cache.learn()
    rows = dr.gather(mi.UInt32, cache.rows, mi.UInt32([0, 7, 11]))
    found = cache.expect(rows, mi.Bool(True)).numpy()
    outgoing, carried = ((lit + after) / throughput)[:40], (after / throughput)[:40]
    assert found[:, 0] == pytest.approx([outgoing.mean(), np.sqrt((carried**2).mean())], rel=1e-4)
    assert (found[:, 1:] == 0).all()
