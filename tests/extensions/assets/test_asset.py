"""Assets of maps, glTF and MaterialX: what is written is what was fitted, and can be read again."""

import json
import struct
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import pytest
import torch

from data_tools.readers import svbrdf_inputs
from data_tools.readers.material_maps import find, read_task
from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from metapp.appearance.surface import DIELECTRIC_F0, metallic_to_specular
from metapp.appearance.svbrdf_maps import Maps, unpack_maps
from metapp.extensions.assets import gltf, materialx, surface_pictures
from metapp.extensions.assets.occlusion import occlusion_from_height
from metapp.extensions.assets.planes import all_surface_maps, specular_to_metallic
from metapp.registry import WITHOUT_VARIABLE
from tests.found_paths import find_paths
from tests.surfaces import (
    PROVENANCE,
    read_linear_colours,
    read_stored_values,
    rock_surface,
    rock_texture,
    texel_centres,
    wave_heights_and_normals,
)

STEP = 1 / 65535
MAPS = ("basecolor", "diffuse", "specular", "metallic", "roughness", "normal_gl", "normal_dx", "height", "ao", "orm")


@pytest.fixture
def asset(tmp_path: Path) -> Path:
    surface_pictures.write_asset(rock_surface(), tmp_path / "rock", PROVENANCE)
    return tmp_path / "rock"


def file(asset: Path, name: str) -> Path:
    return asset / f"rock_{name}.png"


def test_all_files_are_there_in_16_bits_and_described(asset: Path) -> None:
    names = {f"rock_{name}.png" for name in MAPS}
    assert {file.name for file in asset.iterdir()} == names | {"preview.png", "material.json"}
    assert str(oiio.ImageBuf(str(asset / "preview.png")).spec().format) == "uint8"
    material = json.loads((asset / "material.json").read_text(encoding="utf-8"))
    assert set(material["files"]) == names
    colours = {"rock_basecolor.png", "rock_diffuse.png", "rock_specular.png"}
    assert {name for name, description in material["files"].items() if description["colour_space"] == "sRGB"} == colours
    for name, description in material["files"].items():
        spec = oiio.ImageBuf(str(asset / name)).spec()
        assert (spec.width, spec.height, str(spec.format)) == (32, 32, "uint16")
        assert spec.get_string_attribute("encoding") == description["colour_space"]
        assert spec.nchannels == description["channels"]
    assert material["tiles"] is True
    assert material["provenance"] == PROVENANCE | {"rise": None}


def test_written_maps_read_back_within_rounding_and_heights_in_texture_widths(asset: Path) -> None:
    maps = rock_surface().maps
    for name in ("specular", "diffuse"):
        assert (read_stored_values(file(asset, name)) - linear_to_srgb(getattr(maps, name))).abs().max() < STEP, name
    assert (read_stored_values(file(asset, "roughness")) - maps.roughness).abs().max() < STEP
    assert (read_stored_values(file(asset, "normal_gl")) * 2 - 1 - maps.normal).abs().max() < 2 * STEP
    description = json.loads((asset / "material.json").read_text(encoding="utf-8"))["files"]["rock_height.png"]
    height = description["offset"] + description["scale"] * read_stored_values(file(asset, "height"))
    expected = rock_surface().height - rock_surface().height.mean()
    assert description["unit"] == "texture widths"
    assert (height * 32 - expected).abs().max() < 5 * 32 * STEP
    assert read_stored_values(file(asset, "height")).max() == 1


def test_derived_maps_describe_the_same_material(asset: Path) -> None:
    gl, dx = read_stored_values(file(asset, "normal_gl")), read_stored_values(file(asset, "normal_dx"))
    assert torch.equal(gl[[0, 2]], dx[[0, 2]])
    assert (gl[1] + dx[1] - 1).abs().max() <= STEP
    single = torch.cat([read_stored_values(file(asset, name)) for name in ("ao", "roughness", "metallic")])
    assert torch.equal(read_stored_values(file(asset, "orm")), single)
    occlusion = occlusion_from_height(rock_surface().height, periodic=True)
    assert (read_stored_values(file(asset, "ao")) - occlusion).abs().max() < 2 * STEP
    base, metallic = read_linear_colours(file(asset, "basecolor")), read_stored_values(file(asset, "metallic"))
    diffuse, specular = metallic_to_specular(base, metallic)
    total = rock_surface().maps.diffuse + rock_surface().maps.specular
    inside = (base < 0.999).all(0)  # where the base colour is not clamped
    assert (diffuse + specular - total).abs()[:, inside].max() < 1e-4
    assert inside.float().mean() > 0.5


