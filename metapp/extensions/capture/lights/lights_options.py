"""The options of `metapp data lights`.

They are apart from the work, so that help and completion import nothing large to read them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from metapp.apps.picture_options import LayerOption, fov_option
from metapp.extensions.capture.ball.ball_options import parse_circle
from metapp.options import Option

MAX_BALLS = 2


def parse_circles(texts: Sequence[str]) -> tuple[tuple[float, ...], ...]:
    """Return the circles that texts "X,Y,RADIUS" state; raise ValueError for another form or more than two."""
    if len(texts) > MAX_BALLS:
        raise ValueError(f"{len(texts)} balls, expected one or two")
    return tuple(map(parse_circle, texts))


@dataclass(frozen=True)
class LightsOptions:
    """The options of `metapp data lights` about photographs and text."""

    ball: Annotated[
        tuple[tuple[float, ...], ...],
        Option(
            "Where a ball is, px from the upper left; twice for two balls; default: it is found.",
            "X,Y,RADIUS",
            parse=parse_circles,
        ),
    ] = ()
    fov: Annotated[float, fov_option("EXIF's of uncropped photos, else a distant camera")] = 0.0
    names: Annotated[
        Path | None,
        Option(
            "Photos by the same lamps in the same order, without the ball: the text is of these, such as a dome's.",
            "DIR",
        ),
    ] = None
    layer: LayerOption = ""
