"""Maps of surfaces as image files: asset folders, folders for Blender, EXR, PNG of 16 bits.

The asset folder has all maps of a surface as PNG of 16 bits, a preview, and `material.json`, which describes them:

    <name>_basecolor.png  <name>_diffuse.png  <name>_specular.png  <name>_metallic.png  <name>_roughness.png
    <name>_normal_gl.png  <name>_normal_dx.png  <name>_height.png  <name>_ao.png  <name>_orm.png
    preview.png  material.json

A texture has a base colour alone. A program takes the files of its workflow: `diffuse` and `specular` hold the maps as
fitted; `basecolor` and `metallic` are the nearest material of the metallic-roughness workflow.

For Blender the pictures have the names that Node Wrangler wires to a Principled BSDF: select it, press Ctrl+Shift+T and
choose all. Node Wrangler knows the metallic workflow; the Specular IOR Level, gray, holds the rest of F0, up to
0.08. Where F0 has a hue of its own, import the glTF file instead: its F0 is exact.
"""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from metapp.appearance.colour import linear_to_srgb, stretch_to_unit_range
from metapp.appearance.flash import Maps, radiance_to_display, relighting_positions, render_maps, texel_positions
from metapp.appearance.surface import DESCRIPTION_FILE, DIELECTRIC_F0, Surface
from metapp.extensions.assets.planes import SurfaceMap, all_surface_maps, fitted_surface_maps
from metapp.storage import image_writers
from metapp.storage.files import to_json_value, write_bytes

PREVIEW_LONGER_SIDE_PX = 256  # px, of the longer side
WORKFLOW_DESCRIPTIONS = {
    "specular": "diffuse and specular are what was fitted: f = diffuse (1 - F0) / pi + D F G / (4 cos_i cos_o), GGX, "
    "separable Smith, Schlick's Fresnel from F0",
    "metallic-roughness": f"diffuse = basecolor (1 - metallic), F0 = {DIELECTRIC_F0} (1 - metallic) + basecolor metallic, "
    "solved for the channels' means; F0 of another hue, or below that of dielectrics, is held by specular alone",
}
BLENDER_DEFAULT_F0 = 0.04  # F0 of Blender's default index of refraction, 1.5, at a level of 0.5
BLENDER_SOCKET_MAPS = {
    "BaseColor": "basecolor",
    "Metallic": "metallic",
    "Specular": "level",
    "Roughness": "roughness",
    "Normal": "normal_gl",
    "Displacement": "height",
    "AO": "ao",
}
HIGH_PRECISION_MAPS = ("normal_gl", "height")


def write_surface_maps(planes: Mapping[str, SurfaceMap], path: Path, bits: int = 16) -> dict[str, dict[str, object]]:
    """Write maps as PNG, <path>/<name>_<map>.png, `name` being the last part of `path`.

    Returns:
        The description of each file, by its name: encoding, meaning; of heights how integers become widths.
    """
    files = {key: path / f"{path.name}_{key}.png" for key in planes}
    return {file.name: write_surface_map(planes[key], file, bits) for key, file in files.items()}


def write_surface_map(plane: SurfaceMap, file: Path, bits: int) -> dict[str, object]:
    """Write a map as PNG by its encoding.

    Returns:
        The description of the file.
    """
    encoding, values = "linear", plane.values
    about: dict[str, object] = {"channels": len(values), "bits": bits, "meaning": plane.meaning}
    if plane.encoding == "srgb":
        encoding, values = "sRGB", linear_to_srgb(values.clamp(0, 1))
    texts = {"encoding": encoding}
    if plane.encoding == "stretched":
        values, low, high = stretch_to_unit_range(values)
        about |= {"offset": low, "scale": high - low, "unit": "texture widths"}
        texts |= {"offset": f"{low:.9g}", "scale": f"{high - low:.9g}"}
    image_writers.write_png(values.movedim(0, -1), texts, file, bits)
    return {"colour_space": encoding} | about


