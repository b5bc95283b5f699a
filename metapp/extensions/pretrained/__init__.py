"""General of flash photos over frozen features of VGG-16, and real materials to train it on."""

from __future__ import annotations

from dataclasses import dataclass

from data_tools.formats.pictures import MAPS_SPLIT, MapsOptions, Size
from metapp.door import Chosen, Converter, Format, Recipe

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


OFFERS = (
    Recipe(
        "svbrdf_nonstationary",
        "pretrained",
        f"{_HERE}.recipe:PRETRAINED",
        "photo",
        Chosen(
            ("svbrdf",),
            has="one flash photo",
            tensor="photo",
            without="places",
            paradigms=("general", "quickft", "meta"),
            lacks=f"{_HERE}.encoder:lacks",
        ),
        f"{_HERE}.checkpoints",
    ),
    Format(
        "materials",
        "svbrdf_nonstationary",
        f"{_HERE}.materials",
        command=Converter(
            MATERIALS,
            "material",
            "FOLDERS...",
            "Folders of maps, searched at any depth, and data sets.",
            MaterialsOptions,
            MAPS_SPLIT,
        ),
    ),
)
