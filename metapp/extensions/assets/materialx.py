"""The MaterialX export: an OpenPBR Surface in <name>.mtlx, beside its pictures as PNG of 16 bits.

F0 is exact. OpenPBR reflects specular_weight ((ior - 1) / (ior + 1))^2 at normal incidence, times specular_color: the
weight carries the greatest channel of F0, the colour the ratio of the other channels to it, and the index of refraction
gives the greatest F0 of the map. Towards grazing angles the colour still tints the reflection, where Schlick's Fresnel
term is white.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

from metapp.appearance.assets import Surface
from metapp.extensions.assets.planes import fitted_surface_maps
from metapp.extensions.assets.surface_pictures import describe_provenance, fill_in_name, write_surface_maps
from metapp.storage.xml_files import write_xml

MATERIALX_TYPES = {"diffuse": "color3", "specular": "color3", "roughness": "float", "normal_gl": "vector3"}
MAX_F0 = 0.9999  # a surface of F0 1 has no finite index of refraction
IMAGE_TEMPLATE = """<image name="{key}" type="{type}">
  <input name="file" type="filename" value="NAME_{key}.png"{space}/>
  <input name="uaddressmode" type="string" value="{mode}"/>
  <input name="vaddressmode" type="string" value="{mode}"/>
</image>"""
# specular_weight is the greatest channel of F0, divided by the reflectance of the index of refraction; specular_color
# is F0 divided by its greatest channel.
MATERIALX_TEMPLATE = """<materialx version="1.39" colorspace="lin_rec709">
  <nodegraph name="maps">
    {images}
    <normalmap name="normal" type="vector3"><input name="in" type="vector3" nodename="normal_gl"/></normalmap>
    <extract name="red" type="float">
      <input name="in" type="color3" nodename="specular"/><input name="index" type="integer" value="0"/>
    </extract>
    <extract name="green" type="float">
      <input name="in" type="color3" nodename="specular"/><input name="index" type="integer" value="1"/>
    </extract>
    <extract name="blue" type="float">
      <input name="in" type="color3" nodename="specular"/><input name="index" type="integer" value="2"/>
    </extract>
    <max name="larger" type="float">
      <input name="in1" type="float" nodename="red"/><input name="in2" type="float" nodename="green"/>
    </max>
    <max name="largest" type="float">
      <input name="in1" type="float" nodename="larger"/><input name="in2" type="float" nodename="blue"/>
    </max>
    <divide name="weight" type="float">
      <input name="in1" type="float" nodename="largest"/><input name="in2" type="float" value="{reflectance!r}"/>
    </divide>
    <max name="divisor" type="float">
      <input name="in1" type="float" nodename="largest"/><input name="in2" type="float" value="1e-05"/>
    </max>
    <divide name="tint" type="color3">
      <input name="in1" type="color3" nodename="specular"/><input name="in2" type="float" nodename="divisor"/>
    </divide>
    <output name="diffuse_out" type="color3" nodename="diffuse"/>
    <output name="weight_out" type="float" nodename="weight"/>
    <output name="tint_out" type="color3" nodename="tint"/>
    <output name="roughness_out" type="float" nodename="roughness"/>
    <output name="normal_out" type="vector3" nodename="normal"/>
  </nodegraph>
  <open_pbr_surface name="surface" type="surfaceshader">
    <input name="base_color" type="color3" nodegraph="maps" output="diffuse_out"/>
    <input name="specular_weight" type="float" nodegraph="maps" output="weight_out"/>
    <input name="specular_color" type="color3" nodegraph="maps" output="tint_out"/>
    <input name="specular_roughness" type="float" nodegraph="maps" output="roughness_out"/>
    <input name="geometry_normal" type="vector3" nodegraph="maps" output="normal_out"/>
    <input name="specular_ior" type="float" value="{index!r}"/>
  </open_pbr_surface>
  <surfacematerial name="material" type="material">
    <input name="surfaceshader" type="surfaceshader" nodename="surface"/>
  </surfacematerial>
</materialx>"""


def write_openpbr(surface: Surface, path: Path, provenance: Mapping[str, object]) -> None:
    """Write a surface as <path>/<name>.mtlx with its pictures; `name` is the last part of `path`."""
    surface_maps = {
        key: surface_map for key, surface_map in fitted_surface_maps(surface).items() if key in MATERIALX_TYPES
    }
    write_surface_maps(surface_maps, path)
    greatest_f0 = float(surface_maps["specular"].values.max())
    write_xml(path / f"{path.name}.mtlx", openpbr_document(path.name, greatest_f0, surface.tiles, provenance))


def index_of_refraction(f0: float) -> float:
    """Return the index of refraction whose reflectance at normal incidence is `f0`."""
    root = math.sqrt(min(max(f0, 1e-4), MAX_F0))
    return (1 + root) / (1 - root)


def openpbr_document(name: str, highest: float, tiles: bool, provenance: Mapping[str, object]) -> ET.Element:
    """Return the MaterialX document: a node graph of pictures and their arithmetic, a surface, a material.

    Args:
        name: the name of the asset, with which file names begin.
        highest: the greatest F0 of the map.
        tiles: whether the pictures continue periodically at their edges.
        provenance: how the fit was made; stated in a comment.
    """
    refraction_index, address_mode = index_of_refraction(highest), "periodic" if tiles else "clamp"
    colour_spaces = {"color3": ' colorspace="srgb_texture"'}
    images = [
        IMAGE_TEMPLATE.format(key=key, type=kind, mode=address_mode, space=colour_spaces.get(kind, ""))
        for key, kind in MATERIALX_TYPES.items()
    ]
    reflectance = ((refraction_index - 1) / (refraction_index + 1)) ** 2
    root = ET.fromstring(
        MATERIALX_TEMPLATE.format(images="".join(images), index=refraction_index, reflectance=reflectance)
    )
    root.insert(0, ET.Comment(f" fitted by metapp: {describe_provenance(provenance).replace('--', '- -')} "))
    return fill_in_name(root, name)
