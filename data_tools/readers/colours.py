"""The colours of image files: the colour space that a file states, and the conversion of any space to linear Rec.709.

Integers are taken as sRGB and floating-point values as linear Rec.709, unless the file states another space: by an ICC
profile, which Little CMS converts, by primaries (`chromaticities` of EXR, PRIMARIES of Radiance, cHRM and gAMA of PNG),
by EXIF, or by a name that OpenColorIO knows, such as cICP of PNG gives; hybrid log-gamma is converted by its formula.
White stays white (Bradford).
"""

from __future__ import annotations

import contextlib
import io
import itertools
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import OpenImageIO as oiio
import torch
from numpy.typing import NDArray
from PIL import Image, ImageCms

from metapp.appearance.colorimetry import import_colour_science
from metapp.appearance.colour import linear_to_srgb, srgb_to_linear

Array = NDArray[Any]
Floats = NDArray[np.floating]


class IccProfile(NamedTuple):
    """An ICC profile of encoded colours.

    Attributes:
        name: the description in the profile.
        convert: a function that converts colours, uint8 [rows, columns, 3], to sRGB.
    """

    name: str
    convert: Callable[[Array], Array]


class Primaries(NamedTuple):
    """A colour space that is given by its primaries.

    Attributes:
        matrix: the matrix [3, 3] of linear colours to linear Rec.709.
        power: the power of stored values that makes them linear; 1 if they are so, 0 for sRGB's curve.
    """

    matrix: Floats
    power: float = 1.0


class Hlg(NamedTuple):
    """A colour space whose values are encoded by hybrid log-gamma (ITU-R BT.2100).

    Attributes:
        matrix: the matrix [3, 3] of linear colours to linear Rec.709.
    """

    matrix: Floats


ColourSpace = str | Primaries | IccProfile | Hlg  # a str is OpenColorIO's name of a space

SRGB_SPACE, LINEAR_SPACE = "srgb_rec709_scene", "lin_rec709_scene"

_OCIO_CONFIG = "ocio://default"  # not the user's own, which the variable OCIO names, since that may know other spaces
# Names of spaces by OpenImageIO that state no primaries, or the expected ones.
_NAMES_WITHOUT_PRIMARIES = ("", "unknown", "data", "raw", "rec709")
_REC709_XY = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
_PQ_WHITE_100_CD = 2.03  # diffuse white, in 100 cd/m^2 (ITU-R BT.2408)
_HLG_CODE = 18  # number of the transfer HLG in ITU-T H.273
_HLG_WHITE = 0.75  # signal of diffuse white (ITU-R BT.2408), 203 cd/m^2 on a display of 1000 cd/m^2
_XY_BY_CODE = {  # x, y of red, green, blue and white, by the number of primaries in ITU-T H.273
    1: _REC709_XY,
    9: (0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.329),
    12: (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.329),
}
_CODES_UNSTATED = (1, 2)  # primaries of Rec.709, and not stated
_CODES_AS_SRGB = (1, 2, 6, 13, 14, 15)  # transfers of Rec.709 and equal ones, not stated, and sRGB
_MIN_DOUBLED_AREA = 1e-3  # of a triangle of primaries; the one of Rec.709 has 0.224
_MAX_SAME_SPACE_LEVELS = 1  # levels of 255 by which two conversions of one space may differ


