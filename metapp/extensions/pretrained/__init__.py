"""General of flash photos over frozen features of VGG-16, and real materials to train it on."""

from __future__ import annotations

from dataclasses import dataclass

from data_tools.formats.pictures import MAPS_SPLIT, MapsOptions, Size
from metapp.registry import Format, Recipe, Registry

_HERE = "metapp.extensions.pretrained"

MATERIALS = """Convert real materials for training, with drawn ones beside them.

As `metapp data maps`, but a set may lack its roughness: one is made up, and losses of what is made up count nothing.
A specular map without a roughness is an old game's, with shading in its colours, which count less. Maps that are
smaller than --size are repeated, as such sets tile. Folders of data sets, as of `metapp data synth svbrdf_nonstationary
--size 512`, are drawn materials; of these and of real ones the recipe pretrained sees as many, whatever their numbers.
Give maps room for crops: 512 px or more.

Examples:
  metapp data materials scans drawn --split train --out mixed
  metapp data materials scans/rock scans/bark games --size 512 --out real
"""


@dataclass(frozen=True)
class MaterialsOptions(MapsOptions):
    """Options of conversions of real materials."""

    size: Size = 512


def register(registry: Registry) -> None:
    """Add the recipe of one photo, and the files of real materials."""
    registry.recipes["svbrdf_nonstationary", "photo", "pretrained"] = Recipe(
        f"{_HERE}.recipe:PRETRAINED",
        help="one flash photo",
        kind="photo",
        paradigms=("general", "quickft", "meta"),
        lacks=f"{_HERE}.encoder:lacks",
        checkpoints=f"{_HERE}.checkpoints",
    )
    registry.formats["materials"] = Format(
        f"{_HERE}.materials",
        app="svbrdf_nonstationary",
        help=MATERIALS,
        options=MaterialsOptions,
        split_help=MAPS_SPLIT,
    )
