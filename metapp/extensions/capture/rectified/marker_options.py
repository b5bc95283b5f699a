"""The options of the commands that write marker sheets and rectify photographs.

They are apart from the work, so that help and completion import nothing large to read them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from metapp.apps.picture_options import fov_option
from metapp.options import Option


@dataclass(frozen=True)
class SheetOptions:
    """The options of `metapp data markers` about the sheet."""

    opening: Annotated[int, Option("Side of the square opening, 4 to 13 whole centimetres.", "CM", low=4, high=13)] = 10
    page: Annotated[str, Option("The paper.", "a4|letter", choices=("a4", "letter"))] = "a4"


def parse_offset(text: str) -> tuple[float, ...]:
    """Return the two numbers, in cm, that an offset "X,Y" states; raise ValueError for another form."""
    try:
        x, y = map(float, text.split(","))
    except ValueError:
        x = y = math.nan
    if not math.hypot(x, y) <= 30:
        raise ValueError("expected two numbers in cm, up to 30, such as 1.2,0")
    return x, y


@dataclass(frozen=True)
class RectifyOptions:
    """The options of `metapp data rectify` about photographs and pictures."""

    size: Annotated[
        int, Option("Greatest side of the pictures; never finer than the first photo.", "PX", low=64, high=4096)
    ] = 1024
    fov: Annotated[float, fov_option("EXIF's, else as markers or points fit best")] = 0.0
    flash: Annotated[
        tuple[float, ...],
        Option(
            "Where the flash is beside the lens: cm right and up in the photo; default: 0,0.", "X,Y", parse=parse_offset
        ),
    ] = ()
    ruler: Annotated[float, Option("Measured length of the sheet's printed 10 cm ruler.", "CM", low=5.0, high=20.0)] = (
        10.0
    )
    most: Annotated[
        int, Option("Number of photos, spread evenly, that are taken of more, as many as a fit reads.", "N", low=2)
    ] = 9
