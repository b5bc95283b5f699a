"""MaterialX: an OpenPBR Surface, <name>.mtlx, beside its pictures, PNG of 16 bits.

F0 is exact. OpenPBR reflects specular_weight ((ior - 1) / (ior + 1))^2 at normal incidence, times specular_color: the
weight carries the greatest channel of F0, the colour the ratio of the others to it, and the index is that of the
greatest F0 of the map. At grazing angles the colour tints the reflection still, where Schlick's Fresnel is white.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

from metapp.appearance.surface import Surface
from metapp.extensions.assets.pictures import fitted_by, write_planes
from metapp.extensions.assets.planes import fitted_planes
from metapp.storage.files import write_xml

VERSION = "1.39"
TYPES = {"diffuse": "color3", "specular": "color3", "roughness": "float", "normal_gl": "vector3"}
HIGHEST = 0.9999  # F0; beyond, no index of refraction


def write_materialx(surface: Surface, path: Path, provenance: Mapping[str, object]) -> None:
    """Write <path>/<name>.mtlx and its pictures."""
    planes = {key: plane for key, plane in fitted_planes(surface).items() if key in TYPES}
    write_planes(planes, path)
    highest = float(planes["specular"].values.max())
    write_xml(path / f"{path.name}.mtlx", document(path.name, highest, surface.tiles, provenance))


def index_of(f0: float) -> float:
    """The index of refraction whose reflectance at normal incidence is f0."""
    root = math.sqrt(min(max(f0, 1e-4), HIGHEST))
    return (1 + root) / (1 - root)


def document(name: str, highest: float, tiles: bool, provenance: Mapping[str, object]) -> ET.Element:
    """The document: a node graph of pictures and their arithmetic, a surface, a material.

    Args:
        name: of the asset; file names begin with it.
        highest: the greatest F0 of the map.
        tiles: True where pictures go on at their edges.
        provenance: told in a comment.
    """
    root = ET.Element("materialx", version=VERSION, colorspace="lin_rec709")
    root.append(ET.Comment(f" fitted by metapp: {fitted_by(provenance).replace('--', '- -')} "))
    graph = ET.SubElement(root, "nodegraph", name="maps")
    index = index_of(highest)
    reflectance = ((index - 1) / (index + 1)) ** 2
    _graph(graph, name, reflectance, tiles)
    surface = ET.SubElement(root, "open_pbr_surface", name="surface", type="surfaceshader")
    inputs = {
        "base_color": ("color3", "diffuse"),
        "specular_weight": ("float", "weight"),
        "specular_color": ("color3", "tint"),
        "specular_roughness": ("float", "roughness"),
        "geometry_normal": ("vector3", "normal"),
    }
    for key, (kind, output) in inputs.items():
        ET.SubElement(surface, "input", name=key, type=kind, nodegraph="maps", output=f"{output}_out")
    ET.SubElement(surface, "input", name="specular_ior", type="float", value=repr(index))
    material = ET.SubElement(root, "surfacematerial", name="material", type="material")
    ET.SubElement(material, "input", name="surfaceshader", type="surfaceshader", nodename="surface")
    return root


def _graph(graph: ET.Element, name: str, reflectance: float, tiles: bool) -> None:
    """Pictures and what the surface's inputs are made of them."""
    for key, kind in TYPES.items():
        image = ET.SubElement(graph, "image", name=key, type=kind)
        space = {"colorspace": "srgb_texture"} if kind == "color3" else {}
        ET.SubElement(image, "input", {"name": "file", "type": "filename", "value": f"{name}_{key}.png", **space})
        for axis in "uv":
            mode = "periodic" if tiles else "clamp"
            ET.SubElement(image, "input", name=f"{axis}addressmode", type="string", value=mode)
    _node(graph, "normalmap", "normal", "vector3", {"in": "normal_gl"})
    for i, channel in enumerate(("red", "green", "blue")):
        extracted = _node(graph, "extract", channel, "float", {"in": "specular"}, of={"in": "color3"})
        ET.SubElement(extracted, "input", name="index", type="integer", value=str(i))
    _node(graph, "max", "larger", "float", {"in1": "red", "in2": "green"})
    _node(graph, "max", "largest", "float", {"in1": "larger", "in2": "blue"})
    weight = _node(graph, "divide", "weight", "float", {"in1": "largest"})
    ET.SubElement(weight, "input", name="in2", type="float", value=repr(reflectance))
    divisor = _node(graph, "max", "divisor", "float", {"in1": "largest"})
    ET.SubElement(divisor, "input", name="in2", type="float", value="1e-05")
    _node(graph, "divide", "tint", "color3", {"in1": "specular", "in2": "divisor"}, of={"in2": "float"})
    for output in ("diffuse", "weight", "tint", "roughness", "normal"):
        kind = {"diffuse": "color3", "tint": "color3", "normal": "vector3"}.get(output, "float")
        ET.SubElement(graph, "output", name=f"{output}_out", type=kind, nodename=output)


def _node(
    graph: ET.Element,
    category: str,
    name: str,
    kind: str,
    inputs: Mapping[str, str],
    of: Mapping[str, str] | None = None,
) -> ET.Element:
    """A node whose inputs are other nodes of the graph; `of` has the types that are not the node's own."""
    node = ET.SubElement(graph, category, name=name, type=kind)
    for key, source in inputs.items():
        ET.SubElement(node, "input", name=key, type=(of or {}).get(key, kind), nodename=source)
    return node
