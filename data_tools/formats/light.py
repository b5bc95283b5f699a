"""Formats of environment maps."""

from __future__ import annotations

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
    InMemory("illumination", "data_tools.readers.picture_objects:light"),
)
