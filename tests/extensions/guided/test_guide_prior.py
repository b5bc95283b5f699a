"""The cache and the prior of path guiding: sampling follows the stated density, and light is learned."""

from typing import Any

import numpy as np
import pytest
import torch
from torch import Generator

from metapp.extensions.guided.histogram import (
    CACHE_ENTRIES,
    GRID_SIDE_VOXELS,
    HISTOGRAM_BINS,
    HISTOGRAM_SIDE_BINS,
    NORMAL_AXES,
    UNIFORM_DENSITY_DIVISOR,
    second_moments,
    shrink_moments,
)
from metapp.extensions.guided.prior import (
    SURVEY_CHANNELS,
    FirstHits,
    LearnedPrior,
    read_prior,
)
from metapp.rendering.scenes.loading import load_scene
from metapp.rendering.variant import load_mitsuba
from tests.needs_mitsuba import needs_mitsuba, skip_without_mitsuba

HALF = GRID_SIDE_VOXELS // 2
VOXELS = torch.tensor([[x, y, z, axis] for x in (0, 1) for y in (0, 1) for z in (0, 1) for axis in (0, 3)])


def weights(rows: int) -> torch.Tensor:
    return torch.rand(rows, HISTOGRAM_BINS, generator=torch.Generator().manual_seed(0), dtype=torch.float64) ** 4


def test_with_many_paths_moments_are_means_however_they_were_sampled() -> None:
    counts = 50 * weights(len(VOXELS)).reshape(-1, HISTOGRAM_SIDE_BINS, HISTOGRAM_SIDE_BINS)
    even = second_moments(4.0 * counts, counts, VOXELS)
    assert torch.allclose(even, torch.full_like(even, 4.0))
    expected = 1 + weights(len(VOXELS)).reshape(-1, HISTOGRAM_SIDE_BINS, HISTOGRAM_SIDE_BINS)
    counts = torch.full_like(expected, 1e6)
    assert torch.allclose(second_moments(expected * counts, counts, VOXELS), expected, rtol=1e-3)
    nothing = torch.zeros_like(expected)  # and without paths the expected ones
    torch.testing.assert_close(shrink_moments(nothing, nothing, expected), expected)


def test_voxels_without_paths_get_the_moments_of_those_around_them_of_their_axis() -> None:
    shapes = weights(2).reshape(2, HISTOGRAM_SIDE_BINS, HISTOGRAM_SIDE_BINS)
    counts = torch.full((len(VOXELS), HISTOGRAM_SIDE_BINS, HISTOGRAM_SIDE_BINS), 1e5, dtype=torch.float64)
    squares = shapes.repeat(8, 1, 1) * counts  # one shape on each axis
    squares[5] = counts[5] = 0
    assert torch.allclose(second_moments(squares, counts, VOXELS)[5], shapes[1], rtol=0.05, atol=1e-3)


def empty(low: tuple[float, ...] = (-1, -1, -1), high: tuple[float, ...] = (1, 1, 1)) -> Any:
    from metapp.extensions.guided.guide_cache import GuideCache

    return GuideCache(list(low), list(high), np.zeros((3, 0)))


@pytest.fixture(scope="module")
def cache() -> Any:
    """One that has learned of weights in its first entries, of which the last few were hardly visited."""
    skip_without_mitsuba()
    mi, result = load_mitsuba(), empty()
    sums = torch.zeros(CACHE_ENTRIES, HISTOGRAM_BINS, 2, dtype=torch.float64)
    sums[:7, :, 0], sums[:7, :, 1] = 1e3 * weights(7), 1e3
    sums[5:7] *= 1e-3
    bounces = torch.zeros(CACHE_ENTRIES, 3, dtype=torch.float64)
    bounces[:7, 2] = 10
    result.sums, result.bounces = (mi.Float64(statistic.flatten().numpy()) for statistic in (sums, bounces))
    assert result.update_histograms() == 6 + 5  # voxels of twice the side, whose axes are six, and entries of their own
    return result


def test_entries_of_few_paths_share_the_row_of_those_around_them(cache: Any) -> None:
    rows = cache.rows.numpy()
    assert len(set(rows[:5])) == 5
    assert (rows[:5] > 6).all()
    first, beside, above, beyond = (
        rows[:6],
        rows[NORMAL_AXES:][:6],
        rows[GRID_SIDE_VOXELS**2 * NORMAL_AXES :][:6],
        rows[2 * NORMAL_AXES :][:6],
    )
    assert np.array_equal(beside, above)
    assert sorted(beside) == list(range(1, 7))
    assert first[5] == beside[5]
    assert (beyond == 0).all()


