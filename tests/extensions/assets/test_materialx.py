"""MaterialX: a valid document, whose shaders can be made and whose OpenPBR has the F0 that was fitted."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
import torch

from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from metapp.extensions.assets import materialx
from tests.surfaces import PROVENANCE, rock, stored


@pytest.fixture
def file(tmp_path: Path) -> Path:
    materialx.write_materialx(rock(), tmp_path / "rock", PROVENANCE)
    return tmp_path / "rock" / "rock.mtlx"


def evaluated(graph: ET.Element, name: str, images: dict[str, torch.Tensor]) -> torch.Tensor:
    """A node's value [C, H, W]: of pictures, and of the arithmetic that the graph has."""
    node = next(each for each in graph if each.get("name") == name and each.tag != "output")
    if node.tag == "image":
        return images[name]
    inputs = {
        each.get("name"): evaluated(graph, each.get("nodename"), images)
        if each.get("nodename")
        else torch.tensor(float(each.get("value")))
        for each in node
    }
    if node.tag == "extract":
        return inputs["in"][int(inputs["index"])][None]
    return {"max": torch.maximum, "divide": torch.divide}[node.tag](inputs["in1"], inputs["in2"])


def test_f0_is_what_openpbr_reflects_from_straight_above(file: Path) -> None:
    root = ET.parse(file).getroot()
    graph, surface = root.find("nodegraph"), root.find("open_pbr_surface")
    images = {"specular": srgb_to_linear(stored(file.with_name("rock_specular.png")))}
    weight, tint = (evaluated(graph, name, images) for name in ("weight", "tint"))
    index = float(next(each for each in surface if each.get("name") == "specular_ior").get("value"))
    f0 = (weight * ((index - 1) / (index + 1)) ** 2) * tint
    assert (linear_to_srgb(f0) - linear_to_srgb(rock().maps.specular)).abs().max() < 1e-4
    assert weight.max() <= 1 + 1e-4
    assert tint.max() <= 1 + 1e-6
    inputs = [each for each in root.iter("input") if each.get("type") == "filename"]
    assert {each.get("value") for each in inputs} == {path.name for path in file.parent.glob("*.png")}
    spaces = {each.get("value"): each.get("colorspace") for each in inputs}
    colours = {name for name, space in spaces.items() if space == "srgb_texture"}
    assert colours == {"rock_diffuse.png", "rock_specular.png"}


def test_a_material_without_reflection_has_an_index(tmp_path: Path) -> None:
    black = rock().maps._replace(specular=torch.zeros(1, 32, 32))
    materialx.write_materialx(rock()._replace(maps=black), tmp_path / "rock", PROVENANCE)
    surface = ET.parse(tmp_path / "rock" / "rock.mtlx").getroot().find("open_pbr_surface")
    assert 1 < float(next(each for each in surface if each.get("name") == "specular_ior").get("value")) < 1.1


@pytest.mark.parametrize("target", ["Glsl", "Osl"])
def test_materialx_accepts_it_and_makes_shaders(file: Path, target: str) -> None:
    mx = pytest.importorskip("MaterialX", reason="MaterialX is not installed: pip install MaterialX")
    from MaterialX import PyMaterialXGenGlsl, PyMaterialXGenOsl, PyMaterialXGenShader

    library, search = mx.createDocument(), mx.getDefaultDataSearchPath()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), search, library)
    document = mx.createDocument()
    mx.readFromXmlFile(document, str(file))
    document.setDataLibrary(library)
    assert document.validate() == (True, "")
    generators = {"Glsl": PyMaterialXGenGlsl.GlslShaderGenerator, "Osl": PyMaterialXGenOsl.OslShaderGenerator}
    generator = generators[target].create()
    context = PyMaterialXGenShader.GenContext(generator)
    context.registerSourceCodeSearchPath(search)
    generator.registerTypeDefs(document)
    colours = PyMaterialXGenShader.DefaultColorManagementSystem.create(generator.getTarget())
    colours.loadLibrary(document)
    generator.setColorManagementSystem(colours)
    (element,) = PyMaterialXGenShader.findRenderableElements(document)
    shader = generator.generate("rock", element, context)
    assert "specular" in shader.getSourceCode(PyMaterialXGenShader.PIXEL_STAGE)
