"""Flash photographs of flat materials, of which several may show one material."""

from __future__ import annotations

from data_tools.formats import Format, Setting
from data_tools.formats.images import SIZE

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

FORMAT = Format(
    "flash",
    "svbrdf_stationary",
    "data_tools.readers.flash",
    "flash photos",
    takes=("fov_rad",),
    noun="photograph",
    help=HELP,
    paths=("FILES...", "Photographs, and folders searched at any depth."),
    settings=(SIZE, FOV),
    split_help=SPLIT,
)