def test_guide_without_records_stays_uniform(mi: Any) -> None:
    nothing = empty()
    assert nothing.update_histograms() == 0
    assert (nothing.rows.numpy() == 0).all()
    assert (nothing.density(mi.UInt32(0), mi.UInt32(5), mi.Bool(True)).numpy() == 1).all()


@pytest.mark.parametrize("entry", [4, 6, 1000])
def test_sampled_directions_follow_the_stated_density(mi: Any, cache: Any, entry: int) -> None:
    count = 200_000
    rng = np.random.default_rng(0)
    point = mi.Point2f(rng.random((2, count), np.float32))
    row, yes = mi.UInt32(np.full(count, cache.rows.numpy()[entry], np.uint32)), mi.Bool(True)
    index, local = cache.sample(row, point, yes)
    density = cache.density(row, index, yes)
    assert (cache.bin_of_direction(local).numpy() == index.numpy()).mean() > 0.9999  # but on the bins' edges
    cosine = local.numpy()[2]
    assert (cosine >= 0).all()
    every = mi.UInt32(np.arange(HISTOGRAM_BINS, dtype=np.uint32))
    shares = cache.density(row[0], every, yes).numpy() / HISTOGRAM_BINS
    assert shares.sum() == pytest.approx(1, abs=1e-6)
    assert shares.min() >= 1 / (UNIFORM_DENSITY_DIVISOR * HISTOGRAM_BINS) - 1e-9
    found = np.bincount(index.numpy(), minlength=HISTOGRAM_BINS)
    chi_square = ((found - count * shares) ** 2 / (count * shares)).sum()
    assert abs(chi_square - (HISTOGRAM_BINS - 1)) < 5 * np.sqrt(2 * (HISTOGRAM_BINS - 1))
    # within a bin as the cosine: the mean of 1 / density is the hemisphere
    assert (np.pi / (cosine * density.numpy())).mean() == pytest.approx(2 * np.pi, rel=0.02)
    # evenly within a bin
    square = mi.warp.uniform_disk_to_square_concentric(mi.Point2f(local.x, local.y)).numpy() * HISTOGRAM_SIDE_BINS
    for within in square % 1:
        eighths = np.bincount((within * 8).astype(int), minlength=8)[:8]
        assert ((eighths - count / 8) ** 2 / (count / 8)).sum() < 7 + 5 * np.sqrt(14)


def test_entries_are_voxels_and_sides(mi: Any, cache: Any) -> None:
    rng = np.random.default_rng(1)
    points, normals = rng.uniform(-1.2, 1.2, (2, 3, 5000)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=0)
    location = cache.locate(mi.Point3f(points), mi.Vector3f(normals))
    frame = np.stack([axis.numpy() for axis in (location.frame.s, location.frame.t, location.frame.n)])
    assert np.allclose(np.einsum("ikn,jkn->ijn", frame, frame), np.eye(3)[..., None], atol=1e-5)
    assert np.allclose(np.linalg.det(frame.transpose(2, 0, 1)), 1, atol=1e-5)
    assert np.allclose(frame[2], normals, atol=1e-6)
    axis = np.abs(normals).argmax(0)
    side = 2 * axis + (np.take_along_axis(normals, axis[None], 0)[0] < 0)
    x, y, z = np.clip(np.floor((points + 1) * GRID_SIDE_VOXELS / 2).astype(int), 0, GRID_SIDE_VOXELS - 1)
    entry = ((z * GRID_SIDE_VOXELS + y) * GRID_SIDE_VOXELS + x) * NORMAL_AXES + side
    assert (location.entry.numpy() == entry).mean() > 0.999
    assert np.array_equal(location.row.numpy(), cache.rows.numpy()[location.entry.numpy()])


# The prior


def drawn(*shape: int) -> torch.Tensor:
    return torch.rand(*shape, generator=Generator().manual_seed(1), dtype=torch.float64) + 0.1


def test_entries_without_features_are_as_without_a_prior() -> None:
    nothing = (
        torch.zeros(0, 4, dtype=torch.long),
        torch.zeros(0, len(SURVEY_CHANNELS), HISTOGRAM_SIDE_BINS, HISTOGRAM_SIDE_BINS),
    )
    squares, counts = (
        drawn(2, HISTOGRAM_SIDE_BINS, HISTOGRAM_SIDE_BINS),
        drawn(2, HISTOGRAM_SIDE_BINS, HISTOGRAM_SIDE_BINS),
    )
    voxels = torch.tensor([[0, 0, 0, 1], [3, 2, 1, 0]])
    found = LearnedPrior(read_prior(), *nothing)(squares, counts, voxels)
    torch.testing.assert_close(found, second_moments(squares, counts, voxels))


# In Mitsuba


def tracer() -> Any:
    from metapp.extensions.guided.path_tracer import PathTracer

    return PathTracer(6, 5)


