"""The colours of image files: which space a file states, and any space as linear Rec.709.

Integers are taken as sRGB and floating-point values as linear Rec.709, unless the file states another space: by an ICC
profile, which Little CMS converts, by primaries (`chromaticities` of EXR, PRIMARIES of Radiance, cHRM and gAMA of PNG),
by EXIF, or by a name that OpenColorIO knows, such as of cICP of PNG; hybrid log-gamma by its formula. White stays white
(Bradford).
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
    """An ICC profile of encoded colours: its description, and its conversion of uint8 [rows, columns, 3] to sRGB."""

    name: str
    convert: Callable[[Array], Array]


class Primaries(NamedTuple):
    """The matrix [3, 3] of linear colours to Rec.709, and their encoding: a power, 1 for none, 0 for sRGB's curve."""

    matrix: Floats
    power: float = 1.0


class Hlg(NamedTuple):
    """Hybrid log-gamma (ITU-R BT.2100): the matrix [3, 3] of linear colours to Rec.709."""

    matrix: Floats


ColourSpace = str | Primaries | IccProfile | Hlg  # or OpenColorIO's name

SRGB_SPACE, LINEAR_SPACE = "srgb_rec709_scene", "lin_rec709_scene"

_CONFIG = "ocio://default"  # a user's own, which the variable OCIO names, may know other spaces
_UNSTATED = ("", "unknown", "data", "raw", "rec709")  # say nothing of primaries, or those that are expected
_REC709_XY = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
_PQ_WHITE = 2.03  # in 100 cd/m^2 (ITU-R BT.2408)
_HLG_CODE = 18  # of the transfer, in ITU-T H.273
_HLG_WHITE = 0.75  # of the signal (ITU-R BT.2408), as 203 cd/m^2 are of a display of 1000
_CODED_XY = {  # by the codes of primaries in ITU-T H.273: x, y of red, green, blue and white
    1: _REC709_XY,
    9: (0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.329),
    12: (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.329),
}
_CODES_UNSTATED = (1, 2)  # primaries of Rec.709, and none
_CODES_AS_SRGB = (1, 2, 6, 13, 14, 15)  # transfers of Rec.709 and its kin, none, and sRGB
_LEAST_DOUBLED_AREA = 1e-3  # of a triangle of primaries; that of Rec.709 is 0.224
_SAME = 1  # levels of 255 by which conversions of one space differ


def space_of_file(spec: oiio.ImageSpec, path: Path, primaries: Sequence[float] = (), part: int = 0) -> ColourSpace:
    """The space of the colours of an open file; a warning of one that cannot be converted.

    Args:
        spec: the file's.
        path: the file.
        primaries: x, y of red, green, blue, white that it states elsewhere than in `chromaticities`; ones that cannot
            be (`states_primaries`) count as none.
        part: number of the picture in the file.

    Raises:
        ValueError: floating-point values in a space that is not known.
    """
    is_float, codes = str(spec.format) in ("half", "float", "double"), spec.getattribute("CICP")
    profile = spec.getattribute("ICCProfile")
    if profile is not None and codes is None:  # which come first
        return _of_profile(bytes(profile), path)
    primaries = primaries or spec.getattribute("chromaticities") or ()
    if is_float and states_primaries(primaries):
        return _of_primaries(primaries, 1.0)
    if not is_float and codes is None:  # Pillow reads more of PNG and EXIF
        info, is_adobe = dict[Any, Any](), False
        with contextlib.suppress(Exception), warnings.catch_warnings(action="ignore"), Image.open(path) as image:
            image.seek(part)
            info, is_adobe = image.info, states_adobe_rgb(image.getexif())
        if space := space_of_info(info, path, is_adobe):
            return space
    if codes is not None and codes[1] == _HLG_CODE and codes[0] in _CODED_XY:
        found = f"{path}: HLG, whose signal of {_HLG_WHITE:.0%} is taken for white; what is brighter is clipped."
        warnings.warn(found, stacklevel=2)
        linear = _of_primaries(_CODED_XY[codes[0]], 1.0)
        return Hlg(linear.matrix if isinstance(linear, Primaries) else np.eye(3, dtype=np.float32))
    stated: str = spec.get_string_attribute("oiio:ColorSpace")
    is_srgb = codes is None or (codes[0] in _CODES_UNSTATED and codes[1] in _CODES_AS_SRGB)
    if stated in ("", SRGB_SPACE) and not is_srgb:  # so OpenImageIO says of code points that it does not know
        return _taken_as_srgb(path, f"of primaries {codes[0]} and transfer {codes[1]} of ITU-T H.273")
    if stated.lower() not in _UNSTATED:
        if oiio.ColorConfig(_CONFIG).getColorSpaceIndex(stated) >= 0:
            return stated
        if is_float:
            raise ValueError(
                f"{path}: colours in {stated[:40]!a}, expected a known space, such as linear Rec.709 or ACEScg; "
                "export the image with linear colours."
            )
        if codes is not None:
            return _taken_as_srgb(path, f"in {stated[:40]!a}")
    return LINEAR_SPACE if is_float else SRGB_SPACE


def states_adobe_rgb(exif: Image.Exif) -> bool:
    """True if EXIF states Adobe RGB, as cameras do without a profile."""
    return exif.get_ifd(0xA005).get(1) == "R03" or exif.get_ifd(0x8769).get(0xA001) == 2


def space_of_info(info: Mapping[Any, Any], subject: Path | str, is_adobe: bool) -> ColourSpace | None:
    """The space that the `info` of a picture of PIL or its EXIF state, if any; `subject` begins warnings."""
    if profile := info.get("icc_profile"):
        return _of_profile(profile, subject)
    gamma, white_first = info.get("gamma"), info.get("chromaticity") or ()
    xy = (*white_first[2:], *white_first[:2])
    if "srgb" not in info and (gamma or states_primaries(xy)):
        return _of_primaries(xy if states_primaries(xy) else _REC709_XY, 1 / gamma if gamma else 0.0)
    return "g22_adobergb_scene" if is_adobe else None


