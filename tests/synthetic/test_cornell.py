"""Random Cornell boxes, the same again from their JSON text."""

from __future__ import annotations

import itertools
import json
import math
from typing import Any

import numpy as np
import pytest
import torch

from data_tools.synthetic.cornell import random_scene, to_xml
from tests.needs_mitsuba import needs_mitsuba

SCENES = [random_scene(seed) for seed in range(200)]
WALLS = {"floor", "ceiling", "back", "left", "right"}


def spheres(scene: dict[str, Any]) -> list[tuple[np.ndarray, float]]:
    """Centres and radii."""
    matrices = [np.array(part["to_world"]) for key, part in scene.items() if key.startswith("sphere-")]
    return [(matrix[:3, 3], float(np.linalg.norm(matrix[:3, 0]))) for matrix in matrices]


def corners(rectangle: dict[str, Any]) -> np.ndarray:
    """Of a rectangle, [4, 3]."""
    matrix = np.array(rectangle["to_world"])
    return np.array([(matrix @ [x, y, 0, 1])[:3] for x, y in itertools.product((-1, 1), (-1, 1))])


def facing(rectangle: dict[str, Any]) -> list[float]:
    return np.array(rectangle["to_world"])[:3, 2].tolist()


def check_balls(scene: dict[str, Any]) -> None:
    balls = spheres(scene)
    assert 1 <= len(balls) <= 5
    assert set(scene) == {"type", "sensor", "mirror", "light"} | WALLS | {f"sphere-{i}" for i in range(len(balls))}
    for centre, radius in balls:
        assert (np.abs(centre) + radius <= 1 + 1e-9).all()
        assert abs(centre[0]) + radius < 0.98  # in front of the mirror
        assert centre[1] + radius < 0.98  # below the light
    for (first, near), (second, far) in itertools.combinations(balls, 2):
        assert math.dist(first, second) > near + far


def check_mirror_and_light(scene: dict[str, Any]) -> None:
    mirror, light = corners(scene["mirror"]), corners(scene["light"])
    assert set(mirror[:, 0]) in ({0.99}, {-0.99})
    assert facing(scene["mirror"]) == pytest.approx([-np.sign(mirror[0, 0]), 0, 0])
    assert np.abs(mirror[:, 1:]).max() < 1
    assert set(light[:, 1]) == {0.99}
    assert facing(scene["light"]) == pytest.approx([0, -1, 0])
    assert np.abs(light[:, [0, 2]]).max() < 1
    radiance = scene["light"]["emitter"]["radiance"]["value"]
    assert np.prod(np.ptp(light[:, [0, 2]], axis=0)) * np.mean(radiance) == pytest.approx(4)  # any size gives as much
    for name in WALLS:
        assert np.dot(facing(scene[name]), corners(scene[name]).mean(0)) == pytest.approx(-1)


def test_all_is_inside_the_box_nothing_overlaps_and_mirror_and_light_hang_where_they_should() -> None:
    for scene in SCENES:
        check_balls(scene)
    for scene in SCENES[:50]:
        check_mirror_and_light(scene)


def test_a_seed_is_a_scene() -> None:
    assert random_scene(3) == SCENES[3]
    assert len({json.dumps(scene) for scene in SCENES}) == len(SCENES)
    with pytest.raises(ValueError, match="seed -1, expected 0 or more"):
        random_scene(-1)


@needs_mitsuba
def test_a_scene_as_xml_is_the_same_as_its_dictionary() -> None:
    from metapp.rendering.paths.path_space import Tracer

    points = torch.rand(4000, 4, generator=torch.Generator().manual_seed(0))
    carried = [
        Tracer(each).contributions(points, torch.Generator().manual_seed(0))
        for each in (SCENES[3], {"xml": to_xml(SCENES[3])})
    ]
    assert carried[0].any()
    torch.testing.assert_close(*carried, rtol=1e-4, atol=1e-5)
