"""glTF: a whole .glb whose material has the F0 that was fitted, and what Blender makes of it."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from metapp.appearance.colour import linear_to_srgb, srgb_to_linear
from metapp.appearance.surface import from_metallic
from metapp.extensions.assets import gltf, pictures
from metapp.extensions.assets.planes import all_planes
from tests.surfaces import PROVENANCE, rock, stored

COUNTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}


def parsed(path: Path) -> tuple[dict[str, Any], bytes]:
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
    return stored(file)


def test_f0_comes_back_as_the_specification_computes_it_and_the_other_maps_as_they_are(tmp_path: Path) -> None:
    gltf.write_gltf(rock(), tmp_path / "rock", PROVENANCE)
    document, binary = parsed(tmp_path / "rock.glb")
    extensions = document["materials"][0]["extensions"]
    specular, index = extensions["KHR_materials_specular"], extensions["KHR_materials_ior"]["ior"]
    colour = srgb_to_linear(picture(document, binary, specular["specularColorTexture"]["index"], tmp_path))
    factor = torch.tensor(specular["specularColorFactor"])[:, None, None]
    f0 = (((index - 1) / (index + 1)) ** 2 * factor * colour).clamp_max(1)
    assert (linear_to_srgb(f0) - linear_to_srgb(rock().maps.specular)).abs().max() < 1 / 255
    assert document["materials"][0]["pbrMetallicRoughness"]["metallicFactor"] == 0
    material, maps = document["materials"][0], rock().maps
    core = material["pbrMetallicRoughness"]
    diffuse = picture(document, binary, core["baseColorTexture"]["index"], tmp_path)
    packed = picture(document, binary, core["metallicRoughnessTexture"]["index"], tmp_path)
    normal = picture(document, binary, material["normalTexture"]["index"], tmp_path)
    half = 0.5 / 255 + 1e-6
    assert (diffuse - linear_to_srgb(maps.diffuse)).abs().max() <= half
    assert (packed[1] - maps.roughness[0]).abs().max() <= half
    assert (packed[0] - all_planes(rock())["ao"].values[0]).abs().max() <= half
    assert not packed[2].any()
    assert (normal - (maps.normal / 2 + 0.5)).abs().max() <= half
    assert material["occlusionTexture"] == core["metallicRoughnessTexture"]
    assert document["asset"]["version"] == "2.0"
    assert document["asset"]["extras"]["provenance"] == PROVENANCE | {"rise": None}


@pytest.mark.parametrize(("tiles", "wrap"), [(True, 10497), (False, 33071)])
def test_the_rectangle_faces_its_viewer(tmp_path: Path, tiles: bool, wrap: int) -> None:
    gltf.write_gltf(rock(tiles=tiles), tmp_path / "rock", PROVENANCE)
    document, binary = parsed(tmp_path / "rock.glb")
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
    """Of what is no metal, F0 down to 0 and up to 0.08 is kept, but for its hue."""
    maps = rock().maps
    surface = rock()._replace(maps=maps._replace(specular=0.08 * maps.specular.clamp_max(0.49)))
    pictures.write_blender(surface, tmp_path / "rock", PROVENANCE)
    base, metallic, level = (
        stored(tmp_path / "rock" / f"rock_{name}.png") for name in ("BaseColor", "Metallic", "Specular")
    )
    assert not metallic.any()
    found = 0.08 * level * (1 - metallic) + srgb_to_linear(base) * metallic
    assert (found - surface.maps.specular.mean(0)).abs().max() < 1 / 65535
    base, metallic = torch.full((3, 8, 8), 0.8), torch.linspace(0, 1, 64).reshape(1, 8, 8)
    diffuse, specular = from_metallic(base, metallic)
    maps = rock(8).maps._replace(diffuse=diffuse, specular=specular)
    pictures.write_blender(rock(8)._replace(base=diffuse, maps=maps), tmp_path / "rock", PROVENANCE)
    read = [stored(tmp_path / "rock" / f"rock_{name}.png") for name in ("BaseColor", "Metallic", "Specular")]
    found = 0.08 * read[2] * (1 - read[1]) + srgb_to_linear(read[0]) * read[1]
    assert (found - specular).abs().max() < 1e-3
