"""What a scene may hold, at the limits: the largest that is allowed, and what is just beyond."""

import importlib.util
import json
import math
from typing import Any

import pytest
import torch

from metapp.rendering.scenes import rules
from metapp.rendering.scenes.rules import (
    MAX_NESTED_LEVELS,
    MAX_SCENE_VALUES,
    MAX_VALUE_CHARACTERS,
    SceneChecker,
    SceneFiles,
    box_film,
)
from metapp.rendering.scenes.stored_text import TEXT_BLOCK_BYTES, decode_scene, encode_scene
from tests.needs_mitsuba import needs_mitsuba


def check_scene_of(most_values: int = MAX_SCENE_VALUES, **parts: Any) -> dict[str, Any]:
    """A scene of these, after its check."""
    return SceneChecker(SceneFiles(), most_values).check_object({"type": "scene", **parts})


def nested_objects(depth: int) -> dict[str, Any]:
    scene: dict[str, Any] = {"type": "sphere"}
    for _ in range(depth - 1):
        scene = {"type": "twosided", "below": scene}
    return scene


def diffuse(reflectance: Any) -> dict[str, Any]:
    return {"below": {"type": "diffuse", "reflectance": reflectance}}


PAIRS = [[400, 0.1], [700, 0.2]]
BAD: dict[str, tuple[dict[str, Any], ...]] = {
    "expected 1 to 255 characters, none of them a point":
        tuple({key: {"type": "sphere"}} for key in ("a" * 256, "", "a.b", "a\nb")),
    "expected up to 256 printable characters": ({"id": "n" * 257}, {"id": "a\tb"}),
    f"{MAX_NESTED_LEVELS} deep, expected fewer": ({"below": nested_objects(MAX_NESTED_LEVELS)},),
    "expected plain text, no path":
        tuple({"note": text} for text in ("x" * (MAX_VALUE_CHARACTERS + 1), "ö", "a\nb", "a/b", "a\\b", "a$b", "a..b")),
    "names the file 'x.png', expected none": ({"filename": "x.png"}, {"normal_filename": "x.png"}),
    "expected one of Mitsuba's own": ({"material": "unobtainium"},),
    "expected a finite number, text, true, false, three":
        tuple({"value": value} for value in (
            2**63, -(2**63), math.nan, math.inf, None, [], [1, 2], [1, 2, 3, 4], [1, 2, math.nan], [1, 2, True],
            [[1, 0], [0, 1]], [[1.0] * 5] * 5, [[1, 2, 3]] * 4, [[1, 2, 3], [1, 2, 3], [1, 2]], [[1, 2, "3"]] * 3,
            [[1, 2, 3], [1, 2, 3], 3])),
    "an object of type": tuple({"below": {"type": kind}} for kind in (None, 3, ["scene"])),
    "a value of": ({"below": {"type": "sphere", "id": 3}},),
    "a scene within a scene": ({"below": {"type": "scene"}}, *({"type": kind} for kind in ("sphere", "rgb", "ref"))),
    "a 'rgb' with": tuple(diffuse({"type": "rgb", **more}) for more in (
        {}, {"value": [1, 2]}, {"value": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}, {"value": [1, 2, 3], "more": 1},
        {"value": "1"})),
    "a 'spectrum' with": tuple(diffuse({"type": "spectrum", **more}) for more in (
        {"value": [[400, 1, 2]]}, {"value": [[400, None]]}, {"value": [400, 1, 2]},
        {"value": PAIRS, "filename": "x.spd"})),
    "a 'ref' with": (diffuse({"type": "ref"}),),
}  # fmt: skip


@needs_mitsuba
@pytest.mark.parametrize("message", BAD)
def test_scenes_beyond_a_limit_are_refused(message: str) -> None:
    for parts in BAD[message]:
        with pytest.raises(ValueError, match=message):
            check_scene_of(**parts)


@needs_mitsuba
def test_the_number_of_values_is_limited() -> None:
    assert len(check_scene_of(10, **{f"v{i}": i for i in range(9)})) == 10  # and its type
    for parts in ({f"v{i}": i for i in range(10)}, {f"s{i}": {"type": "sphere", "radius": 1.0} for i in range(4)}):
        with pytest.raises(ValueError, match="more than 10 values"):
            check_scene_of(10, **parts)


def test_a_scene_is_what_its_text_says() -> None:
    for scene in (box_film(7, 5), {"name": "ö" * TEXT_BLOCK_BYTES}):
        text = encode_scene(scene)
        assert len(text) % TEXT_BLOCK_BYTES == 0
        assert len(text) - TEXT_BLOCK_BYTES < len(json.dumps(scene)) <= len(text)
        assert decode_scene(text) == scene
    for raw in (b"{", b"[" * 100_000, b"\xff"):
        with pytest.raises(ValueError, match=r"a stored scene is no JSON .*; make the data anew"):
            decode_scene(torch.frombuffer(bytearray(raw), dtype=torch.uint8))


def test_without_mitsuba_one_line_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"mitsuba: not installed, .*; pip install mitsuba"):
        rules.mitsuba_folder()
