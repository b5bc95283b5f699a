"""Pictures decoded to pixels, upright and as they are encoded, with their colour space: from files and from PIL.

OpenImageIO decodes files, see :mod:`data_tools.readers.opened_images`; pillow-heif decodes HEIF (.heic), as phones
write it, to 8 bits, but not AVIF. What pictures are used for is left to readers of formats.
"""

from __future__ import annotations

import contextlib
import math
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import OpenImageIO as oiio
from PIL import Image, ImageOps

from data_tools.readers.colours import (
    SRGB_SPACE,
    Array,
    ColourSpace,
    Floats,
    integers_to_unit_range,
    linear_rgb,
    space_of_file,
    space_of_info,
    states_adobe_rgb,
)
from data_tools.readers.lenses import ExifLens, lens_of_exif
from data_tools.readers.opened_images import (
    can_read_heif,
    check_exists,
    check_memory,
    display_window,
    export_advice,
    find_layer,
    is_heif,
    last_oiio_error,
    open_image,
    open_largest_picture,
    panorama_window,
    read_radiance_header,
    seek_largest_picture,
    shorten_oiio_error,
    silence_libraries,
    states_panorama,
)
from data_tools.readers.tiff_directories import describe_larger_picture

_MAX_MISSING_SHARE = 0.01  # of a lat-long map's solid angle
_MIN_SIDE_PX, _MAX_PIXELS = 32, 2**28  # of pictures that are read
_EXIF_BLOCK = 0x8769
_INTEROPERABILITY_BLOCK = 0xA005
# FocalPlaneXResolution, FocalPlaneYResolution, FocalLength, DigitalZoomRatio
_RATIONAL_TAGS = (0xA20E, 0xA20F, 0x920A, 0xA404)
_WHOLE_TAGS = (0xA405, 0xA210)  # FocalLengthIn35mmFilm, FocalPlaneResolutionUnit
# Sizes in px by EXIF, of a picture or of the photograph that it was made of: ImageWidth and ImageLength,
# PixelXDimension and PixelYDimension, RelatedImageWidth and RelatedImageLength
_SIZE_TAGS = {None: (0x100, 0x101), _EXIF_BLOCK: (0xA002, 0xA003), _INTEROPERABILITY_BLOCK: (0x1001, 0x1002)}


class Pixels(NamedTuple):
    """The values of a picture, with their colour space.

    Attributes:
        values: [height, width, 3], or 4 with alpha last; uint8 or uint16, else float32.
        space: the colour space of the values.
        is_premultiplied: whether colours are multiplied by alpha.
        lens: the lens as EXIF states it, perhaps of a larger photograph; see :meth:`ExifLens.of_picture`.
        is_panorama: whether XMP states that the picture is a lat-long map, or a part of one.
    """

    values: Array
    space: ColourSpace
    is_premultiplied: bool
    lens: ExifLens = ExifLens()
    is_panorama: bool = False

    def picture_lens(self) -> ExifLens:
        """Return the lens that holds for the picture, which may be a part of the photograph that EXIF describes."""
        return self.lens.of_picture(*self.values.shape[:2])

    def linear(self, rows: slice = slice(None), high: float = 1.0) -> Floats:
        """Return rows in linear light, in [0, high], float32; where there is alpha, colours are multiplied by it."""
        stored = self.values[rows]
        if stored.shape[-1] == 3:
            return linear_rgb(stored, self.space).clip(0, high)
        values = integers_to_unit_range(stored)
        colours, alpha = values[..., :3], values[..., 3:].clip(0, 1)
        if self.is_premultiplied:  # colours were multiplied as encoded, so they are divided before they are decoded
            colours = colours / np.maximum(alpha, 1e-6)
        return np.concatenate([linear_rgb(colours, self.space).clip(0, high) * alpha, alpha], axis=-1)


def is_readable_image(path: Path) -> bool:
    """Tell whether a file is an image that can be read, by its content."""
    if is_heif(path):
        return can_read_heif()
    try:
        with silence_libraries():
            open_image(path).close()
    except ValueError:
        return False
    return True


