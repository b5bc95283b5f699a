"""What a photograph's EXIF says of its lens: how wide the field of view is."""

from __future__ import annotations

import contextlib
import math
import warnings
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import OpenImageIO as oiio

FRAME_MM = math.hypot(36, 24)  # the diagonal that focal lengths "in 35 mm film" are of (CIPA DCG-001)
_FOCAL_TAG, _EXIF_BLOCK = 0xA405, 0x8769


def focal_length(spec: oiio.ImageSpec) -> float:
    """The focal length in mm as of 35 mm film, of OpenImageIO's spec of a file; 0 where it does not say."""
    return float(max(0, spec.get_int_attribute("Exif:FocalLengthIn35mmFilm", 0)))


def focal_length_of(exif: bytes | None) -> float:
    """The same of an EXIF block, as HEIF files hold it."""
    from PIL import Image

    found = Image.Exif()
    with (
        contextlib.suppress(Exception),
        warnings.catch_warnings(action="ignore"),
    ):  # Pillow's reader of TIFF raises whatever a damaged block makes of it
        found.load(exif or b"")
        return float(max(0, int(found.get_ifd(_EXIF_BLOCK).get(_FOCAL_TAG, 0))))
    return 0.0


def field_of_view(focal_mm: float, height: int, width: int) -> float:
    """The field of view in rad along the shorter side of a picture that was not cropped.

    Args:
        focal_mm: as of 35 mm film, > 0: the diagonal of the picture is that of a film's frame.
        height, width: of the picture.
    """
    shorter = FRAME_MM * min(height, width) / math.hypot(height, width)
    return 2 * math.atan(shorter / 2 / focal_mm)


def seen_share(fov_rad: float, wanted_rad: float) -> float:
    """The share of a picture's side that a camera in the same place sees whose field is no wider than wanted."""
    return min(1.0, math.tan(wanted_rad / 2) / math.tan(fov_rad / 2))
