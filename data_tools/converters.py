"""The commands of `metapp data` that convert files: the help and the options of each format.

Readers of the formats are looked up by name, so nothing here reads a file or imports torch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typing_extensions import override

from metapp.apps.picture_options import LayerOption, parse_field_of_view
from metapp.options import Converter, Option, split_option

SamplesOption = Annotated[
    int,
    Option("Samples (pairs of directions) per material; the first half is for fits to see.", low=2, high=10**7),
]
SizeOption = Annotated[int, Option("Side of the pictures.", "PX", low=32, high=4096)]
NormalsOption = Annotated[
    str,
    Option(
        "Where the green of normals points: up (opengl) or down (directx). auto: as names say (gl, dx), else as "
        "would fit a height field.",
        "opengl|directx|auto",
        choices=("opengl", "directx", "auto"),
    ),
]


@dataclass(frozen=True)
class MerlConverter(Converter):
    """Convert MERL tables of measured BRDFs.

    A table (Matusik et al. 2003) has 34,992,012 bytes. It becomes samples (angles in rad, reflectance in 1/sr, linear
    RGB) at the centres of measured bins. A bad file that you name ends the conversion, and nothing is written; one
    found in a folder is skipped with a warning.

    Examples:
      metapp data merl BRDFDatabase/brdfs --out merl
      metapp data merl gold.binary steel.binary --split test --out metals
    """

    samples: SamplesOption = 65_536


@dataclass(frozen=True)
class NbrdfConverter(Converter):
    """Convert NBRDF networks, which are BRDFs as small neural networks.

    A network (Sztrajman et al. 2021) is a Keras model as published, gold.h5 (which needs h5py: pip install
    "metapp[nbrdf]"), or a folder with fc1.npy, fc2.npy, fc3.npy, b1.npy, b2.npy, b3.npy. It becomes samples (angles in
    rad, reflectance in 1/sr, linear RGB) above the horizon, named by its file or folder. Several networks may share a
    folder if the name of each is in front of its files: gold_fc1.npy. A folder without a usable network ends the
    conversion, and nothing is written; other bad networks are skipped with a warning.

    Examples:
      metapp data nbrdf trained --out nbrdf
      metapp data nbrdf trained/gold trained/tin.h5 --split test --out metals
    """

    samples: SamplesOption = 65_536


@dataclass(frozen=True)
class GonioConverter(Converter):
    """Convert goniometer measurements of BRDFs, in CSV files.

    A file has a line of column names, then a row for each pair of directions: theta_i_deg, phi_i_deg (light),
    theta_o_deg, phi_o_deg (detector), or _rad for radians, and the BRDF in 1/sr as r, g, b (linear RGB) or as
    wavelengths (400nm, 410nm, ...). A theta is from the normal, and a negative one means the opposite side, phi + 180
    degrees; elevation_i and elevation_o are from the surface. In place of phi_o may stand phi, from the light, or
    phi_mirror, from the mirror direction; phi_i may then be left out. Or a file has half and difference angles,
    theta_h, theta_d, phi_d and perhaps phi_h. Other words for them are read, too: zenith, azimuth, altitude, el; in,
    incident, light, out, view, detector. Semicolons, tabs, quotes, decimal commas, a row of units and UTF-16, as
    spreadsheets write, are read as well. Values a little below 0 are noise and become 0. Lines that begin with # are
    comments. The measurements themselves become the samples, in random order. A bad file that you name ends the
    conversion, and nothing is written; one found in a folder is skipped with a warning.

    Examples:
      metapp data gonio paint.csv --out measured
      metapp data gonio measurements --split test --out measured
    """


@dataclass(frozen=True)
class ImagesConverter(Converter):
    """Convert photographs of textures.

    All formats of OpenImageIO are read: JPEG, PNG, TIFF, EXR and more. The central square of each photograph is taken,
    upright, scaled in linear light to --size, and kept as 8-bit sRGB. A bad file that you name ends the conversion,
    and nothing is written; one found in a folder is skipped with a warning.

    Examples:
      metapp data images photographs --out textures
      metapp data images bark.jpg sand.png --split test --size 512 --out textures
    """

    size: SizeOption = 256
    layer: LayerOption = ""


@dataclass(frozen=True)
class FlashConverter(Converter):
    """Convert flash photographs of flat materials.

    The central square of each photograph is taken, around the flash, upright, scaled in linear light to --size, and
    kept as 8-bit sRGB. Fits assume a field of view of 45 degrees along the shorter side: if EXIF or --fov says that
    the camera's is wider, only the part within 45 degrees is taken. All photographs of a material belong to one split.
    A bad file that you name ends the conversion, and nothing is written; one found in a folder is skipped with a
    warning.

    Names tell the material: <split>_<material>_<image>.jpg, <split>/<material>/<image>.jpg (Henzler et al. 2021), or
    <material>/<image>.jpg below the folder. A photograph with another name counts as a material of its own.

    Examples:
      metapp data flash flash_images --out flash
      metapp data flash wood.jpg tiles.jpg --split test --out flash
    """

    split: Annotated[
        str,
        split_option(
            "as names or folders say (train, test), if both words occur; else every fifth of the sorted materials is a "
            "test task."
        ),
    ] = "auto"
    size: SizeOption = 256
    fov: Annotated[
        float,
        Option(
            "The camera's field of view along the shorter side; 0 takes EXIF's, else 45.",
            "DEGREES",
            low=0.0,
            high=150.0,
            parse=parse_field_of_view,
        ),
    ] = 0.0
    layer: LayerOption = ""

    @override
    def arguments(self) -> dict[str, object]:
        """Return the options as keyword arguments of the format's `read_task`, the field of view in rad."""
        return {"size": self.size, "fov_rad": math.radians(self.fov), "layer": self.layer}


