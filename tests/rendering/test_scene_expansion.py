"""Scenes of few objects whose references make many of them, and what ordinary scenes share."""

import contextlib
from typing import Any

import pytest

from metapp.rendering.scenes.rules import SceneChecker, SceneFiles
from tests.needs_mitsuba import needs_mitsuba

pytestmark = needs_mitsuba


def ref(name: str) -> dict[str, Any]:
    return {"type": "ref", "id": name}


def check(parts: dict[str, Any]) -> dict[str, Any]:
    return SceneChecker(SceneFiles()).check_object({"type": "scene", **parts})


def chain(kind: str, parts: tuple[str, ...], length: int, last: dict[str, Any], **more: Any) -> dict[str, Any]:
    """Objects of a kind that each refer to the next by parameters of these names."""
    objects = {f"b{i}": {"type": kind, **{part: ref(f"b{i + 1}") for part in parts}, **more} for i in range(length)}
    return {**objects, f"b{length}": last}


DIFFUSE = {"type": "diffuse"}
GROWING: dict[str, dict[str, Any]] = {
    "blendbsdf": chain("blendbsdf", ("x", "y"), 14, DIFFUSE, weight=0.5),
    "twosided": chain("twosided", ("x", "y"), 14, DIFFUSE),
    "textures": chain("checkerboard", ("color0", "color1"), 14, {"type": "checkerboard"}),
    "three": chain("blendbsdf", ("x", "y", "weight"), 8, DIFFUSE),
    "within shapes": {
        "s": {"type": "sphere", "bsdf": {"type": "twosided", "x": ref("b0"), "y": ref("b0")}},
        **chain("blendbsdf", ("x", "y"), 14, DIFFUSE, weight=0.5),
    },
    "emitters": {
        "e": {"type": "sphere", "emitter": {"type": "area", "radiance": ref("b0")}},
        **chain("checkerboard", ("color0", "color1"), 14, {"type": "checkerboard"}),
    },
}


@pytest.mark.parametrize("name", GROWING)
def test_references_that_grow_are_counted_and_refused(name: str) -> None:
    with pytest.raises(
        ValueError, match=r"[\d,]+ objects with .*'(b0|s.bsdf|e.emitter)' .*, expected 1,000 at most .* in the f"
    ):
        check(GROWING[name])


def test_all_names_of_an_object_are_counted() -> None:
    """Mitsuba knows an object by its id, or else by its key; those of nested objects, by the path."""
    inner = {"type": "blendbsdf", "weight": 0.5, "x": ref("b0"), "y": ref("b0"), "id": "inner"}
    growing = {
        **chain("blendbsdf", ("x", "y"), 5, DIFFUSE, weight=0.5),
        "outer": {"type": "twosided", "nested": inner},
    }
    check(growing)
    for name in ("inner", "outer.nested"):
        with pytest.raises(ValueError, match="objects with references written out"):
            check({**growing, **{f"m{i}": {"type": "twosided", "x": ref(name)} for i in range(20)}})


def test_chains_of_references_are_levels() -> None:
    check(chain("twosided", ("x",), 15, DIFFUSE))
    for length in (20, 70, 20_000):
        with pytest.raises(ValueError, match="by references, more than 16 deep"):
            check(chain("twosided", ("x",), length, DIFFUSE))
        with pytest.raises(ValueError, match="by references, more than 16 deep"):
            check(dict(reversed(chain("twosided", ("x",), length, DIFFUSE).items())))


def test_chains_that_are_written_out_are_levels() -> None:
    """Mitsuba's code grows by the square of a chain's length, wherever its objects are written."""
    for length, is_allowed in ((14, True), (30, False)):
        material: dict[str, Any] = DIFFUSE
        for _ in range(length):
            material = {"type": "mask", "opacity": 0.5, "x": material}
        scene = {"s": {"type": "sphere", "bsdf": material}}
        with contextlib.nullcontext() if is_allowed else pytest.raises(ValueError, match="more than 16 deep"):
            check(scene)


