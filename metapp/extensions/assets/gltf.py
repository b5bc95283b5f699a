"""The glTF 2.0 export: one .glb file, a rectangle that carries the material, with all pictures inside as PNG of 8 bits.

F0 is exact: metallic is 0, and the extension KHR_materials_specular has a picture of F0 divided by its greatest value,
and a factor that undoes the division; the factor is above 1 where F0 is above 0.04, the reflectance of an index of
refraction of 1.5. (An index of 0, by which the specification converts the specular-glossiness workflow, makes mirrors
in Blender 5.0, and a high index leaves no Fresnel effect there.) A program without the extension shows a dielectric of
F0 0.04. Occlusion and roughness share a picture, as glTF prescribes.
"""

from __future__ import annotations

import json
import struct
import tempfile
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path

import numpy as np
import torch

from metapp.appearance.assets import Surface
from metapp.appearance.surface import DIELECTRIC_F0
from metapp.extensions.assets.planes import all_surface_maps
from metapp.extensions.assets.surface_pictures import write_surface_map
from metapp.storage.files import add_suffix, read_bytes, to_json_value, write_bytes

GLTF_INDEX_OF_REFRACTION = 1.5  # its reflectance at normal incidence is DIELECTRIC_F0
GLTF_PNG_BITS = 8  # browsers decode PNG files of 16 bits to 8 bits
GLTF_MAPS = ("diffuse", "specular", "orm", "normal_gl")
GL_REPEAT, GL_CLAMP_TO_EDGE = 10497, 33071
GL_LINEAR, GL_LINEAR_MIPMAP_LINEAR = 9729, 9987
GL_FLOAT, GL_UNSIGNED_SHORT = 5126, 5123
GL_ARRAY_BUFFER, GL_ELEMENT_ARRAY_BUFFER = 34962, 34963
GLB_MAGIC, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942
RECTANGLE_CORNERS = ((-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5), (0.5, 0.5))  # x, y; from upper left, counter-clockwise
TRIANGLE_INDICES = (0, 1, 2, 0, 2, 3)


def write_gltf(surface: Surface, path: Path, provenance: Mapping[str, object]) -> None:
    """Write a surface as the file <path>.glb."""
    content = encode_glb(surface, path.name, provenance)
    write_bytes(add_suffix(path, ".glb"), content)


