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

import torch

from metapp.appearance.surface import DIELECTRIC, Surface
from metapp.extensions.assets.pictures import write_plane
from metapp.extensions.assets.planes import all_planes
from metapp.storage.files import as_text, read_bytes, suffixed, write_bytes

INDEX = 1.5  # of refraction; reflects DIELECTRIC
BITS = 8  # more is not decoded by browsers
PICTURES = ("diffuse", "specular", "orm", "normal_gl")
REPEAT, CLAMP = 10497, 33071
LINEAR, MIPMAPS = 9729, 9987
FLOAT, SHORT = 5126, 5123
VERTICES, INDICES = 34962, 34963
GLB, JSON, BINARY = 0x46546C67, 0x4E4F534A, 0x004E4942
CORNERS = ((-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5), (0.5, 0.5))  # from the upper left one, counter-clockwise
TRIANGLES = (0, 1, 2, 0, 2, 3)
ATTRIBUTES = {"POSITION": 0, "NORMAL": 1, "TANGENT": 2, "TEXCOORD_0": 3}  # accessors; 4 is that of indices


class _Binary:
    """The binary part of a .glb, and the views of it."""

    def __init__(self) -> None:
        self.content = bytearray()
        self.views: list[dict[str, int]] = []

    def add(self, part: bytes, target: int = 0) -> int:
        """Append a part; the index of its view."""
        self.content += b"\0" * (-len(self.content) % 4)
        view = {"buffer": 0, "byteOffset": len(self.content), "byteLength": len(part)}
        self.views.append(view | ({"target": target} if target else {}))
        self.content += part
        return len(self.views) - 1


def write_gltf(surface: Surface, path: Path, provenance: Mapping[str, object]) -> None:
    """Write <path>.glb."""
    content = glb(surface, path.name, provenance)
    write_bytes(suffixed(path, ".glb"), content)


def glb(surface: Surface, name: str, provenance: Mapping[str, object]) -> bytes:
    """The bytes of a .glb of a surface."""
    binary = _Binary()
    accessors = _quad(binary, surface)
    pictures = _encoded(surface)
    images = [
        {"name": key, "mimeType": "image/png", "bufferView": binary.add(content)} for key, content in pictures.items()
    ]
    wrap = REPEAT if surface.tiles else CLAMP
    binary.content += b"\0" * (-len(binary.content) % 4)
    document = {
        "asset": {
            "version": "2.0",
            "generator": f"metapp {metadata.version('metapp')}",
            "extras": {"provenance": as_text(dict(provenance))},
        },
        "extensionsUsed": ["KHR_materials_ior", "KHR_materials_specular"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": name, "mesh": 0}],
        "meshes": [{"name": name, "primitives": [{"attributes": ATTRIBUTES, "indices": 4, "material": 0}]}],
        "materials": [_material(name, list(pictures), highest_f0(surface))],
        "textures": [{"source": i, "sampler": 0} for i in range(len(images))],
        "samplers": [{"magFilter": LINEAR, "minFilter": MIPMAPS, "wrapS": wrap, "wrapT": wrap}],
        "images": images,
        "accessors": accessors,
        "bufferViews": binary.views,
        "buffers": [{"byteLength": len(binary.content)}],
    }
    return _packed(document, bytes(binary.content))


def _packed(document: Mapping[str, object], binary: bytes) -> bytes:
    """A .glb: a header and two chunks, each of a multiple of four bytes."""
    text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
    text += b" " * (-len(text) % 4)
    chunks = [struct.pack("<II", len(part), kind) + part for part, kind in ((text, JSON), (binary, BINARY))]
    total = 12 + sum(map(len, chunks))
    return b"".join([struct.pack("<III", GLB, 2, total), *chunks])


def _quad(binary: _Binary, surface: Surface) -> list[dict[str, object]]:
    """A rectangle of width 1 that faces +z, row 0 of the pictures on top; its accessors."""
    aspect = surface.size[0] / surface.size[1]
    corners: list[tuple[float, ...]] = [(x, y * aspect, 0.0) for x, y in CORNERS]
    vertices: dict[str, list[tuple[float, ...]]] = {
        "VEC3": corners,
        "VEC3 normal": [(0.0, 0.0, 1.0)] * 4,
        "VEC4 tangent": [(1.0, 0.0, 0.0, 1.0)] * 4,
        "VEC2 place": [(x + 0.5, 0.5 - y) for x, y in CORNERS],
    }
    accessors: list[dict[str, object]] = []
    for kind, rows in vertices.items():
        part = b"".join(struct.pack(f"<{len(row)}f", *row) for row in rows)
        view = binary.add(part, VERTICES)
        accessors.append({"bufferView": view, "componentType": FLOAT, "count": 4, "type": kind.split()[0]})
    low, high = ([end(column) for column in zip(*corners, strict=True)] for end in (min, max))
    accessors[0] |= {"min": low, "max": high}
    view = binary.add(struct.pack("<6H", *TRIANGLES), INDICES)
    return [*accessors, {"bufferView": view, "componentType": SHORT, "count": 6, "type": "SCALAR"}]


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
            "KHR_materials_ior": {"ior": INDEX},
            "KHR_materials_specular": {
                "specularColorFactor": [highest / DIELECTRIC] * 3,
                "specularColorTexture": texture["specular"],
            },
        },
    }


def _encoded(surface: Surface) -> dict[str, bytes]:
    """The pictures as PNG, by name: that of F0 is over its greatest, and blue of the packed one 0, as metallic is."""
    planes = all_planes(surface)
    no_metal = planes["orm"].values * torch.tensor([1.0, 1.0, 0.0])[:, None, None]
    planes["orm"] = planes["orm"]._replace(values=no_metal)
    planes["specular"] = planes["specular"]._replace(values=planes["specular"].values / highest_f0(surface))
    pictures = {}
    with tempfile.TemporaryDirectory() as folder:
        for key in PICTURES:
            file = Path(folder) / f"{key}.png"
            write_plane(planes[key], file, BITS)
            pictures[key] = read_bytes(file)
    return pictures
