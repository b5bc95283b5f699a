"""Focal lengths in mm on 35 mm film, from what EXIF states of a photograph's lens and sensor.

A focal length on 35 mm film stands for the field of view, whatever the size of the camera's sensor.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

FILM_DIAGONAL_MM = math.hypot(36, 24)  # the diagonal that EXIF's focal lengths in 35 mm film refer to (CIPA DCG-001)
RESOLUTION_UNITS_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 1e-3}  # units of resolutions on the sensor, by EXIF's numbers

_MIN_SENSOR_DIAGONAL_MM, _MAX_SENSOR_DIAGONAL_MM = 3.0, 70.0  # from phones to medium format
_MIN_FILM_FOCAL_MM, _MAX_FILM_FOCAL_MM = 5.0, 3000.0  # plausible focal lengths on 35 mm film


class ExifLens(NamedTuple):
    """The lens of a photograph, as EXIF states it.

    Attributes:
        focal_mm: the focal length in mm of an equal field of view on 35 mm film; 0 if it is not known.
        note: how `focal_mm` is known, or why it is not, for a photograph whose EXIF states a focal length, but not on
            35 mm film; else "".
    """

    focal_mm: float = 0.0
    note: str = ""


def lens_of_exif(
    in_film_mm: float, focal_mm: float, resolution: tuple[float, float], unit: int, size: Sequence[int]
) -> ExifLens:
    """Return the lens that EXIF states; 0 stands for a tag that is missing.

    The size of the sensor is the number of the picture's px over their number a mm on the sensor.

    Args:
        in_film_mm: FocalLengthIn35mmFilm.
        focal_mm: FocalLength.
        resolution: FocalPlaneXResolution and FocalPlaneYResolution, px a unit.
        unit: FocalPlaneResolutionUnit; 2, inches, where it is missing.
        size: PixelXDimension and PixelYDimension, else width and height of the stored picture, px.

    >>> lens_of_exif(0, 18.0, (5728.18, 5808.4), 2, [5184, 3456]).focal_mm.__round__(1)
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
        if (
            _MIN_SENSOR_DIAGONAL_MM <= diagonal_mm <= _MAX_SENSOR_DIAGONAL_MM
            and _MIN_FILM_FOCAL_MM <= in_film_mm <= _MAX_FILM_FOCAL_MM
        ):
            sensor = f"{width_mm:.1f} x {height_mm:.1f} mm"
            return ExifLens(
                in_film_mm, f"{focal_mm:.3g} mm on a sensor of {sensor}: {in_film_mm:.0f} mm as of 35 mm film"
            )
    return ExifLens(0.0, f"{focal_mm:.3g} mm on a sensor of unknown size")
