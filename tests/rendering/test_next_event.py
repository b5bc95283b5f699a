"""Next-event estimation: what paths carry stays the same in the mean, samples are in proportion, pictures are whole."""

from __future__ import annotations

import copy
import math
from typing import Any

import pytest
import torch
from torch import Generator, Tensor

from data_tools.synthetic.cornell import random_scene, rgb
from metapp.rendering.paths import path_space
from metapp.rendering.paths.path_space import FewPaths, Tracer, path_samples, reference, render
from metapp.rendering.paths.resampling import draw_samples, resampled
from tests.marked import long
from tests.needs_mitsuba import needs_mitsuba
from tests.rendering.test_path_space import corner

Scene = dict[str, Any]


def small_lamp(seed: int, times: float) -> Scene:
    """A Cornell box whose lamp has sides so many times shorter, and the same power."""
    scene: Scene = copy.deepcopy(random_scene(seed))
    lamp = scene["light"]
    lamp["to_world"] = [[*(value / times for value in row[:2]), *row[2:]] for row in lamp["to_world"]]
    radiance = lamp["emitter"]["radiance"]["value"]
    lamp["emitter"]["radiance"] = rgb([times**2 * value for value in radiance])
    return scene


def bulb(seed: int, **more: Any) -> Scene:
    """A Cornell box with a point light instead of its lamp."""
    scene = {key: value for key, value in random_scene(seed).items() if key != "light"}
    return {**scene, "bulb": {"type": "point", "position": [0.1, 0.7, 0.0], "intensity": rgb([1.0] * 3)}, **more}


class _Steep:
    """Stands for a tracer: paths that carry 3 u^2 along one number, by a noise whose mean is 1."""

    next_event = True

    def contributions(self, points: Tensor, rng: Generator) -> Tensor:
        noise = 4.0 * (torch.rand(len(points), 1, generator=rng) < 0.25)
        return (3 * points[:, 2:3] ** 2 * noise).expand(-1, 3)


def test_moves_leave_the_density_of_a_noisy_function_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(path_space, "BATCH_PATHS", 2**16)
    points, image = resampled(_Steep(), 20_000, Generator().manual_seed(0))  # type: ignore[arg-type]
    # of a density 3 x^2 the cumulative distribution is x^3; Kolmogorov and Smirnov's distance is below 2 / sqrt(N)
    place = points[:, 2].sort().values.double()
    assert float((place**3 - torch.arange(len(place)) / len(place)).abs().max()) < 2 / math.sqrt(len(place))
    assert float(image.mean()) == pytest.approx(1, abs=0.05)


@pytest.mark.long
@needs_mitsuba
def test_samples_are_resampled_where_and_only_where_few_paths_meet_a_light(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(path_space, "BATCH_PATHS", 2**16)
    plain, small = Tracer(random_scene(0)), Tracer(small_lamp(0, 12))
    expected = path_samples(plain, 500, Generator().manual_seed(3))
    found = draw_samples(plain, 500, Generator().manual_seed(3))
    assert not plain.next_event
    assert all(map(torch.equal, expected, found))  # bit for bit
    with pytest.raises(FewPaths, match="meet a light"):
        path_samples(small, 500, Generator())
    points, _ = draw_samples(small, 500, Generator())
    assert small.next_event
    assert points.shape == (500, 4)


@needs_mitsuba
@pytest.mark.parametrize("scene", [bulb(1), long(small_lamp(3, 2))], ids=["bulb", "small"])
def test_pictures_are_those_of_the_reference(scene: Scene) -> None:
    tracer = Tracer(scene, next_event=True)
    guide = corner(16.0)
    wanted = float(reference(tracer, 8, 8192)[:, 4:].mean())  # the lower half, without the lamp
    for each in (None, guide):
        shots = torch.stack([render(tracer, 512, 8, seed, each)[:, 4:].mean() for seed in range(8)]).double()
        error = float(shots.std() / len(shots) ** 0.5)
        assert abs(float(shots.mean()) - wanted) < 3.5 * error + 0.003 * wanted
        assert error < 0.1 * wanted


@needs_mitsuba
def test_weights_are_of_the_power_heuristic() -> None:
    from metapp.rendering.jit import mi
    from metapp.rendering.paths.next_event import mis_weight

    weight = mis_weight(mi.Float([1, 2, 0, 5]), mi.Float([3, 0, 1, 5]))
    assert weight.numpy() == pytest.approx([0.1, 1, 0, 0.5])
