"""glTF 2.0, one .glb: a square that carries the material, with all pictures inside, PNG of 8 bits.

F0 is exact: metallic is 0, and KHR_materials_specular has a picture of F0 over its greatest value and a factor that
brings it back, above 1 where F0 is above the 0.04 of the index 1.5. (An index of 0, by which the specification converts
the specular-glossiness workflow, makes mirrors in Blender 5.0, and a high index leaves no Fresnel there.) A program
without the extension shows a dielectric of F0 0.04. Occlusion and roughness share a picture, as glTF wants it.
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

from metapp.appearance.surface import DIELECTRIC_F0, Surface
from metapp.extensions.assets.planes import all_surface_maps
from metapp.extensions.assets.surface_pictures import write_surface_map
from metapp.storage.files import add_suffix, read_bytes, to_json_value, write_bytes

GLTF_INDEX_OF_REFRACTION = 1.5  # of refraction; reflects DIELECTRIC
GLTF_PNG_BITS = 8  # more is not decoded by browsers
GLTF_MAPS = ("diffuse", "specular", "orm", "normal_gl")
GL_REPEAT, GL_CLAMP_TO_EDGE = 10497, 33071
GL_LINEAR, GL_LINEAR_MIPMAP_LINEAR = 9729, 9987
GL_FLOAT, GL_UNSIGNED_SHORT = 5126, 5123
GL_ARRAY_BUFFER, GL_ELEMENT_ARRAY_BUFFER = 34962, 34963
GLB_MAGIC, JSON_CHUNK, BINARY_CHUNK = 0x46546C67, 0x4E4F534A, 0x004E4942
RECTANGLE_CORNERS = ((-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5), (0.5, 0.5))  # from the upper left one, counter-clockwise
TRIANGLE_INDICES = (0, 1, 2, 0, 2, 3)


def write_gltf(surface: Surface, path: Path, provenance: Mapping[str, object]) -> None:
    """Write <path>.glb."""
    content = encode_glb(surface, path.name, provenance)
    write_bytes(add_suffix(path, ".glb"), content)


def encode_glb(surface: Surface, name: str, provenance: Mapping[str, object]) -> bytes:
    """The bytes of a .glb of a surface: a rectangle of width 1 that faces +z, row 0 of the pictures on top."""
    height = surface.size[0] / surface.size[1]
    vertices = {
        "POSITION": np.array([(x, y * height, 0) for x, y in RECTANGLE_CORNERS], np.float32),
        "NORMAL": np.array([(0, 0, 1)] * 4, np.float32),
        "TANGENT": np.array([(1, 0, 0, 1)] * 4, np.float32),
        "TEXCOORD_0": np.array([(x + 0.5, 0.5 - y) for x, y in RECTANGLE_CORNERS], np.float32),
    }
    pictures, wrap = _encoded(surface), GL_REPEAT if surface.tiles else GL_CLAMP_TO_EDGE
    parts = [(rows.tobytes(), {"target": GL_ARRAY_BUFFER}) for rows in vertices.values()]
    parts.append((np.array(TRIANGLE_INDICES, np.uint16).tobytes(), {"target": GL_ELEMENT_ARRAY_BUFFER}))
    views, binary = list[dict[str, int]](), bytearray()
    for part, use in [*parts, *((png, {}) for png in pictures.values())]:
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(part), **use})
        binary += part + b"\0" * (-len(part) % 4)
    accessors: list[dict[str, object]] = [
        {"bufferView": i, "componentType": GL_FLOAT, "count": 4, "type": f"VEC{rows.shape[1]}"}
        for i, rows in enumerate(vertices.values())
    ]
    corners = vertices["POSITION"]
    accessors[0] |= {"min": corners.min(0).tolist(), "max": corners.max(0).tolist()}
    indices = len(accessors)
    accessors.append(
        {"bufferView": indices, "componentType": GL_UNSIGNED_SHORT, "count": len(TRIANGLE_INDICES), "type": "SCALAR"}
    )
    primitive = {"attributes": {key: i for i, key in enumerate(vertices)}, "indices": indices, "material": 0}
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
        "materials": [_material(name, list(pictures), highest_f0(surface))],
        "textures": [{"source": i, "sampler": 0} for i in range(len(pictures))],
        "samplers": [{"magFilter": GL_LINEAR, "minFilter": GL_LINEAR_MIPMAP_LINEAR, "wrapS": wrap, "wrapT": wrap}],
        "images": [
            {"name": key, "mimeType": "image/png", "bufferView": i} for i, key in enumerate(pictures, indices + 1)
        ],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(binary)}],
    }
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    content = struct.pack("<II", len(text), JSON_CHUNK) + text + struct.pack("<II", len(binary), BINARY_CHUNK) + binary
    return struct.pack("<III", GLB_MAGIC, 2, 12 + len(content)) + content


def highest_f0(surface: Surface) -> float:
    """The greatest F0 of all texels and channels; 1 of the picture that is written."""
    assert surface.maps is not None
    return max(float(surface.maps.specular.max()), 1e-4)


def _material(name: str, pictures: list[str], highest: float) -> dict[str, object]:
    texture = {key: {"index": pictures.index(key)} for key in pictures}
    return {
        "name": name,
        "pbrMetallicRoughness": {
            "baseColorTexture": texture["diffuse"],
            "metallicFactor": 0,
            "metallicRoughnessTexture": texture["orm"],
        },
        "normalTexture": texture["normal_gl"],
        "occlusionTexture": texture["orm"],
        "extensions": {
            "KHR_materials_ior": {"ior": GLTF_INDEX_OF_REFRACTION},
            "KHR_materials_specular": {
                "specularColorFactor": [highest / DIELECTRIC_F0] * 3,
                "specularColorTexture": texture["specular"],
            },
        },
    }


def _encoded(surface: Surface) -> dict[str, bytes]:
    """The pictures as PNG, by name: that of F0 is over its greatest, and blue of the packed one 0, as metallic is."""
    planes = all_surface_maps(surface)
    no_metal = planes["orm"].values * torch.tensor([1.0, 1.0, 0.0])[:, None, None]
    planes["orm"] = planes["orm"]._replace(values=no_metal)
    planes["specular"] = planes["specular"]._replace(values=planes["specular"].values / highest_f0(surface))
    pictures = {}
    with tempfile.TemporaryDirectory() as folder:
        for key in GLTF_MAPS:
            file = Path(folder) / f"{key}.png"
            write_surface_map(planes[key], file, GLTF_PNG_BITS)
            pictures[key] = read_bytes(file)
    return pictures