def space_of_file(spec: oiio.ImageSpec, path: Path, primaries: Sequence[float] = (), part: int = 0) -> ColourSpace:
    """Return the space of the colours of an open file; warn if it cannot be converted and is taken as sRGB.

    Args:
        spec: the file's description by OpenImageIO.
        path: the file.
        primaries: chromaticities x, y of red, green, blue and white that the file states elsewhere than in
            `chromaticities`; they are ignored if :func:`states_primaries` finds them impossible.
        part: the number of the picture in the file.

    Raises:
        ValueError: floating-point values are in a space that is not known.
    """
    is_float, codes = str(spec.format) in ("half", "float", "double"), spec.getattribute("CICP")
    profile = spec.getattribute("ICCProfile")
    if profile is not None and codes is None:  # cICP takes precedence
        return _space_of_profile(bytes(profile), path)
    primaries = primaries or spec.getattribute("chromaticities") or ()
    if is_float and states_primaries(primaries):
        return _space_of_primaries(primaries, 1.0)
    if not is_float and codes is None:  # Pillow reads chunks of PNG and EXIF that OpenImageIO does not
        info, is_adobe = dict[Any, Any](), False
        with contextlib.suppress(Exception), warnings.catch_warnings(action="ignore"), Image.open(path) as image:
            image.seek(part)
            info, is_adobe = image.info, states_adobe_rgb(image.getexif())
        if space := space_of_info(info, path, is_adobe):
            return space
    if codes is not None and codes[1] == _HLG_CODE and codes[0] in _XY_BY_CODE:
        message = f"{path}: HLG, whose signal of {_HLG_WHITE:.0%} is taken for white; what is brighter is clipped."
        warnings.warn(message, stacklevel=2)
        linear_space = _space_of_primaries(_XY_BY_CODE[codes[0]], 1.0)
        return Hlg(linear_space.matrix if isinstance(linear_space, Primaries) else np.eye(3, dtype=np.float32))
    stated_name: str = spec.get_string_attribute("oiio:ColorSpace")
    is_srgb = codes is None or (codes[0] in _CODES_UNSTATED and codes[1] in _CODES_AS_SRGB)
    if stated_name in ("", SRGB_SPACE) and not is_srgb:  # OpenImageIO says so of code points that it does not know
        return _take_as_srgb(path, f"of primaries {codes[0]} and transfer {codes[1]} of ITU-T H.273")
    if stated_name.lower() not in _NAMES_WITHOUT_PRIMARIES:
        if oiio.ColorConfig(_OCIO_CONFIG).getColorSpaceIndex(stated_name) >= 0:
            return stated_name
        if is_float:
            raise ValueError(
                f"{path}: colours in {stated_name[:40]!a}, expected a known space, such as linear Rec.709 or ACEScg; "
                "export the image with linear colours."
            )
        if codes is not None:
            return _take_as_srgb(path, f"in {stated_name[:40]!a}")
    return LINEAR_SPACE if is_float else SRGB_SPACE


def states_adobe_rgb(exif: Image.Exif) -> bool:
    """Tell whether EXIF states Adobe RGB, as cameras do without a profile."""
    return exif.get_ifd(0xA005).get(1) == "R03" or exif.get_ifd(0x8769).get(0xA001) == 2


def space_of_info(info: Mapping[Any, Any], subject: Path | str, is_adobe: bool) -> ColourSpace | None:
    """Return the colour space that the `info` of a PIL picture or its EXIF states; None if they state none.

    Args:
        info: the picture's `info`.
        subject: the name of the picture in warnings.
        is_adobe: whether EXIF states Adobe RGB.
    """
    if profile := info.get("icc_profile"):
        return _space_of_profile(profile, subject)
    gamma, white_first = info.get("gamma"), info.get("chromaticity") or ()
    xy = (*white_first[2:], *white_first[:2])
    if "srgb" not in info and (gamma or states_primaries(xy)):
        return _space_of_primaries(xy if states_primaries(xy) else _REC709_XY, 1 / gamma if gamma else 0.0)
    return "g22_adobergb_scene" if is_adobe else None


