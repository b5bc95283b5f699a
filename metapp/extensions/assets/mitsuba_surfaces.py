"""The Mitsuba 3 export: scenes that show a fitted material, beside the pictures that they need.

`<name>.xml` has the BSDF `neural_svbrdf`, which shades as the fit does; it needs `import metapp.mitsuba` before
`mitsuba.load_file`. `<name>_builtin.xml` needs nothing but Mitsuba: its BSDF `principled` is the nearest material of
the metallic-roughness workflow, since the parameter `specular` of that BSDF is one number, not a map.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

from metapp.appearance.assets import Surface
from metapp.appearance.flash import camera_distance
from metapp.extensions.assets.planes import all_surface_maps
from metapp.extensions.assets.surface_pictures import fill_in_name, write_surface_maps
from metapp.storage.xml_files import write_xml

MITSUBA_MAPS = ("diffuse", "specular", "roughness", "normal_gl", "basecolor", "metallic")
SURFACE_PLUGINS = {  # by the suffix of the scene file: the BSDF, and which map each of its textures shows
    "": ("neural_svbrdf", {"diffuse": "diffuse", "specular": "specular", "roughness": "roughness"}),
    "_builtin": ("principled", {"base_color": "basecolor", "metallic": "metallic", "roughness": "roughness"}),
}
COLOUR_MAPS = ("diffuse", "specular", "basecolor")
PRINCIPLED_INDEX_XML = '<float name="specular" value="0.5"/>'  # of `principled`: an index of refraction of 1.5
# The format "variant" keeps single precision; by default Mitsuba stores half floats, three decimal digits of 16 bits.
TEXTURE_TEMPLATE = """<texture type="bitmap" name="{key}">
  <string name="filename" value="NAME_{map}.png"/>
  <string name="format" value="variant"/>
  <string name="wrap_mode" value="{wrap}"/>
  {raw}
</texture>"""
# The fitted model has no shadowing function and flips no normals. Row 0 of a bitmap lies at v = 0, which is the upper
# edge of meshes but the lower one of rectangles. The film has a pixel for each texel.
SURFACE_SCENE_TEMPLATE = """<scene version="3.0.0">
  <integrator type="path"/>
  <bsdf type="normalmap" id="NAME">
    <boolean name="use_shadowing_function" value="false"/>
    <boolean name="flip_invalid_normals" value="false"/>
    {normals}
    <bsdf type="{plugin}">{textures}</bsdf>
  </bsdf>
  <shape type="rectangle">
    <boolean name="flip_normals" value="true"/>
    <transform name="to_world"><scale x="{x!r}" y="{y!r}"/><rotate x="1" angle="180"/></transform>
    <ref id="NAME"/>
  </shape>
  <sensor type="perspective">
    <float name="fov" value="45"/>
    <string name="fov_axis" value="smaller"/>
    <transform name="to_world"><lookat origin="0, 0, {far!r}" target="0, 0, 0" up="0, 1, 0"/></transform>
    <film type="hdrfilm">
      <rfilter type="box"/>
      <integer name="height" value="{height}"/>
      <integer name="width" value="{width}"/>
    </film>
    <sampler type="independent"><integer name="sample_count" value="64"/></sampler>
  </sensor>
  <emitter type="point">
    <point name="position" x="-0.8" y="0" z="{lamp!r}"/>
    <rgb name="intensity" value="{intensity!r}"/>
  </emitter>
</scene>"""


def write_mitsuba(surface: Surface, path: Path, provenance: Mapping[str, object]) -> None:
    """Write <path>/<name>.xml, <path>/<name>_builtin.xml and their pictures; `name` is the last part of `path`."""
    surface_maps = all_surface_maps(surface)
    write_surface_maps({key: surface_maps[key] for key in MITSUBA_MAPS}, path)
    for suffix, (plugin, textures) in SURFACE_PLUGINS.items():
        scene = surface_scene(plugin, textures, path.name, surface)
        write_xml(path / f"{path.name}{suffix}.xml", scene)


def surface_scene(plugin: str, textures: Mapping[str, str], name: str, surface: Surface) -> ET.Element:
    """Return a scene with the material on a rectangle, seen from straight above, under a lamp to the left.

    Args:
        plugin: the name of the BSDF in Mitsuba.
        textures: for each texture of the BSDF, the name of the map that it shows.
        name: the name of the asset, with which file names begin.
        surface: the fitted material, whose size and tiling the scene has.
    """
    (height, width), shorter, camera_height = surface.size, min(surface.size), camera_distance()

    def texture_xml(key: str, map_name: str) -> str:
        raw_flag = "" if map_name in COLOUR_MAPS else '<boolean name="raw" value="true"/>'
        wrap_mode = "repeat" if surface.tiles else "clamp"
        return TEXTURE_TEMPLATE.format(key=key, map=map_name, wrap=wrap_mode, raw=raw_flag)

    text = SURFACE_SCENE_TEMPLATE.format(
        plugin=plugin,
        normals=texture_xml("normalmap", "normal_gl"),
        textures="".join(texture_xml(*pair) for pair in textures.items())
        + (PRINCIPLED_INDEX_XML if plugin == "principled" else ""),
        x=width / shorter,
        y=height / shorter,
        far=camera_height,
        height=height,
        width=width,
        lamp=camera_height - 0.8,
        intensity=3.1416 * camera_height * camera_height,
    )
    return fill_in_name(ET.fromstring(text), name)
