"""Files of shader code: <name>.<suffix>."""

from __future__ import annotations

import functools
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import TYPE_CHECKING

from metapp.appearance.lobes import fit_lobes
from metapp.apps.brdf.brdf_network import find_network
from metapp.extensions.shaders.languages import LANGUAGES, translate_source
from metapp.extensions.shaders.neutral_source import brdf_source
from metapp.learning.task import Params
from metapp.storage.files import write_bytes
from metapp.storage.xml_files import write_xml

if TYPE_CHECKING:
    from metapp.apps.brdf.app import Brdf

MATERIALX_VERSION = "1.39"  # of MaterialX
NODE_FUNCTIONS = {  # the function of a node of MaterialX
    "glsl": "\nvoid NAME(vec3 wi, vec3 wo, out vec3 result) {\n    result = NAME_eval(wi, wo);\n}\n",
    "osl": "\nvoid NAME(vector wi, vector wo, output color result) {\n"
    "    vector value = NAME_eval(wi, wo);\n    result = color(value[0], value[1], value[2]);\n}\n",
}


def function_prefix(name: str) -> str:
    """The name of the functions of a material: brdf_ and the letters and digits of its name."""
    return "_".join(["brdf", *re.findall("[A-Za-z0-9]+", name)])


def neutral_code(theta: Params, name: str) -> str:
    """The neutral source of an NBRDF network, parameters without a task axis."""
    network = find_network(theta)
    lobes = fit_lobes(functools.partial(network.evaluate, theta))
    return brdf_source(function_prefix(name), network.fold(theta), lobes)


def write_shader(language: str, app: Brdf, theta: Params, path: Path) -> None:
    """Write a fit in one of LANGUAGES."""
    of = LANGUAGES[language]
    name = path.name.removesuffix(f".{of.suffix}")
    about = f"// {name}: a BRDF fitted by metapp, as an NBRDF network (Sztrajman et al. 2021)\n"
    text = about + translate_source(neutral_code(theta, name), function_prefix(name), of)
    _write(path.with_name(f"{name}.{of.suffix}"), text)


write_cpp = functools.partial(write_shader, "cpp")
write_glsl = functools.partial(write_shader, "glsl")
write_hlsl = functools.partial(write_shader, "hlsl")
write_osl = functools.partial(write_shader, "osl")
write_wgsl = functools.partial(write_shader, "wgsl")


def write_materialx(app: Brdf, theta: Params, path: Path) -> None:
    """Write <path>/<name>.mtlx, a node of wi and wo, and its implementations for GLSL and OSL beside it."""
    name = function_prefix(path.name)
    source = neutral_code(theta, path.name)
    for language, function in NODE_FUNCTIONS.items():
        text = translate_source(source, name, LANGUAGES[language]._replace(tail=function))
        _write(path / f"{path.name}.{language}", text)
    write_xml(path / f"{path.name}.mtlx", node_document(path.name))


def node_document(name: str) -> ET.Element:
    """The document of a node: reflectance in 1/sr, linear RGB, of two vectors whose z is along the normal."""
    root, short = ET.Element("materialx", version=MATERIALX_VERSION), function_prefix(name)
    definition = ET.SubElement(root, "nodedef", name=f"ND_{short}", node=short, nodegroup="pbr")
    for direction in ("wi", "wo"):
        ET.SubElement(definition, "input", name=direction, type="vector3", value="0, 0, 1")
    ET.SubElement(definition, "output", name="out", type="color3", default="0, 0, 0")
    for language in NODE_FUNCTIONS:
        target = f"gen{language}"
        attributes = {"name": f"IM_{short}_{target}", "nodedef": f"ND_{short}", "target": target}
        ET.SubElement(root, "implementation", attributes | {"file": f"{name}.{language}", "function": short})
    return root


def _write(path: Path, text: str) -> None:
    write_bytes(path, text.encode())
