"""Mitsuba 3: scenes that show a fitted material, beside the pictures that they need.

`<name>.xml` has the BSDF `neural_svbrdf`, which shades as what was fitted; it needs `import metapp.mitsuba` before
`mitsuba.load_file`. `<name>_builtin.xml` needs nothing but Mitsuba: `principled`, the nearest material of the
metallic-roughness workflow, as its `specular` is one number.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

from metapp.appearance.flash import camera_distance
from metapp.appearance.surface import Surface
from metapp.extensions.assets.pictures import write_planes
from metapp.extensions.assets.planes import all_planes
from metapp.storage.files import write_xml

VERSION = "3.0.0"
FOV_DEGREES = 45
PLUGINS = {  # its textures by name, and other properties
    "neural_svbrdf": ({"diffuse": "diffuse", "specular": "specular", "roughness": "roughness"}, {}),
    # 0.5 is an index of 1.5
    "principled": (
        {"base_color": "basecolor", "metallic": "metallic", "roughness": "roughness"},
        {"specular": "0.5"},
    ),
}
SUFFIX = {"neural_svbrdf": "", "principled": "_builtin"}
USED = ("diffuse", "specular", "roughness", "normal_gl", "basecolor", "metallic")


def write_mitsuba(surface: Surface, path: Path, provenance: Mapping[str, object]) -> None:
    """Write <path>/<name>.xml, <path>/<name>_builtin.xml and the pictures."""
    planes = all_planes(surface)
    write_planes({key: planes[key] for key in USED}, path)
    for plugin, suffix in SUFFIX.items():
        write_xml(path / f"{path.name}{suffix}.xml", surface_scene(plugin, path.name, surface))


def surface_scene(plugin: str, name: str, surface: Surface) -> ET.Element:
    """The material on a rectangle, seen from straight above, under a lamp to the left."""
    root = ET.Element("scene", version=VERSION)
    ET.SubElement(root, "integrator", type="path")
    _add_material(root, plugin, name, surface.tiles)
    height, width = surface.size
    shape = ET.SubElement(root, "shape", type="rectangle")
    # row 0 of a bitmap lies at v = 0, which is where meshes, but not rectangles, have their upper edge
    ET.SubElement(shape, "boolean", name="flip_normals", value="true")
    placed = ET.SubElement(shape, "transform", name="to_world")
    shorter = min(surface.size)
    ET.SubElement(placed, "scale", x=repr(width / shorter), y=repr(height / shorter))
    ET.SubElement(placed, "rotate", x="1", angle="180")
    ET.SubElement(shape, "ref", id=name)
    _add_camera(root, surface)
    lamp = ET.SubElement(root, "emitter", type="point")
    far = camera_distance()
    ET.SubElement(lamp, "point", name="position", x="-0.8", y="0", z=repr(far - 0.8))
    ET.SubElement(lamp, "rgb", name="intensity", value=repr(3.1416 * far * far))
    return root


def _add_material(root: ET.Element, plugin: str, name: str, tiles: bool) -> None:
    bump = ET.SubElement(root, "bsdf", type="normalmap", id=name)
    for key in ("use_shadowing_function", "flip_invalid_normals"):  # what was fitted has neither
        ET.SubElement(bump, "boolean", name=key, value="false")
    _add_texture(bump, "normalmap", f"{name}_normal_gl.png", raw=True, tiles=tiles)
    bsdf = ET.SubElement(bump, "bsdf", type=plugin)
    textures, numbers = PLUGINS[plugin]
    for key, source in textures.items():
        _add_texture(bsdf, key, f"{name}_{source}.png", raw=source in ("roughness", "metallic"), tiles=tiles)
    for key, value in numbers.items():
        ET.SubElement(bsdf, "float", name=key, value=value)


def _add_texture(parent: ET.Element, key: str, file: str, *, raw: bool, tiles: bool) -> None:
    texture = ET.SubElement(parent, "texture", type="bitmap", name=key)
    ET.SubElement(texture, "string", name="filename", value=file)
    ET.SubElement(texture, "string", name="format", value="variant")  # else halves: three digits of 16 bits
    ET.SubElement(texture, "string", name="wrap_mode", value="repeat" if tiles else "clamp")
    if raw:
        ET.SubElement(texture, "boolean", name="raw", value="true")


def _add_camera(root: ET.Element, surface: Surface) -> None:
    sensor = ET.SubElement(root, "sensor", type="perspective")
    ET.SubElement(sensor, "float", name="fov", value=str(FOV_DEGREES))
    ET.SubElement(sensor, "string", name="fov_axis", value="smaller")
    placed = ET.SubElement(sensor, "transform", name="to_world")
    ET.SubElement(placed, "lookat", origin=f"0, 0, {camera_distance()!r}", target="0, 0, 0", up="0, 1, 0")
    film = ET.SubElement(sensor, "film", type="hdrfilm")
    ET.SubElement(film, "rfilter", type="box")  # a pixel a texel
    for key, value in zip(("height", "width"), surface.size, strict=True):
        ET.SubElement(film, "integer", name=key, value=str(value))
    ET.SubElement(ET.SubElement(sensor, "sampler", type="independent"), "integer", name="sample_count", value="64")