@dataclass(frozen=True)
class MapsConverter(Converter):
    """Convert materials whose maps are separate images, such as rock_diffuse.png beside rock_normal.png.

    A material has a base colour (diffuse, albedo, basecolor, color), a normal, and a roughness or gloss map, and may
    have a specular or metallic one, in any case and format, also packed (arm, orm, metallicRoughness). Variants
    (COL_VAR1) and tiles (1001) are materials of their own. The central square of each map is scaled to --size, and the
    photograph under a flash is rendered. A bad material is skipped with a warning. A colour map whose name has no such
    word (rock.png beside rock_norm.png and rock_gloss.png) is taken for an old game's; its gloss becomes a roughness.

    Examples:
      metapp data maps materials --out svbrdf
      metapp data maps materials/rock --normals directx --split test --out rock
    """

    split: Annotated[
        str,
        split_option(
            "every fifth of the sorted names is a test task; variants with the same normal map stay together."
        ),
    ] = "auto"
    size: SizeOption = 256
    normals: NormalsOption = "auto"
    layer: LayerOption = ""


@dataclass(frozen=True)
class MaterialsConverter(MapsConverter):
    """Convert real materials for training, with synthetic ones beside them.

    Maps are read as `metapp data maps` reads them, but a material may lack its roughness: then one is made up, and
    does not count in losses. A material with a specular but no roughness map is taken for an old game's; its colours
    have shading in them, and count less. Maps smaller than --size are repeated, as they tile. Folders of data sets,
    such as `metapp data synth svbrdf_nonstationary --size 512` writes, hold synthetic materials; the recipe pretrained
    sees as many of these as of real ones, whatever their numbers. Training crops maps, so give 512 px or more.

    Examples:
      metapp data materials scans drawn --split train --out mixed
      metapp data materials scans/rock scans/bark games --size 512 --out real
    """

    size: SizeOption = 512


@dataclass(frozen=True)
class DomesConverter(MapsConverter):
    """Photograph real materials by a camera that stands still under many lamps (RTI), for training.

    Maps are read as `metapp data materials` reads them. The relief of a material, laid over waves and raised figures,
    is rendered with its shadows and interreflections by Mitsuba: 10 s a material on one core.

    Examples:
      metapp data domes scans --split train --out domes
      metapp data domes scans/rock scans/bark --lamps 48 --size 128 --out few
    """

    size: Annotated[int, Option("Side of the photographs.", "PX", low=32, high=512)] = 96
    lamps: Annotated[int, Option("Lamps, from 8 degrees above the material upwards.", low=4, high=500)] = 80


def _parse_folder(path: Path) -> Path:
    """Return a path that is a folder, or raise ValueError."""
    if not path.is_dir():
        raise ValueError("no such folder, expected one of predicted maps")
    return path


@dataclass(frozen=True)
class StripsConverter(Converter):
    """Convert strips, images of five squares: flash photograph, normal, diffuse, roughness, specular.

    All squares but the normals are linear, and normals have y up, as Deschaintre et al. 2018 publish them. A bad file
    that you name ends the conversion, and nothing is written; one found in a folder is skipped with a warning. Names
    tell the base materials: <number>;<material>X<material>;<preset>X<preset>.png; a strip with another name counts as
    a material of its own. The 48 strips of `make real-svbrdf` blend three of them: their split is by presets.

    Examples:
      metapp data strips DeepMaterialsData/trainBlended --split train --out svbrdf
      metapp data strips strips --gamma 2.2 --white 1 --split test --out svbrdf
      metapp data strips strips --predicted maps --split test --out svbrdf
    """

    split: Annotated[
        str,
        split_option("every fifth group of strips that share no base material with others is for tests."),
    ] = "auto"
    size: SizeOption = 256
    gamma: Annotated[
        float, Option("Gamma that all squares but the normals are encoded with; 1 is linear.", "G", low=0.1, high=10)
    ] = 1.0
    white: Annotated[
        float,
        Option(
            "Radiance of white right below the flash, where 1 clips; by default as measured on published strips.",
            "W",
            low=0.01,
            high=100,
        ),
    ] = 1.35
    predicted: Annotated[
        Path | None,
        Option(
            "Maps by another method, <number>_N.png, _D, _R and _S (colours at gamma 2.2), for the table of baselines; "
            "if they show only the middle of strips, so do the tasks.",
            "FOLDER",
            parse=_parse_folder,
        ),
    ] = None
    layer: LayerOption = ""


@dataclass(frozen=True)
class LavalConverter(Converter):
    """Convert HDR environment maps, such as the Laval indoor set.

    A map is lat-long, with floating-point RGB or gray pixels (Gardner et al. 2017 publish 2048 x 1024 EXR). It becomes
    linear Rec.709 of 64 x 128 texels (--rows), averaged over solid angle, of mean luminance 1; the luminance it had is
    kept beside it, and four photographs of spheres under it are rendered. A bad file that you name ends the
    conversion, and nothing is written; one found in a folder is skipped with a warning.

    Examples:
      metapp data laval IndoorHDR --out laval
      metapp data laval office.exr street.hdr --split test --out maps
    """

    rows: Annotated[int, Option("Rows of the maps; the recipe full fits 128.", low=32, high=1024)] = 64
    layer: LayerOption = ""