def shape_of(path: Path) -> tuple[int, int]:
    """Return height and width of an image in px.

    Raises:
        ValueError: there is no such file, or it is no image.
    """
    if is_heif(path):
        height, width, _ = read_pixels(path).values.shape
        return height, width
    with open_largest_picture(path) as source:
        return display_window(source)[:2]


def read_pixels(path: Path, layer: str = "", *, is_map: bool = False, lacks_blue: bool = False) -> Pixels:
    """Read the picture that a file shows, upright, as it is encoded.

    Args:
        path: the file.
        layer: the name of a layer of an EXR file, or the end of it; "" for the first one (see :func:`find_layer`).
        is_map: whether the picture is a lat-long map, of whose solid angle 1 % may be missing; it is black there. XMP
            (GPano) may state that the picture is a part of the map.
        lacks_blue: whether a file of red and green alone may be read, as normals are stored; blue is 0 then.

    Raises:
        ValueError: there is no such file, it is no image, or damaged; its name is not UTF-8; a side is below 32 px, or
            there are more than 2^28 px; pixels are deep, or missing; no channels or layers are those of a picture (see
            :func:`find_layer`); floating-point values are in a space that is not known.
    """
    check_exists(path)
    if is_heif(path):
        return _read_heif(path)
    with open_largest_picture(path) as source:
        choice_note = seek_largest_picture(source)
        part, channels = find_layer(source, layer, path, lacks_blue=lacks_blue)
        source.seek_subimage(part, 0)
        spec, first = source.spec(), min(channels)
        is_panorama = states_panorama(spec)
        window = panorama_window(spec) if is_map and is_panorama else display_window(source)
        height, width, top, left = window
        check_size(width, height, path)
        check_memory(spec, path)
        _check_missing(spec, window, path, _MAX_MISSING_SHARE if is_map else 0.0)
        exposure, primaries = read_radiance_header(path) if source.format_name() == "hdr" else (None, [])
        with warnings.catch_warnings(
            record=True
        ) as caught_warnings:  # shown below, outside the block that silences libraries
            space = space_of_file(spec, path, primaries, part)
        kind = str(spec.format) if str(spec.format) in ("uint8", "uint16") else "float"
        values = source.read_image(part, 0, first, max(channels) + 1, kind)
        problem = last_oiio_error(source)
        lens = _read_lens(source.spec(0, 0), path, (width, height))  # the EXIF of the file is in its first part
        larger_note = describe_larger_picture(path, source.format_name(), spec, lens.whole_px)
    for caught_warning in caught_warnings:
        warnings.warn(caught_warning.message, stacklevel=2)
    for note in filter(None, (choice_note, larger_note)):
        warnings.warn(f"{path}: {note}.", stacklevel=2)
    if values is None or problem:
        repack = "" if exposure is None else ", or write one of old run lengths again by Radiance's pfilt -1"
        raise ValueError(
            f"{path}: damaged or incomplete ({shorten_oiio_error(problem, path)}), expected a whole image; copy or "
            f"download it again{repack}."
        )
    values = values[..., [channel - first for channel in channels]]
    if channels[0] != channels[1] == channels[2]:  # a file of red and green alone, in which green stands for blue
        values[..., 2] = 0
    if window != (*values.shape[:2], 0, 0):
        display = np.zeros((height, width, len(channels)), values.dtype)
        inside = values[max(0, -top) : height - top, max(0, -left) : width - left]
        display[max(0, top) : top + len(values), max(0, left) : left + values.shape[1]] = inside
        values = display
    if exposure is not None:
        values = values / exposure
    upright = turn_upright(values, spec.get_int_attribute("Orientation", 1))
    return Pixels(upright, space, not spec.get_int_attribute("oiio:UnassociatedAlpha", 0), lens, is_panorama)


