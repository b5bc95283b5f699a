"""Options that several formats have."""

from __future__ import annotations

import math

from metapp.door import Option

NARROWEST = 0.5  # degrees of a field of view


def fov_rad(degrees: float) -> float:
    """A camera's field of view in rad; 0, which is not known, stays 0.

    Raises:
        ValueError: narrower than a telescope's.
    """
    if 0 < degrees < NARROWEST:
        raise ValueError(f"{degrees:g} degrees, expected 0 or {NARROWEST:g} to 150.")
    return math.radians(degrees)


# of a fit's photos; what 0 means differs between formats
FOV_OF_FITS = Option(
    "fov",
    0.0,
    "Camera field of view along the photos' shorter side.",
    "DEGREES",
    low=0.0,
    high=150.0,
    convert=fov_rad,
    passed_as="fov_rad",
)
EXPOSURE = Option(
    "exposure",
    0.0,
    "Stops by which photos are too bright (negative: too dark); at 0, white paper below the flash just clips.",
    "STOPS",
    low=-4.0,
    high=4.0,
    protocol="photo",
    of_inputs=True,
)