def _of_profile(data: bytes, subject: Path | str) -> ColourSpace:
    """The space of an ICC profile: sRGB and linear ones by their names, so that floating-point values stay."""
    name, srgb = "damaged", cast(Any, ImageCms.createProfile("sRGB"))
    try:
        stated = ImageCms.ImageCmsProfile(io.BytesIO(data))
        name = ImageCms.getProfileDescription(stated).strip()[:60]
        mode = {"RGB": "RGB", "GRAY": "L"}[stated.profile.xcolor_space.strip()]
        relative = ImageCms.Intent.RELATIVE_COLORIMETRIC
        transform = ImageCms.buildTransform(stated, srgb, mode, "RGB", relative)
    except (ImageCms.PyCMSError, OSError, TypeError, KeyError):
        return _taken_as_srgb(subject, f"by the profile {name!a}")

    def convert(levels: Array) -> Array:
        picture = Image.fromarray(np.ascontiguousarray(levels if mode == "RGB" else levels[..., 0]))
        return np.asarray(transform.apply(picture))

    lattice = np.stack(np.meshgrid(*[np.arange(0, 256, 15, dtype=np.uint8)] * 3), -1).reshape(18, -1, 3)
    shown = convert(lattice).astype(np.int32)
    if np.abs(shown - lattice).max() <= _SAME:
        return SRGB_SPACE
    if stated.profile.is_matrix_shaper and mode == "RGB":
        own, to_xyz = (
            np.array([each.red_colorant[0], each.green_colorant[0], each.blue_colorant[0]], np.float32).T
            for each in (cast(Any, stated.profile), srgb)
        )
        linear = Primaries(np.linalg.solve(to_xyz, own))
        expected = linear_to_srgb(torch.from_numpy(linear_rgb(lattice, linear).clip(0, 1))).numpy() * 255
        if np.abs(shown - expected).max() <= _SAME:
            return linear
    return IccProfile(name, convert)


def _taken_as_srgb(subject: Path | str, stated: str) -> str:
    found = f"{subject}: colours {stated}, which cannot be converted, are taken as sRGB; export it as sRGB."
    warnings.warn(found, stacklevel=2)
    return SRGB_SPACE


def is_linear(space: ColourSpace) -> bool:
    """True if light adds up in a space."""
    if not isinstance(space, str):
        return isinstance(space, Primaries) and space.power == 1
    config = oiio.ColorConfig(_CONFIG)
    return config.isColorSpaceLinear(config.resolve(space))


def linear_rgb(values: Array, space: ColourSpace) -> Floats:
    """Stored colours, uint8, uint16 or float [rows, columns, 3], as linear Rec.709, float32, which may leave [0, 1]."""
    if isinstance(space, IccProfile):
        return _by_profile(values, space.convert)
    if isinstance(space, Hlg):
        light = _hlg_light(integers_to_unit_range(values)) / _hlg_light(np.array(_HLG_WHITE, np.float32))
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
    return floats if space == LINEAR_SPACE else _converted(floats, space)


def _hlg_light(signal: Floats) -> Floats:
    """Return the light of a scene in [0, 1] by an HLG signal: the inverse OETF of ITU-R BT.2100, table 5."""
    a = 0.17883277
    b, c = 1 - 4 * a, 0.5 - a * np.log(4 * a)
    bounded = signal.clip(0, 1)
    light: Floats = np.where(bounded <= 0.5, bounded**2 / 3, (np.exp((bounded - c) / a) + b) / 12)
    return light.astype(np.float32)


def _by_profile(values: Array, convert: Callable[[Array], Array]) -> Floats:
    """Linear colours, of more than 8 bits interpolated between those of 8 bits; floats in [0, 1]."""
    if values.dtype == np.uint8:
        return linear_rgb(convert(values), SRGB_SPACE)
    place = integers_to_unit_range(values).clip(0, 1) * 255
    low = np.nan_to_num(place).astype(np.uint8)
    total = np.zeros(values.shape, np.float32)
    for corner in np.array(list(itertools.product((0, 1), repeat=3)), np.uint16):
        weight = np.where(corner, place - low, 1 - place + low).prod(-1, keepdims=True)
        total += weight * linear_rgb(convert((low + corner).clip(max=255).astype(np.uint8)), SRGB_SPACE)
    return total


def integers_to_unit_range(values: Array) -> Floats:
    """Integers over their greatest value, floats as they are; float32."""
    return values.astype(np.float32) / (np.iinfo(values.dtype).max if values.dtype.kind == "u" else 1)


def _converted(values: Floats, space: str) -> Floats:
    image = oiio.ImageBuf(np.ascontiguousarray(values))
    done = oiio.ImageBufAlgo.colorconvert(image, space, LINEAR_SPACE, colorconfig=_CONFIG)
    linear = done.get_pixels(oiio.FLOAT)
    assert linear is not None, done.geterror()  # `space_of_file` names known ones only
    return linear / (_PQ_WHITE if space.startswith("pq_") else 1)


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
    return same_side and abs(_doubled_area(*corners)) > _LEAST_DOUBLED_AREA and bool(white[1] > 0)


def _doubled_area(first: Floats, second: Floats, third: Floats) -> float:
    """Return twice the signed area of a triangle of chromaticities, positive if they run counterclockwise."""
    (x, y), (u, v) = second - first, third - first
    return float(x * v - y * u)


def _of_primaries(xy: Sequence[float], power: float) -> ColourSpace:
    """Return the space of stated chromaticities (`states_primaries`).

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