def _space_of_profile(data: bytes, subject: Path | str) -> ColourSpace:
    """Return the space of an ICC profile.

    A profile that converts as sRGB does, or as linear values of its primaries, is replaced by that space, whose
    conversion is exact for values of more than the profile's 8 bits.
    """
    description, srgb = "damaged", cast(Any, ImageCms.createProfile("sRGB"))
    try:
        profile = ImageCms.ImageCmsProfile(io.BytesIO(data))
        description = ImageCms.getProfileDescription(profile).strip()[:60]
        mode = {"RGB": "RGB", "GRAY": "L"}[profile.profile.xcolor_space.strip()]
        relative = ImageCms.Intent.RELATIVE_COLORIMETRIC
        transform = ImageCms.buildTransform(profile, srgb, mode, "RGB", relative)
    except (ImageCms.PyCMSError, OSError, TypeError, KeyError):
        return _take_as_srgb(subject, f"by the profile {description!a}")

    def convert(levels: Array) -> Array:
        picture = Image.fromarray(np.ascontiguousarray(levels if mode == "RGB" else levels[..., 0]))
        return np.asarray(transform.apply(picture))

    lattice = np.stack(np.meshgrid(*[np.arange(0, 256, 15, dtype=np.uint8)] * 3), -1).reshape(18, -1, 3)
    converted = convert(lattice).astype(np.int32)
    if np.abs(converted - lattice).max() <= _MAX_SAME_SPACE_LEVELS:
        return SRGB_SPACE
    if profile.profile.is_matrix_shaper and mode == "RGB":
        colorants, to_xyz = (
            np.array(
                [matrix_profile.red_colorant[0], matrix_profile.green_colorant[0], matrix_profile.blue_colorant[0]],
                np.float32,
            ).T
            for matrix_profile in (cast(Any, profile.profile), srgb)
        )
        linear_space = Primaries(np.linalg.solve(to_xyz, colorants))
        expected = linear_to_srgb(torch.from_numpy(linear_rgb(lattice, linear_space).clip(0, 1))).numpy() * 255
        if np.abs(converted - expected).max() <= _MAX_SAME_SPACE_LEVELS:
            return linear_space
    return IccProfile(description, convert)


def _take_as_srgb(subject: Path | str, stated: str) -> str:
    """Warn that colours cannot be converted, `stated` saying which, and return the space sRGB."""
    message = f"{subject}: colours {stated}, which cannot be converted, are taken as sRGB; export it as sRGB."
    warnings.warn(message, stacklevel=2)
    return SRGB_SPACE


def is_linear(space: ColourSpace) -> bool:
    """Tell whether values of a space are proportional to light."""
    if not isinstance(space, str):
        return isinstance(space, Primaries) and space.power == 1
    config = oiio.ColorConfig(_OCIO_CONFIG)
    return config.isColorSpaceLinear(config.resolve(space))


def linear_rgb(values: Array, space: ColourSpace) -> Floats:
    """Convert stored colours to linear Rec.709, float32, which may leave [0, 1].

    Args:
        values: colours [rows, columns, 3], uint8, uint16 or floating point.
        space: their colour space.
    """
    if isinstance(space, IccProfile):
        return _convert_by_profile(values, space.convert)
    if isinstance(space, Hlg):
        light = _decode_hlg(integers_to_unit_range(values)) / _decode_hlg(np.array(_HLG_WHITE, np.float32))
        return light @ space.matrix.T
    if isinstance(space, Primaries):
        linear = integers_to_unit_range(values) if space.power else linear_rgb(values, SRGB_SPACE)
        return (linear if space.power in (0, 1) else linear.clip(0) ** np.float32(space.power)) @ space.matrix.T
    if space == SRGB_SPACE and values.dtype.kind == "u":
        levels = torch.linspace(0, 1, np.iinfo(values.dtype).max + 1, dtype=torch.float64)
        return srgb_to_linear(levels).float().numpy()[values]
    floats = integers_to_unit_range(values)
    if space == SRGB_SPACE:
        return srgb_to_linear(torch.from_numpy(floats)).numpy()
    return floats if space == LINEAR_SPACE else _convert_by_ocio(floats, space)


def _decode_hlg(signal: Floats) -> Floats:
    """Return the light of a scene in [0, 1] from an HLG signal: the inverse OETF of ITU-R BT.2100, table 5."""
    a = 0.17883277
    b, c = 1 - 4 * a, 0.5 - a * np.log(4 * a)
    bounded = signal.clip(0, 1)
    light: Floats = np.where(bounded <= 0.5, bounded**2 / 3, (np.exp((bounded - c) / a) + b) / 12)
    return light.astype(np.float32)


