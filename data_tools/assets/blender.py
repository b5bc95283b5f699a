"""Blender: PNG of 16 bits under the names that Node Wrangler wires to a Principled BSDF, and `material.json`.

Select a Principled BSDF, press Ctrl+Shift+T and choose all pictures of the folder. Node Wrangler knows the metallic
workflow; the Specular IOR Level, gray, holds what that leaves of F0, up to 0.08. Where F0 has a hue of its own, import
the glTF file instead: its F0 is exact.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor

from data_tools.assets.asset import description, write_description
from data_tools.assets.pictures import write_plane
from metapp.appearance.surface import DESCRIPTION, Plane, Surface, all_planes

HALF = 0.04  # F0 of Blender's default index of refraction, 1.5, at a level of 0.5
WIRED = {
    "BaseColor": "basecolor",
    "Metallic": "metallic",
    "Specular": "level",
    "Roughness": "roughness",
    "Normal": "normal_gl",
    "Displacement": "height",
    "AO": "ao",
}


def write(surface: Surface, path: Path, provenance: Mapping[str, object]) -> None:
    """Write <path>/<name>_<socket>.png and <path>/material.json."""
    planes = all_planes(surface)
    planes["level"] = Plane(
        specular_level(surface, planes), "linear", "Specular IOR Level; F0 / 0.08 of what no metal is"
    )
    files = {}
    for socket, key in WIRED.items():
        file = path / f"{path.name}_{socket}.png"
        files[file.name] = write_plane(planes[key], file, 16, stretch=key == "height")
    write_description(path / DESCRIPTION, description(surface, path.name, files, provenance))


def specular_level(surface: Surface, planes: Mapping[str, Plane]) -> Tensor:
    """The level [1, H, W] at which what is no metal makes up the rest of the mean F0; 0.5 of pure metals."""
    assert surface.maps is not None
    metallic, base = planes["metallic"].values, planes["basecolor"].values
    missing = (surface.maps.specular - base * metallic).mean(0, keepdim=True)
    level = missing / (1 - metallic).clamp_min(1e-6) * (0.5 / HALF)
    return torch.where(metallic < 1, level.clamp(0, 1), 0.5)