@needs_mitsuba
def test_a_survey_weighs_emitters_and_turns_normals_to_the_ray(monkeypatch: pytest.MonkeyPatch) -> None:
    """Over a floor, half of it under a board that faces up, below a sky of radiance 2, straight up."""
    grey = {"type": "twosided", "inside": {"type": "diffuse"}}
    look = [[0, 0, -1, 6], [1, 0, 0, 0], [0, 1, 0, 0.5], [0, 0, 0, 1.0]]
    board = [[4, 0, 0, 4], [0, 4, 0, 0], [0, 0, 1, 1], [0, 0, 0, 1.0]]
    scene = load_scene({
        "type": "scene",
        "sensor": {"type": "perspective", "fov": 30, "to_world": look,
                   "film": {"type": "hdrfilm", "width": 8, "height": 8}},
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": [2.0, 2.0, 2.0]}},
        "floor": {"type": "rectangle", "bsdf": grey},
        "board": {"type": "rectangle", "to_world": board, "bsdf": grey},
    })[1]  # fmt: skip
    from metapp.extensions.guided import survey

    traced: list[FirstHits] = []
    monkeypatch.setattr(survey, "entry_features", lambda hits, *_: traced.append(hits))
    cache = empty((-1, -1, -0.1), (1, 1, 1.1))
    voxels, _ = survey.survey(tracer(), scene, scene.sensors()[0], cache, 3)
    entry, emitted = (
        values[:, :, (HISTOGRAM_SIDE_BINS // 2) * HISTOGRAM_SIDE_BINS + HISTOGRAM_SIDE_BINS // 2]
        for values in (traced[0].entry, traced[0].emitted)
    )
    floor = (voxels[:, 3] == 4) & (voxels[:, 0] == 0)
    below, open_floor = floor & (voxels[:, 2] > HALF // 2), floor & (voxels[:, 2] < HALF // 2 - 1)
    assert min(int(below.sum()), int(open_floor.sum())) > HALF
    assert (entry[below] % NORMAL_AXES == 5).all()  # the board's lower side
    assert not emitted[below].any()
    assert (entry[open_floor] == CACHE_ENTRIES).all()
    # the power heuristic of a density of nearly 1 / pi and that of the sky, 1 / (4 pi)
    sky = emitted[open_floor]
    torch.testing.assert_close(sky, torch.full_like(sky, 2 * 16 / 17), rtol=5e-3, atol=0)


# The cache


def test_voxels_are_narrower_where_there_are_many_points(mi: Any) -> None:
    from metapp.extensions.guided.guide_cache import POINT_DENSITY_SHARE, GuideCache

    rng = np.random.default_rng(0)
    points = np.stack([rng.uniform(0, 0.1, 20_000), *rng.uniform(0, 1, (2, 20_000))])
    x = np.float32(np.linspace(-0.5, 1.5, 4001))
    cache = GuideCache([0] * 3, [1] * 3, points)
    entry = cache.locate(mi.Point3f(mi.Float(x), 0.5, 0.5), mi.Vector3f(1, 0, 0)).entry.numpy()
    voxel = entry // NORMAL_AXES % GRID_SIDE_VOXELS
    assert (np.diff(voxel.astype(int)) >= 0).all()
    assert set(voxel) == set(range(GRID_SIDE_VOXELS))
    within = len(set(voxel[(x > 0) & (x < 0.1)]))
    assert within == pytest.approx(GRID_SIDE_VOXELS * (POINT_DENSITY_SHARE + (1 - POINT_DENSITY_SHARE) * 0.1), abs=1)


def test_flat_scenes_have_voxels_too(mi: Any) -> None:
    cache = empty((0, 0, 5), (1, 1, 5))
    x = np.float32((np.arange(GRID_SIDE_VOXELS) + 0.5) / GRID_SIDE_VOXELS)
    location = cache.locate(mi.Point3f(mi.Float(x), 0.5, 5.0), mi.Vector3f(0, 0, 1))
    entry = location.entry.numpy()
    assert len(set(entry)) == GRID_SIDE_VOXELS
    assert entry.max() < CACHE_ENTRIES
    assert np.array_equal(np.diff(entry.astype(int)), np.full(GRID_SIDE_VOXELS - 1, NORMAL_AXES))


def bounce(mi: Any, **more: Any) -> tuple[Any, ...]:
    usual = {"index": mi.UInt32(1), "density": 1.0, "throughput": 1.0, "radiance": 0.0, "unlit": 0.0}
    return *(mi.Float(value) if isinstance(value, float | list) else value for value in (usual | more).values()), *6 * (
        0,
    )


def learned_entries(cache: Any) -> dict[int, tuple[float, float]]:
    """Squares and counts of the bins that have any, by entry * BINS + bin."""
    visited, squares, counts = cache.visited_sums()
    cells = [(int(entry) * HISTOGRAM_BINS + b, float(squares.flatten(1)[i, b]), float(counts.flatten(1)[i, b]))
             for i, entry in enumerate(visited) for b in counts.flatten(1)[i].nonzero()[:, 0].tolist()]  # fmt: skip
    return {cell: (square, count) for cell, square, count in cells}


def test_a_bounce_carries_what_its_path_gains_after_it(mi: Any) -> None:
    """Radiance in the end less that before, over the throughput; of it the square, times the density, is added."""
    from metapp.extensions.guided.guide_cache import BounceRecords

    records, cache = BounceRecords(3), empty()
    cells = [0, 7 * HISTOGRAM_BINS + 3, 4]  # the first bin of the first entry among them
    index = mi.UInt32(np.array(cells, np.uint32) + 1)
    records.record_bounce(mi.UInt32(0), bounce(mi, index=index, density=[2.0, 4.0, 1.0], throughput=[0.5, 1.0, 1.0],
                                     radiance=[1.0, 0.25, 5.0]), mi.Bool(True))  # fmt: skip
    records.add_to_cache(cache, mi.Color3f(mi.Float([3.0, 1.25, 2.0])))
    found = learned_entries(cache)
    assert sorted(found) == sorted(cells)
    for cell, (square, count) in {0: (4.0**2 * 2, 1 / 2), cells[1]: (1.0**2 * 4, 1 / 4), 4: (0.0, 1.0)}.items():
        assert found[cell] == pytest.approx((square, count))  # of rounding that makes it darker, 0


def test_bounces_are_recorded_by_depth_as_far_as_there_is_room(mi: Any) -> None:
    from metapp.extensions.guided.guide_cache import MAX_RECORDED_BOUNCES, BounceRecords

    records, cache = BounceRecords(2), empty()
    for depth in range(MAX_RECORDED_BOUNCES + 2):
        index = mi.UInt32(np.array([1 + depth, 1 + 100 + depth], np.uint32))
        records.record_bounce(mi.UInt32(depth), bounce(mi, index=index), mi.Bool([True, depth % 2 == 0]))
    records.add_to_cache(cache, mi.Color3f(1.0, 1.0, 1.0))
    assert sorted(learned_entries(cache)) == [*range(MAX_RECORDED_BOUNCES), *range(100, 100 + MAX_RECORDED_BOUNCES, 2)]


def test_records_without_finite_weight_are_left_out(mi: Any) -> None:
    """No bounce, a density of 0, radiance that is not finite."""
    from metapp.extensions.guided.guide_cache import BounceRecords

    records, cache = BounceRecords(4), empty()
    records.record_bounce(
        mi.UInt32(0), bounce(mi, index=mi.UInt32([0, 6, 7, 8]), density=[1.0, 0.0, 1.0, 1.0]), mi.Bool(True)
    )
    records.add_to_cache(cache, mi.Color3f(mi.Float([1.0, 1.0, float("inf"), 1.0])))
    assert sorted(learned_entries(cache)) == [7]


def test_expected_contribution_is_the_mean_of_earlier_paths(mi: Any) -> None:
    """It is the mean outgoing luminance with the sampled emitter, and the root mean square of continuations without."""
    import drjit as dr

    from metapp.extensions.guided.guide_cache import MIN_ROW_BOUNCES, BounceRecords

    rng, cache = np.random.default_rng(0), empty()
    cells = np.array(
        [3] * 40 + [7 * HISTOGRAM_BINS] * (MIN_ROW_BOUNCES - 1), np.uint32
    )  # entries 0, which is known, and 7
    throughput, unlit, lit, after = rng.uniform(0.1, 1, (4, len(cells))).astype(np.float32)
    records = BounceRecords(len(cells))
    records.record_bounce(
        mi.UInt32(0),
        bounce(mi, index=mi.UInt32(cells + 1), throughput=mi.Float(throughput), unlit=mi.Float(unlit),
               radiance=mi.Float(unlit + lit)),
        mi.Bool(True),
    )  # fmt: skip
    records.add_to_cache(cache, mi.Color3f(mi.Float(unlit + lit + after)))
    cache.update_histograms()
    rows = dr.gather(mi.UInt32, cache.rows, mi.UInt32([0, 7, 11]))
    found = cache.row_expectations(rows, mi.Bool(True)).numpy()
    outgoing, continuation = ((lit + after) / throughput)[:40], (after / throughput)[:40]
    assert found[:, 0] == pytest.approx([outgoing.mean(), np.sqrt((continuation**2).mean())], rel=1e-4)
    assert (found[:, 1:] == 0).all()
