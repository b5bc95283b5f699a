"""Mitsuba 3: scenes that show a fitted BRDF, beside the files that they need.

`<name>.xml` has the BSDF `neural_brdf`, which evaluates what was fitted; it needs `import metapp.mitsuba` before
`mitsuba.load_file`. `<name>_builtin.xml` needs nothing but Mitsuba: `measured`, on a table of the BRDF.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import TYPE_CHECKING

from safetensors.torch import save

from metapp.extensions.rgl.rgl import write_fit
from metapp.learning.task import Params
from metapp.storage.files import write_atomically, write_xml

if TYPE_CHECKING:
    from metapp.apps.brdf.app import Brdf

VERSION = "3.0.0"
FILES = {"neural_brdf": ("", ".safetensors"), "measured": ("_builtin", ".bsdf")}  # of the scene, of its file


def export(app: Brdf, theta: Params, path: Path) -> None:
    """Write <path>/<name>.xml, <name>_builtin.xml, <name>.safetensors and <name>.bsdf."""
    tensors = {key: value.detach().cpu().contiguous() for key, value in theta.items()}
    write_atomically(path / f"{path.name}.safetensors", lambda target: target.write_bytes(save(tensors)))
    write_fit(app, theta, path / f"{path.name}.bsdf", path.name)
    for plugin, (suffix, ending) in FILES.items():
        write_xml(path / f"{path.name}{suffix}.xml", brdf_scene(plugin, path.name, f"{path.name}{ending}"))


def brdf_scene(plugin: str, name: str, file: str) -> ET.Element:
    """A sphere with the material, a lamp above it to the left, a dim sky."""
    root = ET.Element("scene", version=VERSION)
    ET.SubElement(root, "integrator", type="path")
    bsdf = ET.SubElement(root, "bsdf", type=plugin, id=name)
    ET.SubElement(bsdf, "string", name="filename", value=file)
    sphere = ET.SubElement(root, "shape", type="sphere")
    ET.SubElement(sphere, "ref", id=name)
    camera = ET.SubElement(root, "sensor", type="perspective")
    ET.SubElement(camera, "float", name="fov", value="30")
    ET.SubElement(
        ET.SubElement(camera, "transform", name="to_world"), "lookat", origin="0, 0, 5", target="0, 0, 0", up="0, 1, 0"
    )
    film = ET.SubElement(camera, "film", type="hdrfilm")
    for side in ("width", "height"):
        ET.SubElement(film, "integer", name=side, value="256")
    ET.SubElement(ET.SubElement(camera, "sampler", type="independent"), "integer", name="sample_count", value="64")
    lamp = ET.SubElement(root, "shape", type="sphere")
    ET.SubElement(lamp, "point", name="center", x="-4", y="5", z="5")
    ET.SubElement(lamp, "float", name="radius", value="1")
    ET.SubElement(ET.SubElement(lamp, "emitter", type="area"), "rgb", name="radiance", value="40, 40, 40")
    sky = ET.SubElement(root, "emitter", type="constant")
    ET.SubElement(sky, "rgb", name="radiance", value="0.3, 0.3, 0.3")
    return root
