"""Materials whose maps are separate images."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from data_tools.formats import Conversion, Files, Format, Reader, Setting
from data_tools.formats.images import SIZE

if TYPE_CHECKING:
    from metapp.learning.task import Task

HELP = """Convert materials whose maps are separate images, such as rock_diffuse.png beside rock_normal.png.

Base colour (diffuse, albedo, basecolor, color), normal, roughness or gloss, and, where there are any, specular or
metallic; any case and format. Colours of 8 or 16 bit are sRGB. Of each map the central square is taken, scaled to
--size, and the photograph under a flash is rendered. A bad material is skipped with a warning.

A colour without such a word, rock.png beside rock_norm.png and rock_gloss.png, is an old game's: its gloss is how
strongly a highlight shines, which is converted to a roughness.

Examples:
  metapp data maps materials --out svbrdf
  metapp data maps materials/rock --normals directx --split test --out rock
"""
SPLIT = (
    "Where the tasks belong. auto: of the sorted names, every fifth is a test task; variants with the same normal map "
    "stay together."
)
NORMALS = Setting(
    "normals",
    "auto",
    "Where the green of normals points: up (opengl) or down (directx). auto: as names say (gl, dx), else as a height "
    "field could have it.",
    choices=("opengl", "directx", "auto"),
)


def _files() -> Files:
    from data_tools.readers import material_maps

    return material_maps


def _reader(paths: list[Path], split: str, *, size: int, normals: str) -> Reader:
    from data_tools.readers import material_maps

    materials = {each.source.resolve(): each for each in material_maps.find_materials(paths)[0]}
    sides = material_maps.split_materials(materials.values())

    def name(source: Path) -> str:
        return material_maps.task_name(materials[source.resolve()].title)

    def read(source: Path) -> Task:
        return material_maps.read_task(source, size, normals)._replace(group=sides[source.resolve()][1])

    def split_of(source: Path) -> str:
        return sides[source.resolve()][0]

    notes = {"made_by": "metapp data maps", "size": size, "normals": normals}
    units, find = material_maps.UNITS, material_maps.find
    return Reader("svbrdf_nonstationary", "material", units, find, name, read, notes, split_of)


FORMAT = Format(
    "maps",
    "svbrdf_nonstationary",
    "",  # `svbrdf` takes them
    _files,
    conversion=Conversion(
        HELP, _reader, ("FOLDERS...", "Folders of maps, searched at any depth."), (SIZE, NORMALS), SPLIT
    ),
)