def render_preview(surface: Surface) -> Tensor:
    """Display values [3, h, w] of a surface: a texture as it is, a material under a light from the left."""
    scale = min(1.0, PREVIEW_LONGER_SIDE_PX / max(surface.size))
    size = [max(1, math.floor(side * scale)) for side in surface.size]
    maps = surface.maps
    if maps is None:
        return linear_to_srgb(_resized(surface.base, size).clamp(0, 1))
    light, view = relighting_positions(dtype=surface.base.dtype)["left"]
    place = texel_positions(*surface.size, dtype=surface.base.dtype)
    lit = render_maps(Maps(*(part[None] for part in maps)), place, light, view)[0]
    return radiance_to_display(_resized(lit, size))


def _resized(picture: Tensor, size: list[int]) -> Tensor:
    return interpolate(picture[None], size=size, mode="area")[0]


def write_asset(surface: Surface, path: Path, provenance: Mapping[str, object]) -> None:
    """Write the asset folder `path`; `material.json` comes last."""
    files = write_surface_maps(all_surface_maps(surface), path)
    image_writers.write_png(render_preview(surface).movedim(0, -1), {"encoding": "sRGB"}, path / "preview.png")
    write_description(surface, path, files, provenance)


def write_description(
    surface: Surface, path: Path, files: Mapping[str, Mapping[str, object]], provenance: Mapping[str, object]
) -> None:
    """Write `material.json` of a surface and its files; numbers that are not finite, which JSON lacks, become null."""
    height, width = surface.size
    document = {
        "schema": 1,
        "name": path.name,
        "kind": "texture" if surface.maps is None else "material",
        "size": {"width": width, "height": height, "unit": "px"},
        "real_world_size": None,  # of the width, in metres: a photograph alone does not tell
        "tiles": surface.tiles,
        "colour_primaries": "Rec. 709",
        **({} if surface.maps is None else {"workflows": WORKFLOW_DESCRIPTIONS}),
        "files": dict(files),
        "provenance": dict(provenance),
    }
    text = json.dumps(to_json_value(document), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    write_bytes(path / DESCRIPTION_FILE, text.encode())


def write_blender(surface: Surface, path: Path, provenance: Mapping[str, object]) -> None:
    """Write <path>/<name>_<socket>.png and <path>/material.json."""
    planes = all_surface_maps(surface)
    planes["level"] = SurfaceMap(
        specular_level(surface, planes), "linear", "Specular IOR Level; F0 / 0.08 of what no metal is"
    )
    files = write_surface_maps({socket: planes[key] for socket, key in BLENDER_SOCKET_MAPS.items()}, path)
    write_description(surface, path, files, provenance)


def specular_level(surface: Surface, planes: Mapping[str, SurfaceMap]) -> Tensor:
    """The level [1, H, W] at which the dielectric part makes up the rest of the mean F0; 0.5 of pure metals."""
    assert surface.maps is not None
    metallic, base = planes["metallic"].values, planes["basecolor"].values
    missing = (surface.maps.specular - base * metallic).mean(0, keepdim=True)
    level = missing / (1 - metallic).clamp_min(1e-6) * (0.5 / BLENDER_DEFAULT_F0)
    return torch.where(metallic < 1, level.clamp(0, 1), 0.5)


def write_exr(surface: Surface, path: Path, provenance: Mapping[str, object]) -> None:
    """Write <path>/<name>_<map>.exr of the fitted maps, or of a texture's colour; heights in texture widths."""
    for key, plane in fitted_surface_maps(surface).items():
        file = path / f"{path.name}_{key}.exr"
        image_writers.write_exr(plane.values.movedim(0, -1), file, half=key not in HIGH_PRECISION_MAPS)


def write_png16(surface: Surface, path: Path, provenance: Mapping[str, object]) -> None:
    """Write <path>/<name>_<map>.png of the fitted maps, or of a texture's colour."""
    write_surface_maps(fitted_surface_maps(surface), path)


def describe_provenance(provenance: Mapping[str, object]) -> str:
    """A fit's provenance in a few words."""
    keys = ("app", "paradigm", "rule", "checkpoint", "recipe")
    return ", ".join(f"{key} {provenance[key]}" for key in keys if key in provenance)


def fill_in_name(document: ET.Element, name: str) -> ET.Element:
    """An XML document with a name in place of NAME in its attributes."""
    for element in document.iter():
        for key, value in element.items():
            element.set(key, value.replace("NAME", name))
    return document
