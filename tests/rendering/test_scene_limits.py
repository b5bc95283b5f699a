"""What a scene may hold, at the limits: the largest that is allowed, and what is just beyond."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable
from typing import Any

import pytest
import torch

from metapp.rendering.scenes import plugins, rules
from metapp.rendering.scenes.rules import (
    BYTES,
    DEPTH,
    CheckedDict,
    Files,
    box_film,
    checked_string,
    scene_bytes,
    scene_of,
)
from tests.needs_mitsuba import needs_mitsuba


def refused(message: str, call: Callable[..., Any], *words: Any) -> None:
    with pytest.raises(ValueError, match=message):
        call(*words)


@pytest.fixture
def checked() -> Callable[..., Any]:
    """Checks a scene of what is given."""
    return lambda **parts: CheckedDict(Files()).object({"type": "scene", **parts})


def test_a_scene_is_what_its_text_says() -> None:
    film = box_film(7, 5)
    assert (film["type"], film["width"], film["height"], film["rfilter"]) == ("hdrfilm", 7, 5, {"type": "box"})
    for scene in (film, {"name": "ö" * BYTES}):
        text = scene_bytes(scene)
        assert len(text) % BYTES == 0
        assert len(text) - BYTES < len(json.dumps(scene)) <= len(text)
        assert scene_of(text) == scene
    for text in (b"{", b"[" * 100_000, b"\xff"):
        stored = torch.frombuffer(bytearray(text), dtype=torch.uint8)
        refused("a stored scene is no JSON .*; make the data anew", scene_of, stored)


@needs_mitsuba
def test_keys_and_names(checked: Callable[..., Any]) -> None:
    for key in ("a" * 255, "b", "with blanks"):
        assert checked(**{key: {"type": "sphere"}}) == {"type": "scene", key: {"type": "sphere"}}
    for key in ("a" * 256, "", "a.b", "a\nb"):
        refused(
            "expected 1 to 255 characters, none of them a point", lambda key=key: checked(**{key: {"type": "sphere"}})
        )
    assert checked(id="n" * 256)["id"] == "n" * 256
    for name in ("n" * 257, "a\tb"):
        refused("expected up to 256 printable characters", lambda name=name: checked(id=name))


@needs_mitsuba
def test_depth_and_number_of_values(checked: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> None:
    def nested(depth: int) -> dict[str, Any]:
        scene: dict[str, Any] = {"type": "sphere"}
        for _ in range(depth - 1):
            scene = {"type": "twosided", "below": scene}
        return scene

    assert checked(below=nested(DEPTH - 1))
    refused(f"{DEPTH} deep, expected fewer", lambda: checked(below=nested(DEPTH)))
    monkeypatch.setattr(rules, "PARTS", 10)
    assert len(checked(**{f"v{i}": i for i in range(9)})) == 10  # and its type
    refused("more than 10 values", lambda: checked(**{f"v{i}": i for i in range(10)}))
    refused("more than 10 values", lambda: checked(**{f"s{i}": {"type": "sphere", "radius": 1.0} for i in range(4)}))


def test_text_of_parameters(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rules, "TEXT", 20)
    assert checked_string("note", "x" * 20, Files()) == "x" * 20
    for value in ("x" * 21, "ö", "a\nb", "a/b", "a\\b", "a$b", "a..b"):
        refused("expected plain text, no path", checked_string, "note", value, Files())
    for name in ("filename", "normal_filename"):
        refused("names the file 'x.png', expected none", checked_string, name, "x.png", Files())


@needs_mitsuba
def test_materials_are_mitsubas() -> None:
    for value in ("Au", "none"):
        assert checked_string("material", value, Files()) == value
    assert checked_string("other", "unobtainium", Files()) == "unobtainium"
    refused("expected one of Mitsuba's own", checked_string, "material", "unobtainium", Files())


GOOD = (0, -1, 2**63 - 1, 1 - 2**63, 1.5, -1e308, True, [1, 2, 3], [[1, 0, 0], [0, 1, 0], [0, 0, 1]], [[1.0] * 4] * 4)
BAD = (2**63, -(2**63), float("nan"), float("inf"), None, [], [1, 2], [1, 2, 3, 4], [1, 2, float("nan")], [1, 2, True],
       [[1, 0], [0, 1]], [[1.0] * 5] * 5, [[1, 2, 3]] * 4, [[1, 2, 3], [1, 2, 3], [1, 2]], [[1, 2, "3"]] * 3,
       [[1, 2, 3], [1, 2, 3], 3])  # fmt: skip


@needs_mitsuba
def test_kinds_of_values(checked: Callable[..., Any]) -> None:
    for value in GOOD:
        assert checked(value=value)["value"] == value
    for value in BAD:
        refused("expected a finite number, text, true, false, three", lambda value=value: checked(value=value))
    for key in ("type", "id"):
        refused("a value of|an object of type", lambda key=key: checked(below={"type": "sphere", key: 3}))


@needs_mitsuba
def test_colours_spectra_and_references(checked: Callable[..., Any]) -> None:
    pairs = [[400, 0.1], [700, 0.2]]
    good: tuple[dict[str, Any], ...] = (
        {"type": "rgb", "value": [1, 2, 3]}, {"type": "rgb", "value": 1}, {"type": "spectrum", "value": pairs},
        {"type": "spectrum", "value": 0.5}, {"type": "ref", "id": "wall"},
    )  # fmt: skip
    for each in good:
        assert checked(below={"type": "diffuse", "reflectance": each})["below"]["reflectance"] == each
    bad: tuple[dict[str, Any], ...] = (
        {"type": "rgb"}, {"type": "rgb", "value": [1, 2]}, {"type": "rgb", "value": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]},
        {"type": "rgb", "value": [1, 2, 3], "more": 1}, {"type": "rgb", "value": "1"}, {"type": "ref"},
        {"type": "spectrum", "value": [[400, 1, 2]]}, {"type": "spectrum", "value": [[400, None]]},
        {"type": "spectrum", "value": [400, 1, 2]}, {"type": "spectrum", "value": pairs, "filename": "x.spd"},
    )  # fmt: skip
    for each in bad:
        refused(f"a '{each['type']}' with", lambda each=each: checked(below={"type": "diffuse", "reflectance": each}))


@needs_mitsuba
def test_one_scene_around_all_else() -> None:
    check = CheckedDict(Files())
    for kind in ("sphere", "rgb", "ref", "spectrum"):
        refused("a scene within a scene, or none at all", check.object, {"type": kind})
    refused("a scene within a scene", check.object, {"type": "scene", "below": {"type": "scene"}})
    for kind in (None, 3, ["scene"]):
        refused("expected each to name a plugin as 'type'", check.object, {"type": kind})


def test_without_mitsuba_one_line_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    refused("mitsuba: not installed, .*; pip install mitsuba", plugins.own_folder)
