"""The prior of guided paths: what the network says untrained, what a survey sees, and that the one that ships helps."""

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
from metapp.rendering.guide_cache import AXES, CELLS, GRID, PLACES, POWER, SHARE, SIDE, moments
from metapp.rendering.guide_prior import FEATURES, Prior, densities, init, read_prior, shipped, taught
from metapp.rendering.guide_survey import LEAN, SEEN, Seen, Sights, features, survey
from metapp.storage.records import save_checkpoint
from tests.needs_mitsuba import needs_mitsuba

HALF = GRID // 2


def drawn(*shape: int) -> torch.Tensor:
    return torch.rand(*shape, generator=Generator().manual_seed(1), dtype=torch.float64) + 0.1


def test_untrained_it_says_again_what_paths_taught() -> None:
    squares, counts = drawn(3, SIDE, SIDE), drawn(3, SIDE, SIDE)
    read = torch.cat([torch.randn(3, len(SEEN), SIDE, SIDE), taught(squares, counts, squares)], 1)
    share = squares.flatten(1) ** POWER
    expected = 1 / SHARE / CELLS + (1 - 1 / SHARE) * share / share.sum(1, keepdim=True)
    torch.testing.assert_close(densities(init(Generator()), read).double(), expected, rtol=1e-4, atol=0)


def test_densities_have_a_floor_and_sum_to_one() -> None:
    theta = {key: torch.randn(value.shape) for key, value in init(Generator()).items()}
    found = densities(theta, torch.randn(5, FEATURES, SIDE, SIDE))
    torch.testing.assert_close(found.sum(1), torch.ones(5))
    assert found.min() >= 1 / SHARE / CELLS * (1 - 1e-5)


def test_places_that_no_survey_saw_are_as_without_it() -> None:
    seen = Seen(torch.full((HALF**3 * AXES,), -1), torch.zeros(0, 4), torch.zeros(0, len(SEEN), SIDE, SIDE))
    squares, counts = drawn(2, SIDE, SIDE), drawn(2, SIDE, SIDE)
    voxels = torch.tensor([[0, 0, 0, 1], [3, 2, 1, 0]])
    found = Prior(init(Generator()), seen)(squares, counts, voxels)
    torch.testing.assert_close(found, moments(squares, counts, voxels))


def test_what_arrives_is_what_is_sent_there() -> None:
    place = torch.zeros(1, 4, CELLS, dtype=torch.long)
    place[..., CELLS // 2 :] = 7  # another place is met in half of the cells
    sums, counts = torch.zeros(PLACES, dtype=torch.float64), torch.zeros(PLACES, dtype=torch.float64)
    sums[0], counts[0], sums[7], counts[7] = 1e8, 1e8, 3e8, 1e8  # so many that nothing leans
    nothing = torch.zeros(1, 4, CELLS)
    arrives = features(Sights(place, nothing, nothing + 1, nothing + 0.5), sums, counts)[0]
    assert arrives.shape == (len(SEEN), SIDE, SIDE)
    ratio = arrives[0].flatten()[-1] - arrives[0].flatten()[0]
    assert float(ratio) == pytest.approx(math.log(9), abs=1e-4)
    assert not arrives[1].any()
    assert float(arrives[2, 0, 0]) == pytest.approx(math.log(2))
    assert (arrives[3] == 0.5).all()


def test_places_that_few_paths_met_send_what_those_around_them_do() -> None:
    sums, counts = torch.zeros(PLACES, dtype=torch.float64), torch.zeros(PLACES, dtype=torch.float64)
    sums[0], counts[0] = 5e8, 1e8
    place = torch.zeros(1, 4, CELLS, dtype=torch.long)
    place[..., 0] = AXES  # the next voxel, in the same one of twice the side
    place[..., 1] = 2 * AXES * 2  # in another, of which nothing is known: the mean of all
    nothing = torch.zeros(1, 4, CELLS)
    found = features(Sights(place, nothing, nothing, nothing), sums, counts)[0, 0].flatten()
    assert float(found[0] - found[2]) == pytest.approx(0, abs=1e-4)
    assert float(found[1] - found[2]) == pytest.approx(0, abs=1e-4)
    counts[AXES] = LEAN  # as many dark paths as those around count for
    found = features(Sights(place, nothing, nothing, nothing), sums, counts)[0, 0].flatten()
    assert float(found[0] - found[2]) == pytest.approx(2 * math.log(0.5), abs=1e-3)


def test_a_file_of_something_else_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"no.safetensors: no such checkpoint"):
        read_prior(tmp_path / "no.safetensors")
    other = tmp_path / "other.safetensors"
    save_checkpoint(other, MetaParameters(encoder={"first.kernel": torch.zeros(2)}), {"app": "brdf"})
    with pytest.raises(ValueError, match=r"another network, expected one of guide priors"):
        read_prior(other)


# In Mitsuba


@pytest.fixture(scope="module")
def mi() -> Any:
    from metapp.rendering.variant import load_mitsuba

    return load_mitsuba()


def picture_of(mi: Any, scene: Any, prior: Any, seed: int, spp: int = 16) -> np.ndarray[Any, Any]:
    from metapp.rendering.guided_path import PathTracer, Settings
    from metapp.rendering.guided_picture import GuidedPicture, parts_of

    tracer = PathTracer(mi, Settings(6, 5))
    made = GuidedPicture(mi.load_dict({"type": "path", "max_depth": 6}), tracer, scene, scene.sensors()[0], seed, prior)
    for part in parts_of(spp, 64**2):
        made.pays = True
        made.add(part)
    film = scene.sensors()[0].film()
    film.prepare([])
    film.put_block(made.block)
    return np.array(film.develop(), np.float64)[..., :3]


@needs_mitsuba
def test_the_prior_that_ships_lowers_the_noise(mi: Any) -> None:
    from metapp.rendering.scene_loading import load_scene

    scene = load_scene(random_room("board", 5000))[1]  # of no training
    noise = []
    for prior in (read_prior(shipped()), None):
        made = [picture_of(mi, scene, prior, seed) for seed in range(4)]
        mean = sum(made) / 4
        noise.append(np.mean([np.abs(each - mean) / (mean + 1e-2) for each in made]))
    assert noise[0] < 0.95 * noise[1]


@needs_mitsuba
def test_a_survey_sees_how_far_away_things_are(mi: Any) -> None:
    from metapp.rendering.guide_cache import GuideCache
    from metapp.rendering.guided_path import PathTracer, Settings
    from metapp.rendering.scene_loading import load_scene

    room = random_room("lamps", 1)
    scene = load_scene({key: value for key, value in room.items() if not key.startswith("sphere")})[1]
    cache = GuideCache(mi, [-1.01, -1.01, -1.01], [1.01, 1.01, 1.01])
    tracer = PathTracer(mi, Settings(6, 5))
    seen, luminance = survey(tracer, scene, scene.sensors()[0], cache, 3, looks=True)
    assert seen is not None
    assert luminance.shape == (128, 128)
    floor = (seen.voxels[:, 1] == 0) & (seen.voxels[:, 3] == 2)  # faces up
    assert floor.sum() > HALF**2 / 2
    straight = torch.expm1(seen.features[floor, 2, SIDE // 2 - 1 : SIDE // 2 + 1, SIDE // 2 - 1 : SIDE // 2 + 1])
    assert float((straight - 2).abs().median()) < 0.1
    cosine = seen.features[floor, 3, SIDE // 2, SIDE // 2]
    assert float(cosine.median()) > 0.95
    emitted = seen.features[:, 1]
    assert float(emitted.min()) >= 0
    assert 0.5 < float(emitted.max()) <= 1