def test_our_reader_takes_asset_folders(tmp_path: Path) -> None:
    """The maps that were fitted are read, not those that were made of them, unless there are no others."""
    surface_pictures.write_asset(rock_surface(64), tmp_path / "rock", PROVENANCE)
    (source,) = find_paths(find, tmp_path / "rock")[0]
    assert find_paths(svbrdf_inputs.find, tmp_path / "rock") == ([source], [])  # no preview or height for a photograph
    found, maps = unpack_maps(read_task(source, 64).data["maps"].float()), rock_surface(64).maps
    for name in Maps._fields:
        assert (getattr(found, name) - getattr(maps, name)).abs().max() < 1e-3, name  # kept as halves
    for name in ("diffuse", "specular", "normal_dx"):
        file(tmp_path / "rock", name).unlink()
    found = unpack_maps(read_task(file(tmp_path / "rock", "basecolor"), 64).data["maps"].float())
    assert (found.normal - maps.normal).abs().max() < 2e-3
    assert (found.roughness - maps.roughness).abs().max() < 2e-3


def test_a_texture_has_a_base_colour_alone(tmp_path: Path) -> None:
    surface_pictures.write_asset(rock_texture(), tmp_path / "rock", PROVENANCE)
    found = {file.name for file in (tmp_path / "rock").iterdir()}
    assert found == {"rock_basecolor.png", "preview.png", "material.json"}
    assert json.loads((tmp_path / "rock" / "material.json").read_text())["kind"] == "texture"
    assert (read_linear_colours(file(tmp_path / "rock", "basecolor")) - rock_texture().colour).abs().max() < 1e-4


def test_png16_holds_the_fitted_maps_alone(tmp_path: Path) -> None:
    surface_pictures.write_png16(rock_surface(), tmp_path / "rock", PROVENANCE)
    found = {file.stem.removeprefix("rock_") for file in (tmp_path / "rock").iterdir()}
    assert found == {"diffuse", "specular", "roughness", "normal_gl", "height"}
    height = file(tmp_path / "rock", "height")
    spec = oiio.ImageBuf(str(height)).spec()
    low, scale = (float(spec.get_string_attribute(key)) for key in ("offset", "scale"))
    again = (low + scale * read_stored_values(height)) * 32
    assert (again - (rock_surface().height - rock_surface().height.mean())).abs().max() < 5 * 32 * STEP


def test_exr_is_linear(tmp_path: Path) -> None:
    surface_pictures.write_exr(rock_surface(), tmp_path / "rock", PROVENANCE)
    maps = rock_surface().maps
    where = tmp_path / "rock"
    assert (read_stored_values(where / "rock_specular.exr") - maps.specular).abs().max() < 5e-4  # a half's step below 1
    assert (read_stored_values(where / "rock_normal_gl.exr") * 2 - 1 - maps.normal).abs().max() < 1e-6
    expected = (rock_surface().height - rock_surface().height.mean()) / 32
    assert (read_stored_values(where / "rock_height.exr") - expected).abs().max() < 1e-6


