"""The options of `metapp data ball`.

They are apart from the work, so that help and completion import nothing large to read them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from metapp.apps.picture_options import LayerOption, fov_option, pitch_option
from metapp.options import Option


def parse_circle(text: str) -> tuple[float, ...]:
    """Return the centre and the radius, in px, that a text "X,Y,RADIUS" states; raise ValueError for another form."""
    try:
        x, y, radius = map(float, text.split(","))
    except ValueError:
        x = y = radius = math.nan
    if not (math.isfinite(x) and math.isfinite(y) and 0 < radius < math.inf):
        raise ValueError("expected centre and radius in px, such as 210,205,180")
    return x, y, radius


@dataclass(frozen=True)
class BallOptions:
    """The options of `metapp data ball` about photographs and map."""

    shutter: Annotated[
        str, Option("Shutter times of the photos in their order, such as 1/20,1/60; auto: EXIF's.", "T,T,...")
    ] = "auto"
    fov: Annotated[float, fov_option("EXIF's of uncropped photos, else a distant camera")] = 0.0
    ball: Annotated[
        tuple[float, ...],
        Option("Where the ball is, px from the upper left; default: it is found.", "X,Y,RADIUS", parse=parse_circle),
    ] = ()
    rows: Annotated[int, Option("Rows of the map, 32 to 1024.", "N", low=32, high=1024)] = 128
    pitch: Annotated[float, pitch_option()] = 0.0
    layer: LayerOption = ""