def encode_glb(surface: Surface, name: str, provenance: Mapping[str, object]) -> bytes:
    """Encode a surface as the bytes of a .glb file.

    The surface lies on a rectangle of width 1 that faces +z, with row 0 of the pictures on top.

    Args:
        surface: the fitted material; it must have maps.
        name: the name of the material, the mesh and the node.
        provenance: how the fit was made; stored in the asset's extras.
    """
    height = surface.size[0] / surface.size[1]
    vertices = {
        "POSITION": np.array([(x, y * height, 0) for x, y in RECTANGLE_CORNERS], np.float32),
        "NORMAL": np.array([(0, 0, 1)] * 4, np.float32),
        "TANGENT": np.array([(1, 0, 0, 1)] * 4, np.float32),
        "TEXCOORD_0": np.array([(x + 0.5, 0.5 - y) for x, y in RECTANGLE_CORNERS], np.float32),
    }
    pictures, wrap = _encode_pictures(surface), GL_REPEAT if surface.tiles else GL_CLAMP_TO_EDGE
    chunks = [(values.tobytes(), {"target": GL_ARRAY_BUFFER}) for values in vertices.values()]
    chunks.append((np.array(TRIANGLE_INDICES, np.uint16).tobytes(), {"target": GL_ELEMENT_ARRAY_BUFFER}))
    buffer_views, binary = list[dict[str, int]](), bytearray()
    for chunk, view_target in [*chunks, *((png, {}) for png in pictures.values())]:
        buffer_views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(chunk), **view_target})
        binary += chunk + b"\0" * (-len(chunk) % 4)
    accessors: list[dict[str, object]] = [
        {"bufferView": i, "componentType": GL_FLOAT, "count": 4, "type": f"VEC{values.shape[1]}"}
        for i, values in enumerate(vertices.values())
    ]
    corners = vertices["POSITION"]
    accessors[0] |= {"min": corners.min(0).tolist(), "max": corners.max(0).tolist()}
    index_accessor = len(accessors)
    accessors.append(
        {
            "bufferView": index_accessor,
            "componentType": GL_UNSIGNED_SHORT,
            "count": len(TRIANGLE_INDICES),
            "type": "SCALAR",
        }
    )
    primitive = {"attributes": {key: i for i, key in enumerate(vertices)}, "indices": index_accessor, "material": 0}
    document = {
        "asset": {
            "version": "2.0",
            "generator": f"metapp {metadata.version('metapp')}",
            "extras": {"provenance": to_json_value(dict(provenance))},
        },
        "extensionsUsed": ["KHR_materials_ior", "KHR_materials_specular"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": name, "mesh": 0}],
        "meshes": [{"name": name, "primitives": [primitive]}],
        "materials": [_describe_material(name, list(pictures), highest_f0(surface))],
        "textures": [{"source": i, "sampler": 0} for i in range(len(pictures))],
        "samplers": [{"magFilter": GL_LINEAR, "minFilter": GL_LINEAR_MIPMAP_LINEAR, "wrapS": wrap, "wrapT": wrap}],
        "images": [
            {"name": key, "mimeType": "image/png", "bufferView": i}
            for i, key in enumerate(pictures, index_accessor + 1)
        ],
        "accessors": accessors,
        "bufferViews": buffer_views,
        "buffers": [{"byteLength": len(binary)}],
    }
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    content = struct.pack("<II", len(text), JSON_CHUNK) + text + struct.pack("<II", len(binary), BINARY_CHUNK) + binary
    return struct.pack("<III", GLB_MAGIC, 2, 12 + len(content)) + content


def highest_f0(surface: Surface) -> float:
    """Return the greatest F0 of all texels and channels, at least 1e-4; the picture of F0 is divided by it."""
    return max(float(surface.maps.specular.max()), 1e-4)


def _describe_material(name: str, pictures: list[str], greatest_f0: float) -> dict[str, object]:
    """Return the material of a glTF document, whose textures show the pictures."""
    textures = {key: {"index": pictures.index(key)} for key in pictures}
    return {
        "name": name,
        "pbrMetallicRoughness": {
            "baseColorTexture": textures["diffuse"],
            "metallicFactor": 0,
            "metallicRoughnessTexture": textures["orm"],
        },
        "normalTexture": textures["normal_gl"],
        "occlusionTexture": textures["orm"],
        "extensions": {
            "KHR_materials_ior": {"ior": GLTF_INDEX_OF_REFRACTION},
            "KHR_materials_specular": {
                "specularColorFactor": [greatest_f0 / DIELECTRIC_F0] * 3,
                "specularColorTexture": textures["specular"],
            },
        },
    }


def _encode_pictures(surface: Surface) -> dict[str, bytes]:
    """Encode the pictures of GLTF_MAPS as PNG bytes, by name.

    F0 is divided by its greatest value; the blue channel of the picture of occlusion and roughness, metallic, is 0.
    """
    surface_maps = all_surface_maps(surface)
    values_without_metallic = surface_maps["orm"].values * torch.tensor([1.0, 1.0, 0.0])[:, None, None]
    surface_maps["orm"] = surface_maps["orm"]._replace(values=values_without_metallic)
    surface_maps["specular"] = surface_maps["specular"]._replace(
        values=surface_maps["specular"].values / highest_f0(surface)
    )
    pictures = {}
    with tempfile.TemporaryDirectory() as folder:
        for key in GLTF_MAPS:
            file = Path(folder) / f"{key}.png"
            write_surface_map(surface_maps[key], file, GLTF_PNG_BITS)
            pictures[key] = read_bytes(file)
    return pictures
