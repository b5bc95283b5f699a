"""Flash photographs of flat materials, of which several may show one material."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

from data_tools.formats import AUTO, Conversion, Files, Format, Reader, Setting
from data_tools.formats.images import SIZE

if TYPE_CHECKING:
    from metapp.learning.task import Task

HELP = """Convert flash photographs of flat materials.

Of each the central square is taken, where the flash is, upright, scaled in linear light to --size, and kept as
8-bit sRGB. Fits take the camera for one of 45 degrees along the shorter side: of a wider one, as EXIF or --fov tells,
only the part within 45 degrees is taken. All photographs of a material belong to one split. A bad file that was
named ends the conversion and nothing is written; one found in a folder is skipped with a warning.

The material is told by <split>_<material>_<image>.jpg, by <split>/<material>/<image>.jpg (Henzler et al. 2021),
or by <material>/<image>.jpg below the folder; any other photograph is of a material of its own.

Examples:
  metapp data flash flash_images --out flash
  metapp data flash wood.jpg tiles.jpg --split test --out flash
"""
SPLIT = (
    "Where the tasks belong. auto: as names or folders say (train, test), if they say both; else of the sorted "
    "materials every fifth is for tests."
)
FOV = Setting(
    "fov",
    0.0,
    "The camera's field of view along the shorter side; 0: as EXIF says, else 45.",
    "DEGREES",
    low=0.0,
    high=150.0,
)


def _files() -> Files:
    from data_tools.readers import flash

    return flash


def _reader(paths: list[Path], split: str, *, size: int, fov: float) -> Reader:
    from data_tools.readers import flash

    photos = flash.find_shown(paths)
    splits = flash.split_by_material(photos) if split == AUTO else {}

    def name(source: Path) -> str:
        return photos[source.resolve()].name

    def read(source: Path) -> Task:
        return flash.read_task(source, size, math.radians(fov))._replace(
            name=name(source), group=photos[source.resolve()].material
        )

    def split_of(source: Path) -> str:
        return splits[source.resolve()]

    notes = {"made_by": "metapp data flash", "size": size, **({"fov": fov} if fov else {})}
    return Reader("svbrdf_stationary", "photograph", flash.UNITS, flash.find, name, read, notes, split_of)


FORMAT = Format(
    "flash",
    "svbrdf_stationary",
    "flash photos",
    _files,
    conversion=Conversion(
        HELP, _reader, ("FILES...", "Photographs, and folders searched at any depth."), (SIZE, FOV), SPLIT
    ),
    takes_fov=True,
)
