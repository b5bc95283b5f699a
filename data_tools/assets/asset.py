"""The asset folder: all maps of a surface as PNG of 16 bits, a preview, and `material.json`, which says what they are.

    <name>_basecolor.png  <name>_diffuse.png  <name>_specular.png  <name>_metallic.png  <name>_roughness.png
    <name>_normal_gl.png  <name>_normal_dx.png  <name>_height.png  <name>_ao.png  <name>_orm.png
    preview.png  material.json

A texture has a base colour alone. What wants one workflow takes its files: `diffuse` and `specular` hold what was
fitted; `basecolor` and `metallic` are the nearest material of the metallic-roughness workflow.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from data_tools.assets.pictures import preview, write_planes
from metapp.appearance.surface import DESCRIPTION, DIELECTRIC, Surface, all_planes
from metapp.storage.files import write_atomically
from metapp.storage.images import write_png
from metapp.storage.records import finite

SCHEMA = 1
WORKFLOWS = {
    "specular": "diffuse and specular are what was fitted: f = diffuse (1 - F0) / pi + D F G / (4 cos_i cos_o), GGX, "
    "separable Smith, Schlick's Fresnel from F0",
    "metallic-roughness": f"diffuse = basecolor (1 - metallic), F0 = {DIELECTRIC} (1 - metallic) + basecolor metallic, "
    "solved for the channels' means; F0 of another hue, or below that of dielectrics, is held by specular alone",
}


def write(surface: Surface, path: Path, provenance: Mapping[str, object]) -> None:
    """Write the asset folder `path`; `material.json` comes last."""
    files = write_planes(all_planes(surface), path)
    write_png(preview(surface).movedim(0, -1), {"encoding": "sRGB"}, path / "preview.png")
    write_description(path / DESCRIPTION, description(surface, path.name, files, provenance))


def description(
    surface: Surface, name: str, files: Mapping[str, Mapping[str, object]], provenance: Mapping[str, object]
) -> dict[str, object]:
    """What `material.json` says of a surface and its files."""
    height, width = surface.size
    return {
        "schema": SCHEMA,
        "name": name,
        "kind": "texture" if surface.maps is None else "material",
        "size": {"width": width, "height": height, "unit": "px"},
        "real_world_size": None,  # of the width, in metres: a photograph alone does not tell
        "tiles": surface.tiles,
        "colour_primaries": "Rec. 709",
        **({} if surface.maps is None else {"workflows": WORKFLOWS}),
        "files": dict(files),
        "provenance": dict(provenance),
    }


def write_description(file: Path, document: Mapping[str, object]) -> None:
    """Write a JSON document; numbers that are not finite, which JSON lacks, become null."""
    text = json.dumps(finite(document), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    write_atomically(file, lambda target: target.write_text(text, encoding="utf-8"))
