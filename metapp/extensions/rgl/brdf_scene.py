"""Scenes of Mitsuba 3 that show a fitted BRDF, and the files that they need.

`<name>.xml` has the BSDF `neural_brdf`, which evaluates the fit; it needs `import metapp.mitsuba` before
`mitsuba.load_file`. `<name>_builtin.xml` has Mitsuba's own `measured` on a table of the BRDF, and needs nothing else.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from safetensors.torch import save

from metapp.extensions.rgl.rgl import export as write_table
from metapp.storage.files import write_bytes
from metapp.storage.xml_files import write_xml

if TYPE_CHECKING:
    from metapp.apps.brdf.reflectance import Reflectance

SCENE_AND_BRDF_ENDINGS = {  # by the BSDF: what the name of the scene ends with before .xml, and the ending of its data
    "neural_brdf": ("", ".safetensors"),
    "measured": ("_builtin", ".bsdf"),
}
BRDF_SCENE_TEMPLATE = """<scene version="3.0.0"><integrator type="path"/>
<bsdf type="" id=""><string name="filename" value=""/></bsdf>
<shape type="sphere"><ref id=""/></shape>
<sensor type="perspective"><float name="fov" value="30"/>
<transform name="to_world"><lookat origin="0, 0, 5" target="0, 0, 0" up="0, 1, 0"/></transform>
<film type="hdrfilm"><integer name="width" value="256"/><integer name="height" value="256"/></film>
<sampler type="independent"><integer name="sample_count" value="64"/></sampler></sensor>
<shape type="sphere"><point name="center" x="-4" y="5" z="5"/><float name="radius" value="1"/>
<emitter type="area"><rgb name="radiance" value="40, 40, 40"/></emitter></shape>
<emitter type="constant"><rgb name="radiance" value="0.3, 0.3, 0.3"/></emitter></scene>"""


def write_brdf_scenes(asset: Reflectance, path: Path, provenance: Mapping[str, object]) -> None:
    """Write two scenes that show reflectance, and the parameters and the table that they read, into a folder.

    Reflectance without a network has the scene of the table alone.

    Args:
        asset: the reflectance.
        path: the folder, whose name the files <name>.xml, <name>_builtin.xml, <name>.safetensors and <name>.bsdf get.
        provenance: not written.
    """
    write_table(asset, path / f"{path.name}.bsdf", provenance)
    if asset.theta:
        tensors = {key: value.detach().cpu().contiguous() for key, value in asset.theta.items()}
        write_bytes(path / f"{path.name}.safetensors", save(tensors))
    for bsdf, (scene_ending, data_ending) in SCENE_AND_BRDF_ENDINGS.items():
        if not (path / f"{path.name}{data_ending}").is_file():
            continue
        write_xml(path / f"{path.name}{scene_ending}.xml", brdf_scene(bsdf, path.name, f"{path.name}{data_ending}"))


def brdf_scene(plugin: str, name: str, file: str) -> ET.Element:
    """Return the scene of a sphere with a material, a lamp above it to the left and a dim sky.

    Args:
        plugin: the type of the BSDF.
        name: the name of the material.
        file: the file that the BSDF reads, relative to the scene.
    """
    root = ET.fromstring(BRDF_SCENE_TEMPLATE)
    attributes_by_path = {
        "bsdf": {"type": plugin, "id": name},
        "bsdf/string": {"value": file},
        "shape/ref": {"id": name},
    }
    for path, attributes in attributes_by_path.items():
        next(root.iterfind(path)).attrib.update(attributes)
    return root
