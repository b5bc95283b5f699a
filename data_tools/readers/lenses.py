"""Focal lengths as of 35 mm film, by what EXIF states of a photograph's lens and sensor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

FILM_DIAGONAL_MM = math.hypot(36, 24)  # the diagonal that focal lengths "in 35 mm film" are of (CIPA DCG-001)
RESOLUTION_UNITS_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}  # of resolutions on the sensor, by the numbers of EXIF

_LEAST_SENSOR_MM, _LARGEST_SENSOR_MM = 3.0, 70.0  # diagonals, of phones to medium format
_LEAST_FOCAL_MM, _LARGEST_FOCAL_MM = 5.0, 3000.0  # as of 35 mm film


class ExifLens(NamedTuple):
    """What EXIF states of a photograph's lens.

    Attributes:
        focal_mm: the focal length as of 35 mm film; 0 if it is not known.
        note: how it is known, or why it is not, where EXIF states a focal length, but not as of 35 mm film; else "".
    """

    focal_mm: float = 0.0
    note: str = ""


def lens_of_exif(
    in_film_mm: float, focal_mm: float, resolution: tuple[float, float], unit: int, size: Sequence[int]
) -> ExifLens:
    """Return the lens of what EXIF states; 0 stands for a tag that is missing.

    The sensor's size is that of the picture's px over the resolution on the sensor.

    Args:
        in_film_mm: FocalLengthIn35mmFilm.
        focal_mm: FocalLength.
        resolution: FocalPlaneXResolution and FocalPlaneYResolution, px a unit.
        unit: FocalPlaneResolutionUnit; 2, inches, where it is missing.
        size: PixelXDimension and PixelYDimension, else width and height of what is stored, px.

    >>> lens_of(0, 18.0, (5728.18, 5808.4), 2, [5184, 3456]).focal_mm.__round__(1)
    28.3
    """
    if in_film_mm > 0:
        return ExifLens(float(in_film_mm))
    if not (math.isfinite(focal_mm) and focal_mm > 0):
        return ExifLens()
    unit_mm = RESOLUTION_UNITS_MM.get(unit or 2, 0.0)
    across, down = resolution[0], resolution[1] if resolution[1] > 0 else resolution[0]
    if across > 0 and down > 0 and unit_mm and min(size) > 0:
        width_mm, height_mm = size[0] / across * unit_mm, size[1] / down * unit_mm
        diagonal_mm = math.hypot(width_mm, height_mm)
        in_film_mm = focal_mm * FILM_DIAGONAL_MM / diagonal_mm if diagonal_mm else 0.0
        if _LEAST_SENSOR_MM <= diagonal_mm <= _LARGEST_SENSOR_MM and _LEAST_FOCAL_MM <= in_film_mm <= _LARGEST_FOCAL_MM:
            sensor = f"{width_mm:.1f} x {height_mm:.1f} mm"
            return ExifLens(
                in_film_mm, f"{focal_mm:.3g} mm on a sensor of {sensor}: {in_film_mm:.0f} mm as of 35 mm film"
            )
    return ExifLens(0.0, f"{focal_mm:.3g} mm on a sensor of unknown size")
