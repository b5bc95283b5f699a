"""Random Cornell boxes, as Mitsuba 3 scene dictionaries that JSON can hold.

The box spans [-1, 1] along x (right), y (up) and z (towards the camera), open in front. In it are one to five spheres
of diffuse, glass or metal material, a mirror on a side wall and an area light on the ceiling, all placed at random.
Matrices are nested lists, row by row.
"""

from __future__ import annotations

import colorsys
import math
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from data_tools.random_streams import Rng, random_stream
from data_tools.synthetic.random_values import between, chance, integer_between, log_between, pick

SceneEntry = dict[str, Any]

SPHERE_MATERIALS = ("diffuse", "glass", "metal")
MITSUBA_METALS = ("Ag", "Al", "Au", "Cr", "Cu")

_CAMERA, _FIELD_DEGREES = 3.9, 38.0  # distance from the box's middle, and field of view: the opening fills the picture
_WHITE = 0.75  # reflectance of the floor, the ceiling and the back wall
_POWER = 4.0  # radiance times area of the light, in the box's units
_RADII = (0.18, 0.42)  # smallest and largest radius of a sphere
_GAP = 0.02  # the least distance between two spheres, and of a hovering one to the floor


class SpherePlace(NamedTuple):
    """The place of a sphere in the box, which spans [-1, 1] along each axis.

    Attributes:
        centre: its centre.
        radius: its radius.
    """

    centre: tuple[float, float, float]
    radius: float


def random_scene(seed: int) -> SceneEntry:
    """Draw a Cornell box at random.

    Args:
        seed: seed of all draws, >= 0.

    Returns:
        A scene dictionary that JSON can hold, with the keys sensor, floor, ceiling, back, left, right, mirror, light
        and sphere-0 to sphere-4.

    Raises:
        ValueError: a negative seed.
    """
    if seed < 0:
        raise ValueError(f"Cornell box: seed {seed}, expected 0 or more.")
    return draw_scene(random_stream(seed))


def draw_scene(rng: Rng) -> SceneEntry:
    """Draw a Cornell box, as :func:`random_scene` returns it, from a stream of random numbers."""
    scene: SceneEntry = {"type": "scene", "sensor": sensor_entry()}
    scene |= wall_entries(draw_wall_colour(rng), draw_wall_colour(rng))
    scene["mirror"] = _mirror(rng)
    scene["light"] = _light(rng)
    for number, place in enumerate(draw_sphere_places(rng, integer_between(rng, 1, 5))):
        scene[f"sphere-{number}"] = sphere_entry(place, draw_bsdf(rng))
    return scene


def sensor_entry() -> SceneEntry:
    """Return a camera in front of the open side, which fills the picture."""
    return {
        "type": "perspective",
        "fov": _FIELD_DEGREES,
        # Mitsuba's cameras look along their z, with x to the left.
        "to_world": [[-1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, -1.0, _CAMERA], [0.0, 0.0, 0.0, 1.0]],
        "film": {"type": "hdrfilm", "width": 64, "height": 64, "pixel_format": "rgb", "rfilter": {"type": "box"}},
    }


def wall_entries(left: list[float], right: list[float]) -> SceneEntry:
    """Return the five walls, of which the side walls have colours `left` and `right`, linear RGB."""
    white = [_WHITE] * 3
    return {
        "floor": rectangle_entry((0, -1, 0), (1, 0, 0), (0, 0, -1), diffuse_bsdf(white)),
        "ceiling": rectangle_entry((0, 1, 0), (1, 0, 0), (0, 0, 1), diffuse_bsdf(white)),
        "back": rectangle_entry((0, 0, -1), (1, 0, 0), (0, 1, 0), diffuse_bsdf(white)),
        "left": rectangle_entry((-1, 0, 0), (0, 0, -1), (0, 1, 0), diffuse_bsdf(left)),
        "right": rectangle_entry((1, 0, 0), (0, 0, 1), (0, 1, 0), diffuse_bsdf(right)),
    }


def _mirror(rng: Rng) -> SceneEntry:
    """Draw a mirror on a side wall."""
    side = pick(rng, (-1, 1))
    half_width, half_height = between(rng, 0.3, 0.6), between(rng, 0.3, 0.6)
    reach_y, reach_z = 0.95 - half_height, 0.95 - half_width
    centre = (side * 0.99, between(rng, -reach_y, reach_y), between(rng, -reach_z, reach_z))
    glass = {"type": "conductor", "material": "none", "specular_reflectance": rgb_entry([0.95] * 3)}
    return rectangle_entry(centre, (0, 0, side * half_width), (0, half_height, 0), glass)


def _light(rng: Rng) -> SceneEntry:
    """Draw an area light on the ceiling."""
    half_width, half_depth = between(rng, 0.15, 0.35), between(rng, 0.15, 0.35)
    reach_x, reach_z = 0.9 - half_width, 0.9 - half_depth
    centre = (between(rng, -reach_x, reach_x), 0.99, between(rng, -reach_z, reach_z))
    warmth = between(rng, 0.0, 0.35)
    radiance = _POWER / (4 * half_width * half_depth) * np.array([1 + warmth, 1.0, 1 - warmth])
    lamp = rectangle_entry(centre, (half_width, 0, 0), (0, 0, half_depth), diffuse_bsdf([0.0] * 3))
    return {**lamp, "emitter": {"type": "area", "radiance": rgb_entry(radiance.tolist())}}


