"""Files of shader code: <name>.<suffix>."""

from __future__ import annotations

import functools
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import TYPE_CHECKING

from metapp.appearance.lobes import fit_lobes
from metapp.apps.brdf.network import network_of
from metapp.extensions.shaders.languages import LANGUAGES, translated
from metapp.extensions.shaders.source import source_of
from metapp.learning.task import Params
from metapp.storage.files import write_bytes
from metapp.storage.xml_files import write_xml

if TYPE_CHECKING:
    from metapp.apps.brdf.app import Brdf

VERSION = "1.39"  # of MaterialX
NODE = {  # the function of a node of MaterialX
    "glsl": "\nvoid NAME(vec3 wi, vec3 wo, out vec3 result) {\n    result = NAME_eval(wi, wo);\n}\n",
    "osl": "\nvoid NAME(vector wi, vector wo, output color result) {\n"
    "    vector value = NAME_eval(wi, wo);\n    result = color(value[0], value[1], value[2]);\n}\n",
}


def identifier(name: str) -> str:
    """The name of the functions of a material: brdf_ and the letters and digits of its name."""
    return "_".join(["brdf", *re.findall("[A-Za-z0-9]+", name)])


def code_of(theta: Params, name: str) -> str:
    """The neutral source of an NBRDF network, parameters without a task axis."""
    network = network_of(theta)
    lobes = fit_lobes(functools.partial(network.evaluate, theta))
    return source_of(identifier(name), network.folded(theta), lobes)


def write(language: str, app: Brdf, theta: Params, path: Path) -> None:
    """Write a fit in one of LANGUAGES."""
    of = LANGUAGES[language]
    name = path.name.removesuffix(f".{of.suffix}")
    about = f"// {name}: a BRDF fitted by metapp, as an NBRDF network (Sztrajman et al. 2021)\n"
    text = about + translated(code_of(theta, name), identifier(name), of)
    _write(path.with_name(f"{name}.{of.suffix}"), text)


write_cpp = functools.partial(write, "cpp")
write_glsl = functools.partial(write, "glsl")
write_hlsl = functools.partial(write, "hlsl")
write_osl = functools.partial(write, "osl")
write_wgsl = functools.partial(write, "wgsl")


def write_materialx(app: Brdf, theta: Params, path: Path) -> None:
    """Write <path>/<name>.mtlx, a node of wi and wo, and its implementations for GLSL and OSL beside it."""
    name = identifier(path.name)
    source = code_of(theta, path.name)
    for language, function in NODE.items():
        text = translated(source, name, LANGUAGES[language]._replace(tail=function))
        _write(path / f"{path.name}.{language}", text)
    write_xml(path / f"{path.name}.mtlx", node(path.name))


def node(name: str) -> ET.Element:
    """The document of a node: reflectance in 1/sr, linear RGB, of two vectors whose z is along the normal."""
    root, short = ET.Element("materialx", version=VERSION), identifier(name)
    definition = ET.SubElement(root, "nodedef", name=f"ND_{short}", node=short, nodegroup="pbr")
    for direction in ("wi", "wo"):
        ET.SubElement(definition, "input", name=direction, type="vector3", value="0, 0, 1")
    ET.SubElement(definition, "output", name="out", type="color3", default="0, 0, 0")
    for language in NODE:
        target = f"gen{language}"
        attributes = {"name": f"IM_{short}_{target}", "nodedef": f"ND_{short}", "target": target}
        ET.SubElement(root, "implementation", attributes | {"file": f"{name}.{language}", "function": short})
    return root


def _write(path: Path, text: str) -> None:
    write_bytes(path, text.encode())