def test_without_the_extension_surfaces_have_no_exports_and_brdfs_keep_theirs(
    metapp: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(WITHOUT_VARIABLE, "assets")
    assert "texture has none; leave it out" in metapp("meta", "texture", "--export", "png16").misuse
    forms = "bsdf, bsdf-spectral, cpp, glsl, hlsl, materialx, merl, mitsuba, nbrdf, osl, wgsl"
    assert f"brdf expects one of {forms}" in metapp("meta", "brdf", "--export", "png16").misuse


# Occlusion in closed form, and the metallic-roughness workflow


def test_planes_and_single_peaks_are_not_occluded() -> None:
    assert torch.equal(occlusion_from_height(torch.zeros(1, 8, 8), periodic=True), torch.ones(1, 8, 8))
    peak = torch.zeros(1, 33, 33)
    peak[0, 16, 16] = 10
    assert occlusion_from_height(peak, periodic=False)[0, 16, 16] == 1


@pytest.mark.parametrize("depth", [6.0, 12.0, 24.0])
def test_bottom_of_a_round_pit_sees_the_sky_above_its_horizon(depth: float) -> None:
    size, radius = 65, 12.0
    x, y = (centres - size / 2 for centres in texel_centres(size))
    pit = torch.where(x * x + y * y < radius * radius, -depth, 0.0)[None]
    seen = float(occlusion_from_height(pit, periodic=False, reach=0.5)[0, size // 2, size // 2])
    # walls lie between texels, at most one texel nearer or farther
    low, high = (1 / (1 + (depth / pit_radius) ** 2) for pit_radius in (radius - 1, radius + 1))
    assert low < seen < high


@pytest.mark.parametrize("rows", [4, 64])
def test_occlusion_radius_scales_with_texture_width(rows: int) -> None:
    """A wall in a field that is not square leaves columns farther away than the radius unoccluded."""
    wall = torch.zeros(1, rows, 32)
    wall[..., 24:] = 100
    found = occlusion_from_height(wall, periodic=False, reach=0.25)[0, rows // 2]
    assert (found[: 24 - 8 - 1] == 1).all()
    assert (found[24 - 8 : 24] < 1).all()


def test_occlusion_wraps_around_edges_where_a_field_tiles() -> None:
    wall = torch.zeros(1, 16, 16)
    wall[..., 0] = 4
    tiled = occlusion_from_height(wall, periodic=True)
    assert torch.allclose(tiled[..., 1], tiled[..., -1])
    assert occlusion_from_height(wall, periodic=False)[0, 8, -1] == 1


def test_large_fields_are_occluded_as_small_ones() -> None:
    """Waves of the same shape, four times as large."""
    small, large = (wave_heights_and_normals(size)[0].float() * size / 64 for size in (256, 1024))
    coarse = torch.nn.functional.interpolate(occlusion_from_height(large, periodic=True)[None], (256, 256), mode="area")
    fine = occlusion_from_height(small, periodic=True)
    assert (coarse[0] - fine).abs().max() < 0.02
    assert fine.std() > 0.03
    edges = occlusion_from_height(large, periodic=True)[0]
    inner = (edges[:, 1:] - edges[:, :-1]).abs().max()
    assert (edges[:, 0] - edges[:, -1]).abs().max() <= 1.5 * inner  # no seam


def random_map(*shape: int) -> torch.Tensor:
    return torch.rand(*shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)


def test_specular_to_metallic_inverts_metallic_to_specular() -> None:
    base, metallic = DIELECTRIC_F0 + (1 - DIELECTRIC_F0) * random_map(3, 16, 16), random_map(1, 16, 16)
    found = specular_to_metallic(*metallic_to_specular(base, metallic))
    assert torch.allclose(found[1], metallic, atol=1e-9)
    assert torch.allclose(found[0], base, atol=1e-9)


def test_pure_metals_and_dielectrics_get_metallic_1_and_0() -> None:
    gold, plaster = torch.tensor([1.0, 0.77, 0.34])[:, None, None], torch.full((3, 1, 1), 0.8)
    dielectric = torch.full((1, 1, 1), DIELECTRIC_F0)
    metal, other = specular_to_metallic(torch.zeros(3, 1, 1), gold), specular_to_metallic(plaster, dielectric)
    assert torch.allclose(metal[1], torch.ones(1, 1, 1), atol=1e-4)
    assert torch.allclose(metal[0], gold, atol=1e-4)
    assert torch.equal(other[1], torch.zeros(1, 1, 1))
    assert torch.allclose(other[0], plaster)


def test_metallic_maps_stay_in_range_and_keep_total_reflectance() -> None:
    diffuse, specular = random_map(3, 32, 32), random_map(3, 32, 32).flip(0)
    for converted in specular_to_metallic(diffuse, specular):
        assert converted.isfinite().all()
        assert converted.min() >= 0
        assert converted.max() <= 1
    # and where nothing clips, all that is reflected is kept
    diffuse, specular = 0.4 * random_map(3, 16, 16), DIELECTRIC_F0 + 0.4 * random_map(1, 16, 16)
    again = metallic_to_specular(*specular_to_metallic(diffuse, specular))
    assert torch.allclose(again[0] + again[1], diffuse + specular, atol=1e-12)


# glTF


COUNTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def parse_document(path: Path) -> tuple[dict[str, Any], bytes]:
    """The document and the binary part of a .glb, whose chunks are checked."""
    content = path.read_bytes()
    magic, version, total = struct.unpack_from("<4sII", content)
    assert (magic, version, total) == (b"glTF", 2, len(content))
    parts, at = [], 12
    for name in (b"JSON", b"BIN\0"):
        size, kind = struct.unpack_from("<I4s", content, at)
        assert (kind, size % 4) == (name, 0)
        parts.append(content[at + 8 : at + 8 + size])
        at += 8 + size
    assert at == total
    return json.loads(parts[0]), parts[1]


def values(document: dict[str, Any], binary: bytes, index: int) -> np.ndarray:
    accessor = document["accessors"][index]
    view = document["bufferViews"][accessor["bufferView"]]
    assert view["byteOffset"] % 4 == 0
    dtype = {5126: "<f4", 5123: "<u2"}[accessor["componentType"]]
    count = accessor["count"] * COUNTS[accessor["type"]]
    assert count * np.dtype(dtype).itemsize == view["byteLength"]
    return np.frombuffer(binary, dtype, count, view["byteOffset"]).reshape(accessor["count"], -1)


def picture(document: dict[str, Any], binary: bytes, texture: int, folder: Path) -> torch.Tensor:
    view = document["bufferViews"][document["images"][document["textures"][texture]["source"]]["bufferView"]]
    file = folder / f"{texture}.png"
    file.write_bytes(binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]])
    return read_stored_values(file)


def test_f0_agrees_with_the_specification_and_other_maps_are_unchanged(tmp_path: Path) -> None:
    gltf.write_gltf(rock_surface(), tmp_path / "rock", PROVENANCE)
    document, binary = parse_document(tmp_path / "rock.glb")
    extensions = document["materials"][0]["extensions"]
    specular, index = extensions["KHR_materials_specular"], extensions["KHR_materials_ior"]["ior"]
    colour = srgb_to_linear(picture(document, binary, specular["specularColorTexture"]["index"], tmp_path))
    factor = torch.tensor(specular["specularColorFactor"])[:, None, None]
    f0 = (((index - 1) / (index + 1)) ** 2 * factor * colour).clamp_max(1)
    assert (linear_to_srgb(f0) - linear_to_srgb(rock_surface().maps.specular)).abs().max() < 1 / 255
    assert document["materials"][0]["pbrMetallicRoughness"]["metallicFactor"] == 0
    material, maps = document["materials"][0], rock_surface().maps
    core = material["pbrMetallicRoughness"]
    diffuse = picture(document, binary, core["baseColorTexture"]["index"], tmp_path)
    packed = picture(document, binary, core["metallicRoughnessTexture"]["index"], tmp_path)
    normal = picture(document, binary, material["normalTexture"]["index"], tmp_path)
    half = 0.5 / 255 + 1e-6
    assert (diffuse - linear_to_srgb(maps.diffuse)).abs().max() <= half
    assert (packed[1] - maps.roughness[0]).abs().max() <= half
    assert (packed[0] - all_surface_maps(rock_surface())["ao"].values[0]).abs().max() <= half
    assert not packed[2].any()
    assert (normal - (maps.normal / 2 + 0.5)).abs().max() <= half
    assert material["occlusionTexture"] == core["metallicRoughnessTexture"]
    assert document["asset"]["version"] == "2.0"
    assert document["asset"]["extras"]["provenance"] == PROVENANCE | {"rise": None}


@pytest.mark.parametrize(("tiles", "wrap"), [(True, 10497), (False, 33071)])
def test_the_rectangle_faces_its_viewer(tmp_path: Path, tiles: bool, wrap: int) -> None:
    gltf.write_gltf(rock_surface(tiles=tiles), tmp_path / "rock", PROVENANCE)
    document, binary = parse_document(tmp_path / "rock.glb")
    primitive = document["meshes"][0]["primitives"][0]
    place, normal, tangent, uv = (values(document, binary, i) for i in primitive["attributes"].values())
    for triangle in values(document, binary, primitive["indices"]).reshape(-1, 3):
        a, b, c = place[triangle]
        assert np.cross(b - a, c - a)[2] > 0
    assert (normal == [0, 0, 1]).all()
    # u goes right, v down, and the tangent along u: green points up
    assert np.allclose(uv, np.stack([place[:, 0] + 0.5, 0.5 - place[:, 1]], 1))
    assert (np.cross(normal, tangent[:, :3]) * tangent[:, 3:] == [0, 1, 0]).all()
    assert document["accessors"][0]["min"] == place.min(0).tolist()
    assert document["accessors"][0]["max"] == place.max(0).tolist()
    assert document["samplers"][0]["wrapS"] == wrap


def test_blender_s_pictures_have_the_f0_of_dielectrics_and_metals(tmp_path: Path) -> None:
    """F0 of dielectrics between 0 and 0.08 is kept, but for its hue."""
    maps = rock_surface().maps
    surface = replace(rock_surface(), maps=maps._replace(specular=0.08 * maps.specular.clamp_max(0.49)))
    surface_pictures.write_blender(surface, tmp_path / "rock", PROVENANCE)
    base, metallic, level = (
        read_stored_values(tmp_path / "rock" / f"rock_{name}.png") for name in ("BaseColor", "Metallic", "Specular")
    )
    assert not metallic.any()
    found = 0.08 * level * (1 - metallic) + srgb_to_linear(base) * metallic
    assert (found - surface.maps.specular.mean(0)).abs().max() < 1 / 65535
    base, metallic = torch.full((3, 8, 8), 0.8), torch.linspace(0, 1, 64).reshape(1, 8, 8)
    diffuse, specular = metallic_to_specular(base, metallic)
    maps = rock_surface(8).maps._replace(diffuse=diffuse, specular=specular)
    surface_pictures.write_blender(replace(rock_surface(8), maps=maps), tmp_path / "rock", PROVENANCE)
    read = [
        read_stored_values(tmp_path / "rock" / f"rock_{name}.png") for name in ("BaseColor", "Metallic", "Specular")
    ]
    found = 0.08 * read[2] * (1 - read[1]) + srgb_to_linear(read[0]) * read[1]
    assert (found - specular).abs().max() < 1e-3


# MaterialX


@pytest.fixture
def mtlx(tmp_path: Path) -> Path:
    materialx.write_openpbr(rock_surface(), tmp_path / "rock", PROVENANCE)
    return tmp_path / "rock" / "rock.mtlx"


def evaluated(graph: ET.Element, name: str, images: dict[str, torch.Tensor]) -> torch.Tensor:
    """A node's value [C, H, W]: of pictures, and of the arithmetic that the graph has."""
    node = next(element for element in graph if element.get("name") == name and element.tag != "output")
    if node.tag == "image":
        return images[name]
    inputs = {
        element.get("name"): evaluated(graph, element.get("nodename"), images)
        if element.get("nodename")
        else torch.tensor(float(element.get("value")))
        for element in node
    }
    if node.tag == "extract":
        return inputs["in"][int(inputs["index"])][None]
    return {"max": torch.maximum, "divide": torch.divide}[node.tag](inputs["in1"], inputs["in2"])


def test_f0_is_what_openpbr_reflects_from_straight_above(mtlx: Path) -> None:
    root = ET.parse(mtlx).getroot()
    graph, surface = root.find("nodegraph"), root.find("open_pbr_surface")
    images = {"specular": srgb_to_linear(read_stored_values(mtlx.with_name("rock_specular.png")))}
    weight, tint = (evaluated(graph, name, images) for name in ("weight", "tint"))
    index = float(next(element for element in surface if element.get("name") == "specular_ior").get("value"))
    f0 = (weight * ((index - 1) / (index + 1)) ** 2) * tint
    assert (linear_to_srgb(f0) - linear_to_srgb(rock_surface().maps.specular)).abs().max() < 1e-4
    assert weight.max() <= 1 + 1e-4
    assert tint.max() <= 1 + 1e-6
    inputs = [element for element in root.iter("input") if element.get("type") == "filename"]
    assert {element.get("value") for element in inputs} == {path.name for path in mtlx.parent.glob("*.png")}
    spaces = {element.get("value"): element.get("colorspace") for element in inputs}
    colours = {name for name, space in spaces.items() if space == "srgb_texture"}
    assert colours == {"rock_diffuse.png", "rock_specular.png"}


def test_a_material_without_reflection_has_an_index(tmp_path: Path) -> None:
    black = rock_surface().maps._replace(specular=torch.zeros(1, 32, 32))
    materialx.write_openpbr(replace(rock_surface(), maps=black), tmp_path / "rock", PROVENANCE)
    surface = ET.parse(tmp_path / "rock" / "rock.mtlx").getroot().find("open_pbr_surface")
    assert 1 < float(next(element for element in surface if element.get("name") == "specular_ior").get("value")) < 1.1


@pytest.mark.parametrize("target", ["Glsl", "Osl"])
def test_materialx_validates_the_document_and_generates_shaders(mtlx: Path, target: str) -> None:
    mx = pytest.importorskip("MaterialX", reason="MaterialX is not installed: pip install MaterialX")
    from MaterialX import PyMaterialXGenGlsl, PyMaterialXGenOsl, PyMaterialXGenShader

    library, search = mx.createDocument(), mx.getDefaultDataSearchPath()
    mx.loadLibraries(mx.getDefaultDataLibraryFolders(), search, library)
    document = mx.createDocument()
    mx.readFromXmlFile(document, str(mtlx))
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