def draw_sphere_places(rng: Rng, count: int) -> list[SpherePlace]:
    """Draw places inside the box that do not overlap; most stand on the floor, some hover."""
    places: list[SpherePlace] = []
    while len(places) < count:
        radius = between(rng, *_RADII)
        reach = 0.97 - radius
        height = radius - 1 if chance(rng, 0.7) else between(rng, radius - 1 + _GAP, 0.5 - radius)
        place = SpherePlace((between(rng, -reach, reach), height, between(rng, -reach, reach)), radius)
        if all(math.dist(place.centre, other.centre) > place.radius + other.radius + _GAP for other in places):
            places.append(place)
    return places


def draw_bsdf(rng: Rng) -> SceneEntry:
    """Draw the material of a sphere: one of SPHERE_MATERIALS."""
    kind = pick(rng, SPHERE_MATERIALS)
    if kind == "diffuse":
        hue, saturation, value = between(rng, 0, 1), between(rng, 0.1, 0.8), between(rng, 0.3, 0.85)
        return diffuse_bsdf(list(colorsys.hsv_to_rgb(hue, saturation, value)))
    if kind == "glass":
        return {"type": "dielectric", "int_ior": between(rng, 1.35, 1.7), "ext_ior": 1.0}
    return {
        "type": "roughconductor",
        "material": pick(rng, MITSUBA_METALS),
        "distribution": "ggx",
        "alpha": log_between(rng, 0.03, 0.3),
    }


def draw_wall_colour(rng: Rng) -> list[float]:
    """Draw the linear RGB colour of a side wall."""
    return list(colorsys.hsv_to_rgb(between(rng, 0, 1), between(rng, 0.6, 0.9), between(rng, 0.55, 0.8)))


def sphere_entry(ball: SpherePlace, bsdf: SceneEntry) -> SceneEntry:
    """Return a sphere of a material at a place."""
    (x, y, z), r = ball.centre, ball.radius
    # The poles are above and below: the azimuth, by which Mitsuba counts directions, then turns evenly about the
    # vertical.
    matrix = [[r, 0.0, 0.0, x], [0.0, 0.0, r, y], [0.0, -r, 0.0, z], [0.0, 0.0, 0.0, 1.0]]
    return {"type": "sphere", "to_world": matrix, "bsdf": bsdf}


def rectangle_entry(centre: Any, right: Any, up: Any, bsdf: SceneEntry) -> SceneEntry:
    """Return a rectangle, given its centre and the vectors from there to its sides.

    It faces where right x up points.
    """
    right, up = np.array(right, float), np.array(up, float)
    normal = np.cross(right, up)
    columns = [right, up, normal / np.linalg.norm(normal), np.array(centre, float)]
    matrix = [*np.stack(columns, axis=1).tolist(), [0.0, 0.0, 0.0, 1.0]]
    return {"type": "rectangle", "to_world": matrix, "bsdf": bsdf}


def diffuse_bsdf(reflectance: list[float]) -> SceneEntry:
    """Return a diffuse material of a linear RGB reflectance."""
    return {"type": "diffuse", "reflectance": rgb_entry(reflectance)}


def rgb_entry(value: list[float]) -> SceneEntry:
    """Return a linear RGB colour in the form that scene dictionaries have."""
    return {"type": "rgb", "value": value}


def to_xml(scene: SceneEntry) -> str:
    """Return a scene dictionary as the text of an XML file of Mitsuba 3."""
    root = Element("scene", version="3.0.0")
    for name, part in scene.items():
        if name != "type":
            tag = name if name == "sensor" else "shape"
            _add(root, tag, {"id": name} if tag == "shape" else {}, part)
    indent(root, "    ")
    return tostring(root, encoding="unicode") + "\n"


def _add(parent: Element, tag: str, attributes: dict[str, str], part: SceneEntry) -> None:
    """Add an object of a scene, with its parameters and its own objects, below an XML element."""
    element = SubElement(parent, tag, {"type": part["type"], **attributes})
    for name, value in part.items():
        if name == "to_world":
            numbers = " ".join(f"{number:.9g}" for row in value for number in row)
            SubElement(SubElement(element, "transform", name=name), "matrix", value=numbers)
        elif isinstance(value, dict) and value["type"] == "rgb":
            SubElement(element, "rgb", name=name, value=", ".join(f"{number:.9g}" for number in value["value"]))
        elif isinstance(value, dict):
            _add(element, name, {}, value)  # film, rfilter, bsdf and emitter have these names in XML, too
        elif name != "type":
            kind = {str: "string", int: "integer", float: "float"}[type(value)]
            SubElement(element, kind, name=name, value=str(value))
