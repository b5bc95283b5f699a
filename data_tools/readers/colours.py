"""The colours of image files: which space a file states, and any space as linear Rec.709.

Integers are taken as sRGB and floating-point values as linear Rec.709, unless the file states another space: by an ICC
profile of a known name, such as Display P3 of many phones, by primaries (`chromaticities` of EXR), or by a name that
OpenColorIO knows. White stays white (Bradford).
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from metapp.appearance.colorimetry import colour_science
from metapp.appearance.colour import srgb_to_linear

if TYPE_CHECKING:
    import OpenImageIO as oiio

Array = NDArray[Any]
Floats = NDArray[np.floating]
Space = str | Floats  # OpenColorIO's name, or the matrix [3, 3] of linear colours to Rec.709

SRGB, LINEAR = "srgb_rec709_scene", "lin_rec709_scene"

_CONFIG = "ocio://default"  # a user's own, which the variable OCIO names, may know other spaces
_PROFILES = {"Display P3": "srgb_p3d65_scene", "Adobe RGB (1998)": "g22_adobergb_scene"}
_UNSTATED = ("", "unknown", "data", "raw", "rec709")  # say nothing of primaries, or those that are expected
_REC709_XY = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)


def space_of_file(spec: oiio.ImageSpec, path: Path) -> Space:
    """The space of the colours of an open file.

    Raises:
        ValueError: floating-point values in a space that is not known, or of primaries that do not differ.
    """
    import OpenImageIO as oiio

    is_float = str(spec.format) in ("half", "float", "double")
    profile = spec.get_string_attribute("ICCProfile:profile_description")
    if profile in _PROFILES:
        return _PROFILES[profile]
    primaries = spec.getattribute("chromaticities")
    if primaries is not None and is_float:
        is_rec709 = np.abs(np.subtract(primaries, _REC709_XY)).max() <= 1e-3
        return LINEAR if is_rec709 else _from_primaries(primaries, path)
    stated: str = spec.get_string_attribute("oiio:ColorSpace")
    if stated.lower() not in _UNSTATED:
        if oiio.ColorConfig(_CONFIG).getColorSpaceIndex(stated) >= 0:
            return stated
        if is_float:
            raise ValueError(
                f"{path}: colours in {stated[:40]!a}, expected a known space, such as linear Rec.709 or ACEScg; "
                "export the image with linear colours."
            )
    return LINEAR if is_float else SRGB


def space_of_profile(profile: bytes | None) -> Space:
    """The space that an ICC profile names; sRGB without one, and of one that is damaged or not known."""
    from PIL import ImageCms

    with contextlib.suppress(ImageCms.PyCMSError, OSError, TypeError):
        if profile:
            name = str(ImageCms.getProfileDescription(ImageCms.ImageCmsProfile(io.BytesIO(profile)))).strip()
            return _PROFILES.get(name, SRGB)
    return SRGB


def is_linear(space: Space) -> bool:
    """True if light adds up in a space."""
    import OpenImageIO as oiio

    config = oiio.ColorConfig(_CONFIG)
    return not isinstance(space, str) or config.isColorSpaceLinear(config.resolve(space))


def linear_rgb(values: Array, space: Space) -> Floats:
    """Stored colours, uint8, uint16 or float [rows, columns, 3], as linear Rec.709, float32, which may leave [0, 1]."""
    if not isinstance(space, str):
        return fraction(values) @ space.T
    if space == SRGB and values.dtype.kind == "u":
        levels = torch.linspace(0, 1, np.iinfo(values.dtype).max + 1, dtype=torch.float64)
        return srgb_to_linear(levels).float().numpy()[values]
    floats = fraction(values)
    if space == SRGB:
        linear: Floats = srgb_to_linear(torch.from_numpy(floats)).numpy()
        return linear
    return floats if space == LINEAR else _converted(floats, space)


def fraction(values: Array) -> Floats:
    """Integers over their greatest value, floats as they are; float32."""
    return values.astype(np.float32) / (np.iinfo(values.dtype).max if values.dtype.kind == "u" else 1)


def _converted(values: Floats, space: str) -> Floats:
    import OpenImageIO as oiio

    image = oiio.ImageBuf(np.ascontiguousarray(values))
    done = oiio.ImageBufAlgo.colorconvert(image, space, LINEAR, colorconfig=_CONFIG)
    linear = done.get_pixels(oiio.FLOAT)
    assert linear is not None, done.geterror()  # `space_of_file` names known ones only
    return linear


def _from_primaries(xy: Sequence[float], path: Path) -> Floats:
    """The matrix [3, 3] of linear colours of these primaries (red, green, blue, white) to Rec.709, white to white."""
    colour = colour_science()
    source = colour.RGB_Colourspace("stated", np.reshape(xy[:6], (3, 2)), np.array(xy[6:]))
    try:
        matrix = colour.matrix_RGB_to_RGB(source, colour.RGB_COLOURSPACES["ITU-R BT.709"], "Bradford")
    except np.linalg.LinAlgError:
        shown = ", ".join(f"{number:.3g}" for number in xy[:6])
        raise ValueError(
            f"{path}: chromaticities {shown}, expected three primaries that differ; export the image again."
        ) from None
    return np.asarray(matrix, np.float32)