def test_a_cycle_is_left_to_mitsuba() -> None:
    check(chain("twosided", ("x",), 3, {"type": "twosided", "x": ref("b0")}))


def test_what_ordinary_scenes_share_is_allowed() -> None:
    maps = {f"t{i}": {"type": "checkerboard"} for i in range(8)}
    wood = {"type": "twosided", "x": {"type": "principled", **{f"map{i}": ref(f"t{i}") for i in range(8)}}}
    shapes = {f"s{i}": {"type": "cube", "bsdf": ref("wood")} for i in range(5_000)}
    check({**maps, "wood": wood, **shapes})
    check({**maps, **{f"s{i}": {"type": "cube", "bsdf": wood} for i in range(2_000)}})
    check(chain("blendbsdf", ("x", "y"), 6, DIFFUSE, weight=0.5))


def test_instanced_shapes_are_counted() -> None:
    group = {"type": "shapegroup", **{f"s{i}": {"type": "sphere"} for i in range(100)}}
    forest = {f"i{i}": {"type": "instance", "g": ref("trees")} for i in range(1_000)}
    check({"trees": group, **forest})
    with pytest.raises(ValueError, match="100,100 shapes in all instances of shape groups, expected 100,000 at most"):
        check({"trees": group, **forest, "more": {"type": "instance", "g": ref("trees")}})


SPECTRA: dict[str, list[Any]] = {
    "of 1 rows, expected two or more": [[[400, 0.1]]],
    "pair 2: a wavelength of 400 nm after 500": [[[500, 0.1], [400, 0.2]]],
    "pair 2: a wavelength of 400 nm after 400": [[[400, 0.1], [400, 0.2]]],
    "pair 1: a wavelength of -4 nm": [[[-4, 0.1], [400, 0.2]]],
    "pair 2: a value of -0.2": [[[400, 0.1], [500, -0.2]]],
    "pair 1: a value of -1, expected a finite": [-1.0],
    "pair 1: a value of 1e\\+300, expected a finite": [[[400, 1e300], [700, 0.1]]],
    "pair 2: a wavelength of 1e\\+200 nm": [[[400, 0.1], [1e200, 0.1]]],
    "wavelengths of 0.4 to 0.7 nm, which are black, expected some from 360": [[[0.4, 0.1], [0.7, 0.1]]],
    "wavelengths of 1000 to 2500 nm, which are black": [[[1000, 0.1], [2500, 0.1]]],
}


@pytest.mark.parametrize("message", SPECTRA)
def test_spectra_of_no_use_are_refused(message: str) -> None:
    for value in SPECTRA[message]:
        spectrum = {"type": "spectrum", "value": value}
        with pytest.raises(ValueError, match=message):
            check({"material": {"type": "diffuse", "reflectance": spectrum}})
        if isinstance(value, list):
            texts = {name: ", ".join(str(row[i]) for row in value) for i, name in ((0, "wavelengths"), (1, "values"))}
            with pytest.raises(ValueError, match=message):
                check({"material": {"type": "diffuse", "reflectance": {"type": "irregular", **texts}}})


def test_ordinary_spectra_are_allowed() -> None:
    regular = {"type": "regular", "wavelength_min": 400.0, "wavelength_max": 700.0, "values": "0.1, 0.2, 0"}
    for spectrum in (
        {"type": "spectrum", "value": 0.5},
        {"type": "spectrum", "value": [[400, 0.1], [700, 5.0]]},
        {"type": "irregular", "wavelengths": "400, 500", "values": "0.1, 0.2"},
        regular,
    ):
        check({"material": {"type": "diffuse", "reflectance": spectrum}})
    for wrong in ({"values": "0.1"}, {"values": "0.1, nan"}, {"values": "a, b"}, {"wavelength_max": 300.0}):
        with pytest.raises(ValueError, match="expected"):
            check({"material": {"type": "diffuse", "reflectance": {**regular, **wrong}}})