def lens_of(path: Path) -> ExifLens:
    """Return the lens that EXIF states for the picture of a file, which is not decoded.

    Raises:
        ValueError: there is no such file, or it is no image.
    """
    if is_heif(path):
        return read_pixels(path).picture_lens()
    with open_largest_picture(path) as source:
        height, width, _, _ = display_window(source)
        return _read_lens(source.spec(0, 0), path, (width, height)).of_picture(height, width)


def _read_lens(spec: oiio.ImageSpec, path: Path, size: tuple[int, int]) -> ExifLens:
    """Return the lens that the EXIF of an open file states.

    Args:
        spec: the file's description by OpenImageIO, which leaves out some sizes in EXIF.
        path: the file.
        size: width and height in px, for a file whose EXIF states none.
    """
    across, down, focal_mm, zoom = (
        spec.get_float_attribute(f"Exif:{name}", 0.0)
        for name in ("FocalPlaneXResolution", "FocalPlaneYResolution", "FocalLength", "DigitalZoomRatio")
    )
    in_film_mm, unit, *stated_size = (
        spec.get_int_attribute(f"Exif:{name}", 0)
        for name in ("FocalLengthIn35mmFilm", "FocalPlaneResolutionUnit", "PixelXDimension", "PixelYDimension")
    )
    whole_px = (stated_size[0], stated_size[1]) if min(stated_size) > 0 else (0, 0)
    with contextlib.suppress(Exception), warnings.catch_warnings(action="ignore"), Image.open(path) as image:
        whole_px = max(whole_px, _stated_size(image.getexif()), key=math.prod)
    lens = lens_of_exif(in_film_mm, focal_mm, (across, down), unit, whole_px if min(whole_px) > 0 else size, zoom)
    return lens._replace(whole_px=whole_px)


def _stated_size(exif: Image.Exif) -> tuple[int, int]:
    """Return the largest width and height in px that EXIF states, since programs that cut pictures update only some."""
    sizes = [(0, 0)]
    for block, (width_tag, height_tag) in _SIZE_TAGS.items():
        tags: Mapping[int, Any] = exif.get_ifd(block) if block else exif
        sizes.append((int(tags.get(width_tag, 0)), int(tags.get(height_tag, 0))))
    return max((size for size in sizes if min(size) >= 0), key=math.prod)


def _check_missing(spec: oiio.ImageSpec, window: tuple[int, int, int, int], path: Path, limit: float) -> None:
    """Raise ValueError for a file that lacks pixels of its display window.

    Args:
        spec: the file's description by OpenImageIO.
        window: its display window; see :func:`display_window` and :func:`panorama_window`.
        path: the file.
        limit: the share of the solid angle of a lat-long map that may be missing.
    """
    height, width, top, left = window
    weights = np.sin(np.pi * (np.arange(height) + 0.5) / height)
    rows = weights[max(0, top) : max(0, top + spec.height)].sum() / weights.sum()
    columns = max(0, min(width, left + spec.width) - max(0, left)) / width
    if rows * columns < 1 - max(limit, 1e-9):
        if states_panorama(spec):
            raise ValueError(
                f"{path}: a part of a panorama by its XMP (GPano), {spec.width}x{spec.height} px at {left},{top}, "
                f"expected the whole sphere, {width}x{height} px; fill what is missing, and export it uncropped."
            )
        raise ValueError(
            f"{path}: a data window of {spec.width}x{spec.height} px at {spec.x},{spec.y}, expected all of the display "
            f"window, {width}x{height} px at {spec.full_x},{spec.full_y}; export it uncropped."
        )


