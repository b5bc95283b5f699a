"""Formats of photographs and of maps of materials."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from metapp.networks.options import field_of_view
from metapp.options import Option
from metapp.registry import Entry, Format, Registry

Size = Annotated[int, Option("Side of the pictures.", "PX", low=32, high=4096)]
Normals = Annotated[
    str,
    Option(
        "Where the green of normals points: up (opengl) or down (directx). auto: as names say (gl, dx), else as a "
        "height field could have it.",
        "opengl|directx|auto",
        choices=("opengl", "directx", "auto"),
    ),
]


@dataclass(frozen=True)
class ImageOptions:
    """Options of conversions of photographs."""

    size: Size = 256


@dataclass(frozen=True)
class FlashOptions(ImageOptions):
    """Options of conversions of flash photographs."""

    fov_rad: Annotated[
        float,
        Option(
            "The camera's field of view along the shorter side; 0: as EXIF says, else 45.",
            "DEGREES",
            low=0.0,
            high=150.0,
            parse=lambda degrees: math.radians(field_of_view(degrees)),
            flags=("--fov",),
        ),
    ] = 0.0


@dataclass(frozen=True)
class MapsOptions(ImageOptions):
    """Options of conversions of maps."""

    normals: Normals = "auto"


def _folder(path: Path) -> Path:
    if not path.is_dir():
        raise ValueError("no such folder, expected one of predicted maps")
    return path


@dataclass(frozen=True)
class StripsOptions(ImageOptions):
    """Options of conversions of strips."""

    gamma: Annotated[float, Option("Encoding of all tiles but the normals; 1 is linear.", "G", low=0.1, high=10)] = 1.0
    white: Annotated[
        float,
        Option(
            "How bright white would be right below the flash, where 1 clips; that of the published ones by default.",
            "W",
            low=0.01,
            high=100,
        ),
    ] = 1.35
    predicted: Annotated[
        Path | None,
        Option(
            "Maps by another method, <number>_N.png, _D, _R and _S (colours at gamma 2.2), for the table of baselines; "
            "where they show the middle alone, so do the tasks.",
            "FOLDER",
            parse=_folder,
        ),
    ] = None


IMAGES = """Convert photographs of textures.

Any format of OpenImageIO: JPEG, PNG, TIFF, EXR and more. Of each the central square is taken, upright, scaled in
linear light to --size, and kept as 8-bit sRGB. A bad file that was named ends the conversion and nothing is
written; one found in a folder is skipped with a warning.

Examples:
  metapp data images photographs --out textures
  metapp data images bark.jpg sand.png --split test --size 512 --out textures
"""
FLASH = """Convert flash photographs of flat materials.

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
FLASH_SPLIT = (
    "Where the tasks belong. auto: as names or folders say (train, test), if they say both; else of the sorted "
    "materials every fifth is for tests."
)

MAPS = """Convert materials whose maps are separate images, such as rock_diffuse.png beside rock_normal.png.

Base colour (diffuse, albedo, basecolor, color), normal, roughness or gloss, and, where there are any, specular or
metallic; any case and format. Colours of 8 or 16 bit are sRGB. Of each map the central square is taken, scaled to
--size, and the photograph under a flash is rendered. A bad material is skipped with a warning.

A colour without such a word, rock.png beside rock_norm.png and rock_gloss.png, is an old game's: its gloss is how
strongly a highlight shines, which is converted to a roughness.

Examples:
  metapp data maps materials --out svbrdf
  metapp data maps materials/rock --normals directx --split test --out rock
"""
MAPS_SPLIT = (
    "Where the tasks belong. auto: of the sorted names, every fifth is a test task; variants with the same normal map "
    "stay together."
)

STRIPS = """Convert strips, images of five squares: flash photograph, normal, diffuse, roughness, specular.

As Deschaintre et al. 2018 publish theirs: linear, normals with y up. A bad file that was named ends the conversion
and nothing is written; one found in a folder is skipped with a warning. Base materials are told by
<number>;<material>X<material>;<preset>X<preset>.png; any other strip is of a material of its own. Where base
materials cannot be parted, since all are blended with all, their presets are.

Examples:
  metapp data strips DeepMaterialsData/trainBlended --out svbrdf
  metapp data strips strips --gamma 2.2 --white 1 --split test --out svbrdf
  metapp data strips strips --predicted maps --split test --out svbrdf
"""
STRIPS_SPLIT = (
    "Where the tasks belong. auto: no base material on both sides, a fifth or more for tests; blends of both sides "
    "are left out."
)


def register(registry: Registry) -> None:
    """Add photographs, materials' maps and strips, and objects of programs."""
    registry.formats["flash"] = Format(
        "data_tools.readers.flash",
        app="svbrdf_stationary",
        inputs="flash photos",
        takes=("size", "least", "fov_rad"),
        help=FLASH,
        options=FlashOptions,
        split_help=FLASH_SPLIT,
    )
    registry.formats["images"] = Format(
        "data_tools.readers.photos",
        app="texture",
        inputs="images",
        takes=("size", "least"),
        help=IMAGES,
        options=ImageOptions,
    )
    registry.formats["maps"] = Format(
        "data_tools.readers.material_maps",
        app="svbrdf_nonstationary",  # as INPUT `svbrdf` takes them
        help=MAPS,
        options=MapsOptions,
        split_help=MAPS_SPLIT,
    )
    registry.formats["strips"] = Format(
        "data_tools.readers.strips",
        app="svbrdf_nonstationary",  # as INPUT `svbrdf` takes them
        help=STRIPS,
        options=StripsOptions,
        split_help=STRIPS_SPLIT,
    )
    registry.formats["svbrdf"] = Format(
        "data_tools.readers.svbrdf_inputs",
        app="svbrdf_nonstationary",
        inputs="flash photos, strips, a material's maps",
        takes=("size", "fov_rad", "stops"),
        kinds=(("photo", ""),),
    )
    registry.objects["texture"] = Entry("data_tools.readers.picture_objects:texture")
    registry.objects["svbrdf_stationary"] = Entry("data_tools.readers.picture_objects:flash_photo")
    registry.objects["svbrdf_nonstationary"] = Entry("data_tools.readers.picture_objects:material")
