"""The exports of fitted BRDFs as shader code: <name>.<suffix>, and a node of MaterialX.

Each is a function of the reflectance and a path, as `metapp export` calls it.
"""

from __future__ import annotations

import functools
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from metapp.appearance.lobes import fit_lobes
from metapp.apps.brdf.brdf_network import find_network
from metapp.extensions.shaders.hlsl_source import hlsl_source
from metapp.extensions.shaders.languages import LANGUAGES, translate_source
from metapp.learning.task import Params
from metapp.storage.files import write_bytes
from metapp.storage.xml_files import write_xml

if TYPE_CHECKING:
    from metapp.apps.brdf.reflectance import Reflectance

MATERIALX_VERSION = "1.39"  # that documents state
NODE_FUNCTIONS = {  # by language, the function that MaterialX calls for a node
    "glsl": "\nvoid NAME(vec3 wi, vec3 wo, out vec3 result) {\n    result = NAME_eval(wi, wo);\n}\n",
    "osl": "\nvoid NAME(vector wi, vector wo, output color result) {\n"
    "    vector value = NAME_eval(wi, wo);\n    result = color(value[0], value[1], value[2]);\n}\n",
}


def function_prefix(name: str) -> str:
    """Return what names of a material's functions begin with: brdf_ and the letters and digits of its name."""
    return "_".join(["brdf", *re.findall("[A-Za-z0-9]+", name)])


def hlsl_code(theta: Params, name: str) -> str:
    """Write the code of a fitted NBRDF in HLSL.

    Args:
        theta: the parameters of the fit, without a task axis.
        name: the name of the material.
    """
    network = find_network(theta)
    lobes = fit_lobes(functools.partial(network.evaluate, theta))
    return hlsl_source(function_prefix(name), network.fold(theta), lobes)


def write_shader(language: str, asset: Reflectance, path: Path, provenance: Mapping[str, object]) -> None:
    """Write a fitted NBRDF as shader code.

    Args:
        language: the language, a key of LANGUAGES.
        asset: the reflectance, with the parameters of an NBRDF.
        path: the file, to which the suffix of the language is added.
        provenance: not written.
    """
    syntax = LANGUAGES[language]
    name = path.name.removesuffix(f".{syntax.suffix}")
    comment = f"// {name}: a BRDF fitted by metapp, as an NBRDF network (Sztrajman et al. 2021)\n"
    text = comment + translate_source(hlsl_code(asset.theta, name), function_prefix(name), syntax)
    _write_text(path.with_name(f"{name}.{syntax.suffix}"), text)


write_cpp = functools.partial(write_shader, "cpp")
write_glsl = functools.partial(write_shader, "glsl")
write_hlsl = functools.partial(write_shader, "hlsl")
write_osl = functools.partial(write_shader, "osl")
write_wgsl = functools.partial(write_shader, "wgsl")


def write_materialx(asset: Reflectance, path: Path, provenance: Mapping[str, object]) -> None:
    """Write a fitted NBRDF as a node of MaterialX, <path>/<name>.mtlx, with implementations for GLSL and OSL beside it.

    Args:
        asset: the reflectance, with the parameters of an NBRDF.
        path: the folder, whose name the files get.
        provenance: not written.
    """
    name = function_prefix(path.name)
    source = hlsl_code(asset.theta, path.name)
    for language, function in NODE_FUNCTIONS.items():
        text = translate_source(source, name, LANGUAGES[language]._replace(tail=function))
        _write_text(path / f"{path.name}.{language}", text)
    write_xml(path / f"{path.name}.mtlx", node_document(path.name))


def node_document(name: str) -> ET.Element:
    """Return the MaterialX document of a node, which has the inputs wi and wo, vectors whose z is along the normal.

    The output is the reflectance in 1/sr, linear RGB.
    """
    root, prefix = ET.Element("materialx", version=MATERIALX_VERSION), function_prefix(name)
    definition = ET.SubElement(root, "nodedef", name=f"ND_{prefix}", node=prefix, nodegroup="pbr")
    for direction in ("wi", "wo"):
        ET.SubElement(definition, "input", name=direction, type="vector3", value="0, 0, 1")
    ET.SubElement(definition, "output", name="out", type="color3", default="0, 0, 0")
    for language in NODE_FUNCTIONS:
        target = f"gen{language}"
        attributes = {"name": f"IM_{prefix}_{target}", "nodedef": f"ND_{prefix}", "target": target}
        ET.SubElement(root, "implementation", attributes | {"file": f"{name}.{language}", "function": prefix})
    return root


def _write_text(path: Path, text: str) -> None:
    write_bytes(path, text.encode())