def _convert_by_profile(values: Array, convert: Callable[[Array], Array]) -> Floats:
    """Convert colours to linear Rec.709 by the conversion of an ICC profile, which takes 8 bits.

    Colours of more bits, clipped to [0, 1], are interpolated between the eight 8-bit colours around them.
    """
    if values.dtype == np.uint8:
        return linear_rgb(convert(values), SRGB_SPACE)
    levels = integers_to_unit_range(values).clip(0, 1) * 255
    lower = np.nan_to_num(levels).astype(np.uint8)
    total = np.zeros(values.shape, np.float32)
    for corner in np.array(list(itertools.product((0, 1), repeat=3)), np.uint16):
        weight = np.where(corner, levels - lower, 1 - levels + lower).prod(-1, keepdims=True)
        total += weight * linear_rgb(convert((lower + corner).clip(max=255).astype(np.uint8)), SRGB_SPACE)
    return total


def integers_to_unit_range(values: Array) -> Floats:
    """Divide integers by their type's largest value, and return floating-point values as they are; float32."""
    return values.astype(np.float32) / (np.iinfo(values.dtype).max if values.dtype.kind == "u" else 1)


def _convert_by_ocio(values: Floats, space: str) -> Floats:
    """Convert floating-point colours of a space that OpenColorIO knows to linear Rec.709."""
    image = oiio.ImageBuf(np.ascontiguousarray(values))
    converted = oiio.ImageBufAlgo.colorconvert(image, space, LINEAR_SPACE, colorconfig=_OCIO_CONFIG)
    linear = converted.get_pixels(oiio.FLOAT)
    assert linear is not None, converted.geterror()  # `space_of_file` returns names that OpenColorIO knows
    return linear / (_PQ_WHITE_100_CD if space.startswith("pq_") else 1)


def states_primaries(xy: Sequence[float]) -> bool:
    """Return whether eight numbers state a colour space: primaries that span a triangle, with white inside it.

    Programs write zeros where they state nothing, such as Photoshop in each Radiance file.

    Args:
        xy: CIE 1931 chromaticities x, y of red, green, blue and white.

    >>> states_primaries([0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329]), states_primaries([0.0] * 8)
    (True, False)
    """
    if len(xy) != 8 or not np.isfinite(xy).all():
        return False
    *corners, white = np.reshape(np.array(xy, np.float64), (4, 2))
    doubled_areas = [
        _doubled_area(corners[first], corners[second], white) for first, second in itertools.pairwise((0, 1, 2, 0))
    ]
    same_side = min(doubled_areas) > 0 or max(doubled_areas) < 0
    return same_side and abs(_doubled_area(*corners)) > _MIN_DOUBLED_AREA and bool(white[1] > 0)


def _doubled_area(first: Floats, second: Floats, third: Floats) -> float:
    """Return twice the signed area of a triangle of chromaticities, positive if they run counterclockwise."""
    (x, y), (u, v) = second - first, third - first
    return float(x * v - y * u)


def _space_of_primaries(xy: Sequence[float], power: float) -> ColourSpace:
    """Return the space of chromaticities that :func:`states_primaries` accepts.

    Args:
        xy: CIE 1931 chromaticities x, y of red, green, blue and white.
        power: the exponent of the encoding, 1 for linear values, 0 for the curve of sRGB.
    """
    is_rec709 = np.abs(np.subtract(xy, _REC709_XY)).max() <= 1e-3
    if is_rec709 and power in (0, 1):
        return LINEAR_SPACE if power else SRGB_SPACE
    colour = import_colour_science()
    source = colour.RGB_Colourspace("stated", np.reshape(xy[:6], (3, 2)), np.array(xy[6:]))
    matrix = colour.matrix_RGB_to_RGB(source, colour.RGB_COLOURSPACES["ITU-R BT.709"], "Bradford")
    return Primaries(np.asarray(matrix, np.float32), power)
