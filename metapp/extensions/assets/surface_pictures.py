"""Maps of surfaces as image files: asset folders, folders for Blender, EXR files, PNG files of 16 bits.

The asset folder has all maps of a surface as PNG of 16 bits, a preview, and `material.json`, which describes them:

    <name>_basecolor.png  <name>_diffuse.png  <name>_specular.png  <name>_metallic.png  <name>_roughness.png
    <name>_normal_gl.png  <name>_normal_dx.png  <name>_height.png  <name>_ao.png  <name>_orm.png
    preview.png  material.json

A texture has a base colour alone. A program takes the files of its workflow: `diffuse` and `specular` hold the maps as
fitted; `basecolor` and `metallic` are the nearest material of the metallic-roughness workflow.

For Blender the pictures have the names by which the add-on Node Wrangler connects them to a Principled BSDF: select it,
press Ctrl+Shift+T and choose all. Node Wrangler knows the metallic workflow; the input Specular IOR Level, which is
grey, holds the rest of F0, up to 0.08. Where F0 has a hue of its own, import the glTF file instead: its F0 is exact.
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

from metapp.appearance.assets import Surface, Texture
from metapp.appearance.colour import linear_to_srgb, radiance_to_display, stretch_to_unit_range
from metapp.appearance.flash import relighting_positions, render_maps, texel_positions
from metapp.appearance.surface import DESCRIPTION_FILE, DIELECTRIC_F0
from metapp.appearance.svbrdf_maps import Maps
from metapp.extensions.assets.planes import SurfaceMap, all_surface_maps, fitted_surface_maps
from metapp.storage import image_writers
from metapp.storage.files import to_json_value, write_bytes

PREVIEW_LONGER_SIDE_PX = 256
WORKFLOW_DESCRIPTIONS = {
    "specular": "diffuse and specular are what was fitted: f = diffuse (1 - F0) / pi + D F G / (4 cos_i cos_o), GGX, "
    "separable Smith, Schlick's Fresnel from F0",
    "metallic-roughness": f"diffuse = basecolor (1 - metallic), F0 = {DIELECTRIC_F0} (1 - metallic) + basecolor "
    "metallic, solved for the channels' means; F0 of another hue, or below that of dielectrics, is held by specular "
    "alone",
}
BLENDER_DEFAULT_F0 = 0.04  # of Blender's default index of refraction, 1.5, at a Specular IOR Level of 0.5
BLENDER_SOCKET_MAPS = {
    "BaseColor": "basecolor",
    "Metallic": "metallic",
    "Specular": "level",
    "Roughness": "roughness",
    "Normal": "normal_gl",
    "Displacement": "height",
    "AO": "ao",
}
HIGH_PRECISION_MAPS = ("normal_gl", "height")  # EXR files hold these in single, others in half precision


def write_surface_maps(
    surface_maps: Mapping[str, SurfaceMap], path: Path, bits: int = 16
) -> dict[str, dict[str, object]]:
    """Write maps as PNG, <path>/<name>_<map>.png; `name` is the last part of `path`.

    Returns:
        For each file name a description: the encoding and the meaning; for heights also how integers become widths.
    """
    files = {key: path / f"{path.name}_{key}.png" for key in surface_maps}
    return {file.name: write_surface_map(surface_maps[key], file, bits) for key, file in files.items()}


def write_surface_map(surface_map: SurfaceMap, file: Path, bits: int) -> dict[str, object]:
    """Write one map as PNG, encoded as its attribute `encoding` says.

    Returns:
        The description of the file: colour space, channels, bits, meaning; for heights also offset, scale and unit.
    """
    encoding, values = "linear", surface_map.values
    description: dict[str, object] = {"channels": len(values), "bits": bits, "meaning": surface_map.meaning}
    if surface_map.encoding == "srgb":
        encoding, values = "sRGB", linear_to_srgb(values.clamp(0, 1))
    texts = {"encoding": encoding}
    if surface_map.encoding == "stretched":
        values, low, high = stretch_to_unit_range(values)
        description |= {"offset": low, "scale": high - low, "unit": "texture widths"}
        texts |= {"offset": f"{low:.9g}", "scale": f"{high - low:.9g}"}
    image_writers.write_png(values.movedim(0, -1), texts, file, bits)
    return {"colour_space": encoding} | description


def render_preview(surface: Surface | Texture) -> Tensor:
    """Render display values [3, h, w]: a texture as it is, a material under a light from the left."""
    scale = min(1.0, PREVIEW_LONGER_SIDE_PX / max(surface.size))
    size = [max(1, math.floor(side * scale)) for side in surface.size]
    if isinstance(surface, Texture):
        return linear_to_srgb(_resize(surface.colour, size).clamp(0, 1))
    dtype = surface.maps.diffuse.dtype
    light, view = relighting_positions(dtype=dtype)["left"]
    positions = texel_positions(*surface.size, dtype=dtype)
    radiance = render_maps(Maps(*(part[None] for part in surface.maps)), positions, light, view)[0]
    return radiance_to_display(_resize(radiance, size))


def _resize(picture: Tensor, size: list[int]) -> Tensor:
    return interpolate(picture[None], size=size, mode="area")[0]


def write_asset(surface: Surface | Texture, path: Path, provenance: Mapping[str, object]) -> None:
    """Write the asset folder `path`; `material.json` is written last."""
    files = write_surface_maps(all_surface_maps(surface), path)
    image_writers.write_png(render_preview(surface).movedim(0, -1), {"encoding": "sRGB"}, path / "preview.png")
    write_description(surface, path, files, provenance)


def write_description(
    surface: Surface | Texture, path: Path, files: Mapping[str, Mapping[str, object]], provenance: Mapping[str, object]
) -> None:
    """Write `material.json`, which describes a surface and its files; numbers that are not finite become null."""
    height, width = surface.size
    document = {
        "schema": 1,
        "name": path.name,
        "kind": "texture" if isinstance(surface, Texture) else "material",
        "size": {"width": width, "height": height, "unit": "px"},
        "real_world_size": None,  # the width in metres, which a photograph alone does not tell
        "tiles": surface.tiles,
        "colour_primaries": "Rec. 709",
        **({} if isinstance(surface, Texture) else {"workflows": WORKFLOW_DESCRIPTIONS}),
        "files": dict(files),
        "provenance": dict(provenance),
    }
    text = json.dumps(to_json_value(document), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    write_bytes(path / DESCRIPTION_FILE, text.encode())


def write_blender(surface: Surface, path: Path, provenance: Mapping[str, object]) -> None:
    """Write <path>/<name>_<socket>.png for each socket of a Principled BSDF, and <path>/material.json."""
    surface_maps = all_surface_maps(surface)
    surface_maps["level"] = SurfaceMap(
        specular_level(surface, surface_maps),
        "linear",
        "Specular IOR Level: F0 / 0.08 of the share that is not metallic",
    )
    files = write_surface_maps({socket: surface_maps[key] for socket, key in BLENDER_SOCKET_MAPS.items()}, path)
    write_description(surface, path, files, provenance)


def specular_level(surface: Surface, planes: Mapping[str, SurfaceMap]) -> Tensor:
    """Return the Specular IOR Level at which the dielectric share makes up the rest of the mean F0.

    Args:
        surface: the fitted material.
        planes: its maps by name, with `metallic` [1, H, W] and `basecolor` [3, H, W].

    Returns:
        The level, [1, H, W] in [0, 1]; 0.5 where the surface is wholly metallic.
    """
    metallic, base = planes["metallic"].values, planes["basecolor"].values
    missing_f0 = (surface.maps.specular - base * metallic).mean(0, keepdim=True)
    level = missing_f0 / (1 - metallic).clamp_min(1e-6) * (0.5 / BLENDER_DEFAULT_F0)
    return torch.where(metallic < 1, level.clamp(0, 1), 0.5)


def write_exr(surface: Surface | Texture, path: Path, provenance: Mapping[str, object]) -> None:
    """Write the fitted maps, or the colour of a texture, as <path>/<name>_<map>.exr; heights are in texture widths."""
    for key, surface_map in fitted_surface_maps(surface).items():
        file = path / f"{path.name}_{key}.exr"
        image_writers.write_exr(surface_map.values.movedim(0, -1), file, half=key not in HIGH_PRECISION_MAPS)


def write_png16(surface: Surface | Texture, path: Path, provenance: Mapping[str, object]) -> None:
    """Write the fitted maps, or the colour of a texture, as PNG of 16 bits, <path>/<name>_<map>.png."""
    write_surface_maps(fitted_surface_maps(surface), path)


def describe_provenance(provenance: Mapping[str, object]) -> str:
    """Return how a fit was made in a few words: application, paradigm, rule, checkpoint, recipe."""
    keys = ("app", "paradigm", "rule", "checkpoint", "recipe")
    return ", ".join(f"{key} {provenance[key]}" for key in keys if key in provenance)


def fill_in_name(document: ET.Element, name: str) -> ET.Element:
    """Replace NAME by a name in all attributes of an XML document, and return the document."""
    for element in document.iter():
        for key, value in element.items():
            element.set(key, value.replace("NAME", name))
    return document
