"""Scenes that guided paths are measured on: Cornell boxes, Mitsuba's own, a lamp behind a baffle, and a glass caustic.

They are dictionaries of Mitsuba 3; `bench_guiding` renders them.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from data_tools.synthetic.cornell import SceneEntry, diffuse_bsdf, random_scene, rectangle_entry, rgb_entry
from metapp.rendering.variant import load_mitsuba

BOX_SEEDS = (101, 102, 103, 104)  # seeds of random Cornell boxes


def scenes_by_name() -> dict[str, SceneEntry]:
    """Return all scenes, by name."""
    boxes = {f"box {seed}": random_scene(seed) for seed in BOX_SEEDS}
    return boxes | {"mitsuba": mitsuba_box_scene(), "baffle": baffle_scene(), "caustic": caustic_scene()}


def scene_kind(name: str) -> str:
    """Return the kind that a scene is counted among: boxes, mitsuba, baffle or caustic."""
    return "boxes" if name.startswith("box") else name


def mitsuba_box_scene() -> SceneEntry:
    """Return the Cornell box that comes with Mitsuba, with two blocks; its pixels are means by a box filter."""
    scene: SceneEntry = _convert_matrices(load_mitsuba().cornell_box())
    scene["sensor"]["film"]["rfilter"] = {"type": "box"}
    return scene


def _convert_matrices(value: Any) -> Any:
    """Return a scene with nested lists in place of Mitsuba's matrices."""
    if isinstance(value, dict):
        return {key: _convert_matrices(entry) for key, entry in value.items()}
    return np.array(value.matrix).reshape(4, 4).tolist() if hasattr(value, "matrix") else value


def baffle_scene() -> SceneEntry:
    """Return a room whose lamp shines on the ceiling alone, above a board."""
    room = _empty_room()
    room["light"] = _square(0.9, 0.2, down=False) | _area_light([25.0, 25.0, 22.0])
    for name, height, down in (("board", 0.85, True), ("board, above", 0.851, False)):
        room[name] = _square(height, 0.35, down=down) | {"bsdf": _grey_bsdf(0.5)}
    room["ball"] = {"type": "sphere", "center": [0.3, -0.65, 0.1], "radius": 0.35, "bsdf": _grey_bsdf(0.6)}
    return room


def caustic_scene() -> SceneEntry:
    """Return a room with a small lamp over two balls of glass."""
    room = _empty_room()
    room["light"] = _square(0.98, 0.08, down=True, at=(0.3, 0.2)) | _area_light([150.0, 150.0, 140.0])
    glass = {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0}
    room["large"] = {"type": "sphere", "center": [0.0, -0.3, 0.0], "radius": 0.4, "bsdf": glass}
    room["small"] = {"type": "sphere", "center": [-0.6, -0.75, 0.4], "radius": 0.25, "bsdf": glass}
    return room


def _empty_room() -> SceneEntry:
    """Return the walls and the camera of a random Cornell box."""
    kept_names = ("type", "sensor", "floor", "ceiling", "back", "left", "right")
    return {key: value for key, value in random_scene(7).items() if key in kept_names}


def _square(height: float, half: float, *, down: bool, at: tuple[float, float] = (0.0, 0.0)) -> SceneEntry:
    """Return a level square that faces up or down."""
    return rectangle_entry((at[0], height, at[1]), (half, 0, 0), (0, 0, half if down else -half), _grey_bsdf(0.0))


def _area_light(radiance: list[float]) -> SceneEntry:
    """Return the entry that makes a shape shine."""
    return {"emitter": {"type": "area", "radiance": rgb_entry(radiance)}}


def _grey_bsdf(value: float) -> SceneEntry:
    """Return a grey diffuse material."""
    return diffuse_bsdf([value] * 3)
