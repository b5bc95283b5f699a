"""Options that several formats have."""

from __future__ import annotations

import math

from metapp.door import Option

# of a fit's photos; what 0 means differs between formats
FOV_OF_FITS = Option(
    "fov",
    0.0,
    "Camera field of view along the photos' shorter side.",
    "DEGREES",
    low=0.0,
    high=150.0,
    convert=math.radians,
    passed_as="fov_rad",
)
