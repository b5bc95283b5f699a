"""Formats of environment maps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from metapp.options import Option
from metapp.registry import Entry, Format, Registry


@dataclass(frozen=True)
class LavalOptions:
    """Options of conversions of environment maps."""

    rows: Annotated[int, Option("Rows of the maps; the recipe full fits 128.", "N", low=32, high=1024)] = 64


LAVAL = """Convert HDR environment maps, such as those of the Laval indoor set.

Any lat-long map (Gardner et al. 2017 publish 2048 x 1024 EXR) with floating-point RGB or gray pixels. It becomes
linear Rec.709 of 64 x 128 texels (--rows), averaged over solid angle, of mean luminance 1 beside the scale it had, and
four photographs of spheres under it. A bad file that was named ends the conversion and nothing is written; one found
in a folder is skipped with a warning.

Examples:
  metapp data laval IndoorHDR --out laval
  metapp data laval office.exr street.hdr --split test --out maps
"""


def register(registry: Registry) -> None:
    """Add HDR maps, and objects of programs."""
    registry.formats["laval"] = Format(
        "data_tools.readers.latlong",
        app="illumination",
        inputs="HDR maps (.exr, .hdr)",
        takes=("rows",),
        help=LAVAL,
        options=LavalOptions,
    )
    registry.objects["illumination"] = Entry("data_tools.readers.picture_objects:light")
