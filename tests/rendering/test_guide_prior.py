"""The prior of guide caches: the untrained network, the survey that it reads, and that the one that ships helps."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Generator

from data_tools.synthetic.rooms import random_room
from metapp.learning.learn import MetaParameters
from metapp.rendering.guide_histogram import AXES, BINS, DEFENSIVE, ENTRIES, GRID, POWER, SIDE, second_moments
from metapp.rendering.guide_prior import (
    CHANNELS,
    ENTRY_PRIOR_PATHS,
    FEATURES,
    FirstHits,
    LearnedPrior,
    SurveyFeatures,
    densities,
    features_of,
    histogram_features,
    init,
    read_prior,
    shipped,
)
from metapp.rendering.scene_loading import load_scene
from metapp.storage.records import save_checkpoint
from tests.needs_mitsuba import needs_mitsuba

HALF = GRID // 2
HITS = (1, 4, BINS)


def drawn(*shape: int) -> torch.Tensor:
    return torch.rand(*shape, generator=Generator().manual_seed(1), dtype=torch.float64) + 0.1


def test_untrained_it_returns_what_paths_have_found() -> None:
    squares, counts = drawn(3, SIDE, SIDE), drawn(3, SIDE, SIDE)
    surveyed = torch.randn(3, len(CHANNELS), SIDE, SIDE)
    features = torch.cat([surveyed, histogram_features(squares, counts, squares)], 1)
    share = squares.flatten(1) ** POWER
    expected = 1 / DEFENSIVE / BINS + (1 - 1 / DEFENSIVE) * share / share.sum(1, keepdim=True)
    torch.testing.assert_close(densities(init(Generator()), features).double(), expected, rtol=1e-4, atol=0)


def test_densities_have_a_floor_and_sum_to_one() -> None:
    theta = {key: torch.randn(value.shape) for key, value in init(Generator()).items()}
    found = densities(theta, torch.randn(5, FEATURES, SIDE, SIDE))
    torch.testing.assert_close(found.sum(1), torch.ones(5))
    assert found.min() >= 1 / DEFENSIVE / BINS * (1 - 1e-5)


def test_entries_without_features_are_as_without_a_prior() -> None:
    nothing = SurveyFeatures.of(torch.zeros(0, 4, dtype=torch.long), torch.zeros(0, len(CHANNELS), SIDE, SIDE))
    squares, counts = drawn(2, SIDE, SIDE), drawn(2, SIDE, SIDE)
    voxels = torch.tensor([[0, 0, 0, 1], [3, 2, 1, 0]])
    found = LearnedPrior(init(Generator()), nothing)(squares, counts, voxels)
    torch.testing.assert_close(found, second_moments(squares, counts, voxels))


def arriving(entry: torch.Tensor, sums: dict[int, float], counts: dict[int, float], *more: float) -> torch.Tensor:
    """Features [channels, SIDE, SIDE] where rays meet such entries, of which so much is known, at `more` alike."""
    totals = torch.zeros(2, ENTRIES, dtype=torch.float64)
    for total, values in zip(totals, (sums, counts), strict=True):
        for index, value in values.items():
            total[index] = value
    hits = FirstHits(entry, *(torch.full(HITS, float(value)) for value in more))
    return features_of(hits, *totals)[0]


def test_what_arrives_is_what_is_sent_there() -> None:
    entry = torch.zeros(HITS, dtype=torch.long)
    entry[..., BINS // 2 :] = 7  # another entry is met in half of the bins
    many = {0: 1e8, 7: 1e8}  # so many that there is no shrinkage
    features = arriving(entry, {0: 1e8, 7: 3e8}, many, 0, 1, 0.5)
    assert features.shape == (len(CHANNELS), SIDE, SIDE)
    ratio = features[0].flatten()[-1] - features[0].flatten()[0]
    assert float(ratio) == pytest.approx(math.log(9), abs=1e-4)
    assert not features[1].any()
    assert float(features[2, 0, 0]) == pytest.approx(math.log(2))
    assert (features[3] == 0.5).all()


def test_entries_of_few_paths_send_what_those_around_them_do() -> None:
    entry = torch.zeros(HITS, dtype=torch.long)
    entry[..., 0] = AXES  # the next voxel, in the same one of twice the side
    entry[..., 1] = 2 * AXES * 2  # in another, of which nothing is known: the mean of all
    # as many dark paths as those around count for
    for paths, ratio in (({}, 1.0), ({AXES: ENTRY_PRIOR_PATHS}, 0.5)):
        found = arriving(entry, {0: 5e8}, {0: 1e8, **paths}, 0, 0, 0)[0].flatten()
        assert float(found[0] - found[2]) == pytest.approx(2 * math.log(ratio), abs=1e-3 if paths else 1e-4)
        assert paths or float(found[1] - found[2]) == pytest.approx(0, abs=1e-4)


def test_a_file_of_something_else_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"no.safetensors: no such checkpoint"):
        read_prior(tmp_path / "no.safetensors")
    other = tmp_path / "other.safetensors"
    save_checkpoint(other, MetaParameters(encoder={"first.kernel": torch.zeros(2)}), {"app": "brdf"})
    with pytest.raises(ValueError, match=r"another network, expected one of guide priors"):
        read_prior(other)


# In Mitsuba


def tracer() -> Any:
    from metapp.rendering.guided_path import PathTracer

    return PathTracer(6, 5)


def picture_of(mi: Any, scene: Any, prior: Any, seed: int, spp: int = 16) -> np.ndarray[Any, Any]:
    from metapp.rendering.guided_plugin import GuidedPicture

    sensor, path = scene.sensors()[0], mi.load_dict({"type": "path", "max_depth": 6})
    made = GuidedPicture(path, tracer(), scene, sensor, seed, prior)
    made.render(spp)
    return np.array(sensor.film().develop(), np.float64)[..., :3]


@needs_mitsuba
def test_the_prior_that_ships_lowers_the_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("metapp.rendering.guided_plugin.PAYS", math.inf)
    mi, scene, _ = load_scene(random_room("board", 5000))  # of no training
    noise = []
    for prior in (read_prior(shipped()), None):
        made = [picture_of(mi, scene, prior, seed) for seed in range(4)]
        mean = sum(made) / 4
        noise.append(np.mean([np.abs(picture - mean) / (mean + 1e-2) for picture in made]))
    assert noise[0] < 0.95 * noise[1]


@needs_mitsuba
def test_a_survey_finds_how_far_away_things_are() -> None:
    room = random_room("lamps", 1)
    scene = load_scene({key: value for key, value in room.items() if not key.startswith("sphere")})[1]
    from metapp.rendering.guide_cache import GuideCache
    from metapp.rendering.guide_survey import survey

    cache = GuideCache([-1.01, -1.01, -1.01], [1.01, 1.01, 1.01])
    surveyed, luminance = survey(tracer(), scene, scene.sensors()[0], cache, 3, features=True)
    assert surveyed is not None
    assert luminance.shape == (128, 128)
    floor = (surveyed.voxels[:, 1] == 0) & (surveyed.voxels[:, 3] == 2)  # faces up
    assert floor.sum() > HALF**2 / 2
    straight = torch.expm1(surveyed.features[floor, 2, SIDE // 2 - 1 : SIDE // 2 + 1, SIDE // 2 - 1 : SIDE // 2 + 1])
    assert float((straight - 2).abs().median()) < 0.1
    cosine = surveyed.features[floor, 3, SIDE // 2, SIDE // 2]
    assert float(cosine.median()) > 0.95
    emitted = surveyed.features[:, 1]
    assert float(emitted.min()) >= 0
    assert 0.5 < float(emitted.max()) <= 1


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
    from metapp.rendering import guide_survey
    from metapp.rendering.guide_cache import GuideCache

    traced: list[FirstHits] = []
    monkeypatch.setattr(guide_survey, "features_of", lambda hits, *_: traced.append(hits))
    cache = GuideCache([-1, -1, -0.1], [1, 1, 1.1])
    surveyed, _ = guide_survey.survey(tracer(), scene, scene.sensors()[0], cache, 3, features=True)
    assert surveyed is not None
    entry, emitted = (values[:, :, (SIDE // 2) * SIDE + SIDE // 2] for values in (traced[0].entry, traced[0].emitted))
    floor = (surveyed.voxels[:, 3] == 4) & (surveyed.voxels[:, 0] == 0)
    below, open_floor = floor & (surveyed.voxels[:, 2] > HALF // 2), floor & (surveyed.voxels[:, 2] < HALF // 2 - 1)
    assert min(int(below.sum()), int(open_floor.sum())) > HALF
    assert (entry[below] % AXES == 5).all()  # the board's lower side
    assert not emitted[below].any()
    assert (entry[open_floor] == ENTRIES).all()
    # the power heuristic of a density of nearly 1 / pi and that of the sky, 1 / (4 pi)
    sky = emitted[open_floor]
    torch.testing.assert_close(sky, torch.full_like(sky, 2 * 16 / 17), rtol=5e-3, atol=0)


@needs_mitsuba
def test_weights_are_of_the_power_heuristic() -> None:
    from metapp.rendering.guided_path import mis_weight
    from metapp.rendering.jit import mi

    weight = mis_weight(mi.Float([1, 2, 0, 5]), mi.Float([3, 0, 1, 5]))
    assert weight.numpy() == pytest.approx([0.1, 1, 0, 0.5])