def _read_heif(path: Path) -> Pixels:
    """Read a HEIF picture by pillow-heif, as :func:`read_pixels` reads all others.

    Raises:
        ValueError: pillow-heif is not installed; the file is damaged or not in RGB.
    """
    if not can_read_heif():
        raise ValueError(export_advice(path))
    import pillow_heif

    try:
        with silence_libraries():
            source = pillow_heif.open_heif(path)
            width, height = source.size
            values = np.asarray(source) if width * height <= _MAX_PIXELS else np.empty(0)
    except Exception as error:  # libheif may raise anything
        reason = (str(error) or type(error).__name__).splitlines()[0][:80].replace(str(path), "").strip(" :.")
        raise ValueError(
            f"{path}: a HEIF picture that cannot be decoded ({reason}), expected a whole one; copy or download it "
            "again."
        ) from None
    check_size(width, height, path)
    if source.mode not in ("RGB", "RGBA"):
        raise ValueError(f"{path}: a HEIF picture of mode {source.mode}, expected RGB; export it as JPEG or PNG.")
    return _make_pixels(values, source.info, source.info.get("exif"), path)


def pixels_of_pil(image: Image.Image, name: str) -> Pixels:
    """Read a PIL picture, upright, with the colour space and focal length that it states.

    Raises:
        ValueError: PIL cannot decode the picture.
    """
    exif = b""
    with contextlib.suppress(Exception), warnings.catch_warnings(action="ignore"):  # damaged EXIF is ignored
        image = ImageOps.exif_transpose(image)
        exif = image.getexif().tobytes()
    try:
        values = np.asarray(image.convert("RGBA" if image.has_transparency_data else "RGB"))
    except (OSError, ValueError) as error:  # PIL does not decode before this
        raise ValueError(f"{name}: a picture that PIL cannot decode ({error}), expected a whole one.") from None
    return _make_pixels(values, image.info, exif, name)


def _make_pixels(values: Array, info: Mapping[Any, Any], exif: bytes | None, subject: Path | str) -> Pixels:
    """Return decoded values with the colour space and the lens that the `info` of PIL and EXIF state.

    Args:
        values: the values, uint8 [height, width, 3 or 4].
        info: the `info` of a PIL picture.
        exif: its EXIF block, which may be damaged.
        subject: the name of the picture in warnings.
    """
    parsed, lens, is_adobe = Image.Exif(), ExifLens(), False
    # Pillow's reader of TIFF may raise anything at a damaged block, which is ignored
    with contextlib.suppress(Exception), warnings.catch_warnings(action="ignore"):
        parsed.load(exif or b"")
        is_adobe = states_adobe_rgb(parsed)
        tags = parsed.get_ifd(_EXIF_BLOCK)
        across, down, focal_mm, zoom = (float(tags.get(tag, 0)) for tag in _RATIONAL_TAGS)
        in_film_mm, unit = (int(tags.get(tag, 0)) for tag in _WHOLE_TAGS)
        whole_px = _stated_size(parsed)
        size = whole_px if min(whole_px) > 0 else values.shape[1::-1]
        lens = lens_of_exif(in_film_mm, focal_mm, (across, down), unit, size, zoom)._replace(whole_px=whole_px)
    return Pixels(values, space_of_info(info, subject, is_adobe) or SRGB_SPACE, False, lens)


def check_size(width: int, height: int, path: Path | str, low: int = _MIN_SIDE_PX) -> None:
    """Raise ValueError for a picture whose shorter side is below `low` px, or that has more px than memory should hold.

    >>> check_size(100_000, 100_000, "photo.jpg")
    Traceback (most recent call last):
    ValueError: photo.jpg: 100000x100000 px, expected 268,435,456 px or fewer; scale it down.
    """
    if width * height > _MAX_PIXELS:
        raise ValueError(f"{path}: {width}x{height} px, expected {_MAX_PIXELS:,} px or fewer; scale it down.")
    if min(width, height) < low:
        found = f"{width}x{height} px, expected {low} px or more on the short side"
        raise ValueError(f"{path}: {found}; take a larger image.")


def turn_upright(values: Array, orientation: int) -> Array:
    """Turn values [height, width, ...] upright by EXIF's orientation, 1 to 8; any other number counts as 1."""
    if orientation in (5, 6, 7, 8):
        values = values.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        values = values[::-1]
    if orientation in (2, 3, 6, 7):
        values = values[:, ::-1]
    return values
