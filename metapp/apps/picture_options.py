"""Options of applications that read or write pictures, and the values that they take.

Its classes are bases of applications' own options, whose fields become options of the command line. Nothing heavy is
imported here.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Annotated, Any

from typing_extensions import override

from metapp.options import INPUT, OUTPUT, AppOptions, Option

MIN_FOV_DEGREES = 0.5  # narrowest field of view, as of a telescope


def parse_size(value: object) -> tuple[int, int]:
    """Parse a size: "HxW", "N" for a square, a number or a pair. Return height and width in px.

    Raises:
        ValueError: the value has another form.

    >>> parse_size("512"), parse_size("512x1024")
    ((512, 512), (512, 1024))
    """
    sides = value if isinstance(value, tuple | list) else re.split("x", str(value))
    if not 1 <= len(sides) <= 2 or not all(re.fullmatch(r"\d{1,18}", str(side)) for side in sides):
        raise ValueError("expected HEIGHTxWIDTH in px, such as 512x1024, or one number for a square")
    return int(sides[0]), int(sides[-1])


def parse_field_of_view(degrees: float) -> float:
    """Return a camera's field of view in degrees if it is possible; 0 stands for one that is not known.

    Raises:
        ValueError: the field of view is narrower than a telescope's.
    """
    if 0 < degrees < MIN_FOV_DEGREES:
        raise ValueError(f"expected 0 or {MIN_FOV_DEGREES:g} to 150 degrees")
    return float(degrees)


def size_option(limits: str) -> Option:
    """Return the option --size of the files that fits write; `limits` say how large these may be."""
    return Option(f"Rows x columns: {limits}.", "HxW|N", panel=OUTPUT, parse=parse_size)


def fov_option(default: str) -> Option:
    """Return the option --fov of the photos that fits read; `default` says what holds where it is not given."""
    help_text = f"Field of view along the shorter side of photos; default: {default}."
    return Option(help_text, "DEGREES", low=0.0, high=150.0, panel=INPUT, parse=parse_field_of_view)


def pitch_option() -> Option:
    """Return the option --pitch of maps of light that photos of a ball show."""
    help_text = "Degrees that the camera looked down at the ball: maps in files are levelled by them, errors are not."
    return Option(help_text, "DEGREES", low=-89.0, high=89.0, panel=OUTPUT)


LayerOption = Annotated[
    str, Option("Layer or part of EXR files that hold several; default: the picture itself, such as Combined.", "NAME")
]


@dataclass(frozen=True)
class PictureOptions(AppOptions):
    """The options of applications that read pictures: the layer of files that hold several."""

    layer: LayerOption = ""


@dataclass(frozen=True)
class CameraOptions(PictureOptions):
    """The options of applications that read photos of a known camera: its field of view, too."""

    fov: Annotated[float, fov_option("EXIF's, else 45")] = 0.0

    @override
    def reader_keywords(self) -> dict[str, Any]:
        """Add the field of view in rad, if it is given."""
        return super().reader_keywords() | ({"fov_rad": math.radians(self.fov)} if self.fov else {})


@dataclass(frozen=True)
class ReliefOptions(AppOptions):
    """The options of applications whose fits have normals: the relief of the normals in files."""

    relief: Annotated[
        float,
        Option(
            "Factor on slopes of normals in files, not in errors; default: 1.",
            "FACTOR",
            low=0,
            high=10,
            panel=OUTPUT,
        ),
    ] = 1.0

    @override
    def adapt_asset(self, asset: Any) -> Any:
        """Scale the relief of a surface; other assets have none."""
        return asset.scale_relief(self.relief) if self.relief != 1 and hasattr(asset, "scale_relief") else asset


@dataclass(frozen=True)
class FlashOptions(ReliefOptions, CameraOptions):
    """The options of fits of flash photos: size and relief of maps, camera and exposure of photos."""

    size: Annotated[tuple[int, int] | None, size_option("square maps up to 4096; default: the photo's, up to 2048")] = (
        None
    )

    stops: Annotated[
        float,
        Option(
            "Stops by which photos are too bright; negative if they are too dark.",
            "STOPS",
            low=-4.0,
            high=4.0,
            panel=INPUT,
            observes="photo",
        ),
    ] = 0.0
