"""Options that several applications have."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Annotated, Any

from metapp.options import INPUT, OUTPUT, AppOptions, Option

MIN_FOV_DEGREES = 0.5  # degrees of a field of view


def parse_size(value: object) -> tuple[int, int]:
    """Height and width in px of "HxW", of "N" for a square, of a number or of a pair.

    Raises:
        ValueError: another form.

    >>> size_of("512"), size_of("512x1024")
    ((512, 512), (512, 1024))
    """
    sides = value if isinstance(value, tuple | list) else re.split("x", str(value))
    if not 1 <= len(sides) <= 2 or not all(re.fullmatch(r"\d{1,18}", str(side)) for side in sides):
        raise ValueError("expected HEIGHTxWIDTH in px, such as 512x1024, or one number for a square")
    return int(sides[0]), int(sides[-1])


def parse_field_of_view(degrees: float) -> float:
    """A camera's field of view in degrees; 0, which is not known, stays 0.

    Raises:
        ValueError: narrower than a telescope's.
    """
    if 0 < degrees < MIN_FOV_DEGREES:
        raise ValueError(f"expected 0 or {MIN_FOV_DEGREES:g} to 150 degrees")
    return float(degrees)


def size(limits: str) -> Option:
    """The option --size of files that fits make; `limits` say how large they may be."""
    return Option(f"Rows x columns of files: {limits}.", "HxW|N", panel=OUTPUT, parse=parse_size)


def fov(default: str) -> Option:
    """The option --fov of photos that fits read; `default` says the meaning of 0."""
    about = f"Field of view, shorter side; default: {default}."
    return Option(about, "DEGREES", low=0.0, high=150.0, panel=INPUT, parse=parse_field_of_view)


LayerOption = Annotated[
    str, Option("Layer or part of EXR files that hold several; default: the picture itself, such as Combined.", "NAME")
]


@dataclass(frozen=True)
class PictureOptions(AppOptions):
    """The option of applications that read pictures."""

    layer: LayerOption = ""


@dataclass(frozen=True)
class CameraOptions(PictureOptions):
    """The option of applications that read photos of a known camera."""

    fov: Annotated[float, fov("EXIF's, else 45")] = 0.0

    def reader_keywords(self) -> dict[str, Any]:
        """Readers take the field of view in rad."""
        return super().reader_keywords() | ({"fov_rad": math.radians(self.fov)} if self.fov else {})


@dataclass(frozen=True)
class ReliefOptions(AppOptions):
    """The option of applications whose fits are normals."""

    relief: Annotated[
        float,
        Option(
            "Factor of slopes of normals in files, not of errors; default: 1.",
            "FACTOR",
            low=0,
            high=10,
            panel=OUTPUT,
        ),
    ] = 1.0

    def recorded_values(self) -> dict[str, object]:
        """With the factor, by which later exports and pages show the fit, too."""
        return super().recorded_values() | ({"relief": self.relief} if self.relief != 1 else {})


@dataclass(frozen=True)
class FlashOptions(ReliefOptions, CameraOptions):
    """Size and relief of maps, camera and exposure of flash photos."""

    size: Annotated[tuple[int, int] | None, size("square maps up to 4096; default: the photo's, up to 2048")] = None

    stops: Annotated[
        float,
        Option(
            "Stops by which photos are too bright; negative: dark.",
            "STOPS",
            low=-4.0,
            high=4.0,
            panel=INPUT,
            protocol="photo",
        ),
    ] = 0.0
