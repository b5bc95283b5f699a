"""Scenes in memory become those of files that hold the same, or are refused in a line."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metapp.extensions.scene_files.reading import read_scene, scene_in_memory
from metapp.rendering.scenes.loading import load_scene
from tests.needs_mitsuba import needs_mitsuba


def small_scene(transform: Any) -> dict[str, Any]:
    return {
        "type": "scene",
        "camera": {"type": "perspective", "fov": np.float32(40), "to_world": transform},
        "ball": {"type": "sphere", "center": (0, np.float64(0.25), 0), "bsdf": {"type": "diffuse"}},
        "light": {"type": "constant", "radiance": {"type": "rgb", "value": np.array([1.0, 2.0, 3.0])}},
    }


@needs_mitsuba
def test_a_scene_is_its_dictionary(mitsuba: Any) -> None:
    matrix = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -5], [0, 0, 0, 1]])
    plain = json.loads(json.dumps(small_scene(matrix.tolist()), default=lambda value: value.tolist()))
    plain["ball"]["center"] = [0, 0.25, 0]
    for transform in (matrix, mitsuba.ScalarTransform4f(matrix), mitsuba.Transform4f(matrix.tolist())):
        made = scene_in_memory(small_scene(transform), "object")
        assert made == plain
    for point in (mitsuba.ScalarPoint3f(1, 2, 3), mitsuba.Point3f(1, 2, 3)):
        around = {"type": "scene", "a": {"type": "sphere", "center": point}}
        assert scene_in_memory(around, "object")["a"]["center"] == [1, 2, 3]


@needs_mitsuba
def test_a_scene_of_mitsuba_is_one(mitsuba: Any) -> None:
    made = scene_in_memory(mitsuba.cornell_box(), "object")
    assert len(load_scene(made).scene.emitters()) == 1
    loaded = mitsuba.load_dict({"type": "diffuse"})
    with pytest.raises(ValueError, match=r"object: \w+ as 'bsdf', expected numbers, text, a transform or a dictionary"):
        scene_in_memory({"type": "scene", "a": {"type": "sphere", "bsdf": loaded}}, "object")


def test_a_scene_is_its_text(tmp_path: Path) -> None:
    text = "<scene version='3.0.0'><shape type='sphere'/></scene>"
    (tmp_path / "file.xml").write_text(text)
    assert scene_in_memory(text, "object") == read_scene(tmp_path / "file.xml")


WITHIN: dict[str, Any] = {"type": "scene"}
WITHIN["scene"] = WITHIN


@pytest.mark.parametrize(
    ("source", "line"),
    [
        (3, "object: int, expected a path, a scene as Mitsuba's load_dict takes it, or XML text"),
        ({"type": "scene", "a": object()}, "object: object as 'a', expected numbers"),
        (WITHIN, "object: objects within each other, more than 64 deep, expected fewer"),
    ],
)
def test_what_is_no_scene_is_refused_in_a_line(source: object, line: str) -> None:
    with pytest.raises(ValueError, match=line) as caught:
        scene_in_memory(source, "object")
    assert "\n" not in str(caught.value)
