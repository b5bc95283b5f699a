"""Formats of environment maps and of scenes."""

from __future__ import annotations

from pathlib import Path

from data_tools.formats.options import FOV_OF_FITS
from metapp.door import Converter, Format, InMemory, Option

ROWS = Option("size", 64, "Rows of the maps; the recipe full fits 128.", metavar="ROWS", low=32, high=1024)

LAVAL = """Convert HDR environment maps, such as those of the Laval indoor set.

Any lat-long map (Gardner et al. 2017 publish 2048 x 1024 EXR) with floating-point RGB or gray pixels. It becomes
linear Rec.709 of 64 x 128 texels (--size), averaged over solid angle, of mean luminance 1 beside the scale it had, and
four photographs of spheres under it. A bad file that was named ends the conversion and nothing is written; one found
in a folder is skipped with a warning.

Examples:
  metapp data laval IndoorHDR --out laval
  metapp data laval office.exr street.hdr --split test --out maps
"""

FOV = FOV_OF_FITS._replace(
    help="Camera field of view along the shorter side; default: from EXIF, else a distant camera."
)


def folders(paths: tuple[Path, ...]) -> tuple[Path, ...]:
    """The same paths; ValueError unless all are folders."""
    if not all(path.is_dir() for path in paths):
        raise ValueError("not there, expected folders")
    return paths


ROOTS = Option(
    "scene_root",
    None,
    "Additional folder from which a scene may load files; may be given several times.",
    "DIR",
    several=True,
    convert=folders,
    passed_as="roots",
)
OFFERS = (
    Format(
        "laval",
        "illumination",
        "data_tools.balls.reading",
        "HDR maps (.exr, .hdr) or LDR photos of a ball",
        takes=("size",),
        options=(FOV,),
        command=Converter(
            LAVAL, "map", "FILES...", "HDR maps (.exr, .hdr), and folders searched at any depth.", (ROWS,)
        ),
    ),
    Format(
        "mitsuba",
        "transport",
        "data_tools.readers.mitsuba_scenes",
        "Mitsuba scenes (.xml, .json) with a perspective camera",
        options=(ROOTS,),
    ),
    InMemory("illumination", "data_tools.readers.picture_objects:light"),
    InMemory("transport", "data_tools.readers.mitsuba_scenes:from_object"),
)
