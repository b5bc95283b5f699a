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
_MAX_SHAPE_RATIO = 1.01  # of the ratios of sides of a photograph and of a smaller copy, whose sides are rounded
_MAX_CERTAIN_RATIO = 1.1  # of the longest over the shortest possible focal length that still counts as known
_MAX_DIGITAL_ZOOM = 200.0
_MAX_ENLARGEMENT = 1.02  # of a part beyond the photograph, as raw converters develop some px more than cameras do


class ExifLens(NamedTuple):
    """The lens of a photograph, as EXIF states it.

    Attributes:
        focal_mm: the focal length in mm of an equal field of view on 35 mm film, the shortest possible one; 0 if it is
            not known.
        note: how `focal_mm` is known, or why it is not, for a photograph whose EXIF states a focal length otherwise
            than on 35 mm film, or one that may not hold for the picture; else "".
        focal_range: the longest possible focal length over `focal_mm`, above 1 where it is not known whether a digital
            zoom is counted, or how much of the photograph a picture shows.
        whole_px: width and height of the photograph that the focal length is of; zeros if EXIF does not state them.
        is_part: whether the picture shows a part of that photograph; see :meth:`of_picture`.
    """

    focal_mm: float = 0.0
    note: str = ""
    focal_range: float = 1.0
    whole_px: tuple[int, int] = (0, 0)
    is_part: bool = False

    def of_picture(self, height: int, width: int) -> ExifLens:
        """Return the lens that holds for a picture, which may show a part of the photograph that EXIF describes.

        A picture of the photograph's ratio of sides, upright or turned, counts as a copy of all of it, unless it is as
        high as the photograph is wide, or the reverse: it may be cut out upright. Any other one is a part: either of
        the photograph's own px, or of fewer, since it was scaled down, too.

        Args:
            height: the height of the picture in px.
            width: the width of the picture in px.

        >>> part = ExifLens(26.0, whole_px=(2133, 1600)).of_picture(800, 800)
        >>> round(part.focal_mm, 1), round(part.focal_range, 1)
        (30.6, 2.0)
        >>> ExifLens(26.0, whole_px=(2133, 1600)).of_picture(1066, 800).focal_mm
        26.0
        """
        if not self.focal_mm or min(self.whole_px) <= 0:
            return self
        longer_ratio, shorter_ratio = max(self.whole_px) / max(height, width), min(self.whole_px) / min(height, width)
        is_of_same_shape = max(longer_ratio / shorter_ratio, shorter_ratio / longer_ratio) <= _MAX_SHAPE_RATIO
        if is_of_same_shape and max(height, width) != min(self.whole_px):
            return self
        whole, photo = math.hypot(*self.whole_px), f"a photo of {self.whole_px[0]:,} x {self.whole_px[1]:,} px"
        scale = min(longer_ratio, shorter_ratio)  # px of the photograph in one of the picture, at most
        if scale * _MAX_ENLARGEMENT < 1:
            return ExifLens(0.0, f"EXIF is of {photo}, which this picture of {width:,} x {height:,} px is no part of")
        shortest, longest = (whole / (factor * math.hypot(height, width)) for factor in (max(1.0, scale), 1.0))
        if longest <= _MAX_CERTAIN_RATIO:
            return self
        scaled = ", perhaps scaled" if longest / shortest > 1 else ""
        note = f"EXIF is of {photo}, of which {width:,} x {height:,} px are a part{scaled}"
        return self._replace(
            focal_mm=self.focal_mm * shortest,
            note="; ".join(filter(None, (self.note, note))),
            focal_range=self.focal_range * longest / shortest,
            is_part=True,
        )


def lens_of_exif(
    in_film_mm: float,
    focal_mm: float,
    resolution: tuple[float, float],
    unit: int,
    size: Sequence[int],
    digital_zoom: float = 0.0,
) -> ExifLens:
    """Return the lens that EXIF states; 0 stands for a tag that is missing, and impossible focal lengths count as 0.

    The size of the sensor is the number of the picture's px over their number a mm on the sensor.

    Args:
        in_film_mm: FocalLengthIn35mmFilm.
        focal_mm: FocalLength.
        resolution: FocalPlaneXResolution and FocalPlaneYResolution, px a unit.
        unit: FocalPlaneResolutionUnit; 2, inches, where it is missing.
        size: PixelXDimension and PixelYDimension, else width and height of the stored picture, px.
        digital_zoom: DigitalZoomRatio, which some cameras count in focal lengths on 35 mm film, and others do not.

    >>> lens_of_exif(0, 18.0, (5728.18, 5808.4), 2, [5184, 3456]).focal_mm.__round__(1)
    28.3
    """
    if _MIN_FILM_FOCAL_MM <= in_film_mm <= _MAX_FILM_FOCAL_MM:
        return _add_digital_zoom(ExifLens(float(in_film_mm)), digital_zoom)
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
            note = f"{focal_mm:.3g} mm on a sensor of {sensor}: {in_film_mm:.0f} mm as of 35 mm film"
            return _add_digital_zoom(ExifLens(in_film_mm, note), digital_zoom)
    return ExifLens(0.0, f"{focal_mm:.3g} mm on a sensor of unknown size")


def _add_digital_zoom(lens: ExifLens, digital_zoom: float) -> ExifLens:
    """Return a lens whose focal length may be longer by a digital zoom; 0 stands for none."""
    if not _MAX_CERTAIN_RATIO < digital_zoom < _MAX_DIGITAL_ZOOM:
        return lens
    note = f"EXIF states a digital zoom of {digital_zoom:.3g}, which {lens.focal_mm:.0f} mm on 35 mm film may not count"
    return lens._replace(note="; ".join(filter(None, (lens.note, note))), focal_range=digital_zoom)
