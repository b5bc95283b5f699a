"""Image files: opened, checked and decoded, upright and as they are encoded.

OpenImageIO reads the files; pillow-heif reads HEIF (.heic), as phones write it, decoded to 8 bits, but not AVIF. What
pictures are used for is left to readers of formats.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import re
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
import OpenImageIO as oiio
from PIL import Image, ImageOps

from data_tools.readers import camera_raws
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
from metapp.storage.files import check_readable, open_regular

# All suffixes of pictures that are read, one list for files, maps and folders. Left out are those of OpenImageIO that
# are mostly something else: .z, .int, .sm and .vsm.
IMAGE_SUFFIXES = (
    ".bmp", ".bw", ".cin", ".dds", ".dib", ".dpx", ".env", ".exr", ".fits", ".gif", ".hdr", ".icb", ".ico", ".iff",
    ".inta", ".j2c", ".j2k", ".jfi", ".jfif", ".jif", ".jp2", ".jpc", ".jpe", ".jpeg", ".jpf", ".jpg", ".jph", ".jpx",
    ".jxl", ".mpo", ".mxr", ".pbm", ".pdd", ".pfm", ".pgm", ".pic", ".png", ".pnm", ".ppm", ".psb", ".psd", ".rgb",
    ".rgba", ".rgbe", ".rla", ".sgi", ".sxr", ".targa", ".tga", ".tif", ".tiff", ".tpic", ".tx", ".vda", ".vst",
    ".webp", ".xyze",
)  # fmt: skip
_HEIF_SUFFIXES = (".avif", ".heic", ".heif", ".hif")  # few builds of OpenImageIO read these
ALL_PICTURE_SUFFIXES = (*IMAGE_SUFFIXES, *camera_raws.RAW_SUFFIXES, *_HEIF_SUFFIXES)
EXPECTED_IMAGE = "expected an image file, such as JPEG, PNG, TIFF or EXR"

_BEAUTY_LAYERS = ("COMBINED", "BEAUTY", "RGBA")  # names that renderers give the layer of the picture itself
_DEPTH_CHANNELS = {"Z", "ZBACK", "DEPTH"}
_MAX_MISSING_SHARE = 0.01  # of a lat-long map's solid angle
_RADIANCE_HEADER_BYTES = 2**14  # bytes of a Radiance file that its header is looked for in
_MIN_SIDE_PX, _MAX_PIXELS = 32, 2**28  # of pictures that are read
_MAX_PICTURES = 1000  # pictures of one file that are looked at
# A decoded picture of fewer bytes is always read, a larger one only if its file has a byte for each 2000 of them, as
# zlib packs at most 1032 to 1.
_MAX_UNCHECKED_BYTES, _MAX_PACKING_RATIO = 2**26, 2000
_MAX_REASON_CHARACTERS = 120  # of a library's message in ours

INSTALL_HEIF = 'pip install "metapp[heic]"'
# Brands in the first bytes of files in HEIF (ISO/IEC 23008-12).
_HEIF_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1")
_EXIF_BLOCK = 0x8769
_RATIONAL_TAGS = (0xA20E, 0xA20F, 0x920A)  # FocalPlaneXResolution, FocalPlaneYResolution, FocalLength
# FocalLengthIn35mmFilm, FocalPlaneResolutionUnit, PixelXDimension, PixelYDimension
_WHOLE_TAGS = (0xA405, 0xA210, 0xA002, 0xA003)


class Pixels(NamedTuple):
    """The values of a picture, with their colour space.

    Attributes:
        values: [height, width, 3], or 4 with alpha last; uint8 or uint16, else float32.
        space: the colour space of the values.
        is_premultiplied: whether colours are multiplied by alpha.
        focal_mm: the focal length in mm of an equal field of view on 35 mm film; 0 if the file does not say.
        lens_note: how EXIF states the focal length, or why it is not known; see :class:`ExifLens`.
    """

    values: Array
    space: ColourSpace
    is_premultiplied: bool
    focal_mm: float = 0.0
    lens_note: str = ""

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


def check_exists(path: Path) -> None:
    """Raise ValueError for a folder and for a path that does not exist."""
    if not path.is_file():
        found = "a folder" if path.is_dir() else "no such file"
        raise ValueError(f"{path}: {found}, {EXPECTED_IMAGE}; check the path.")


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


def open_image(path: Path) -> oiio.ImageInput:
    """Open an image by OpenImageIO, which is told not to multiply colours by alpha.

    Raises:
        ValueError: the file is a camera raw or no image, or its name is not UTF-8.
    """
    check_readable(path)
    if path.suffix.lower() in camera_raws.RAW_SUFFIXES or camera_raws.is_raw(path):
        raise ValueError(_develop_advice(path))
    settings = oiio.ImageSpec()
    settings.attribute("oiio:UnassociatedAlpha", 1)
    try:
        source = oiio.ImageInput.open(str(path), settings)
    except (UnicodeError, TypeError):  # which of the two is raised depends on OpenImageIO's version
        raise ValueError(f"{str(path)!a}: a name that is not UTF-8, expected one that is; rename it.") from None
    if source is None:
        # read even where it is not shown: OpenImageIO prints an error that nobody read when Python ends
        reason = shorten_oiio_error(last_oiio_error(oiio), path)
        _read_radiance_header(path)
        if path.suffix.lower() in _HEIF_SUFFIXES:
            raise ValueError(export_advice(path))
        raise ValueError(f"{path}: not an image ({reason}), {EXPECTED_IMAGE}; check the file or export it again.")
    return source


@contextlib.contextmanager
def open_largest_picture(path: Path) -> Iterator[oiio.ImageInput]:
    """Open an image file at its largest picture; libraries say nothing meanwhile.

    Raises:
        ValueError: there is no such file, it is no image, or it holds text that is not UTF-8.
    """
    check_exists(path)
    with silence_libraries(), contextlib.closing(open_image(path)) as source:
        try:
            _seek_largest(source)
            yield source
        except UnicodeDecodeError:
            raise ValueError(f"{path}: holds text that is not UTF-8, {EXPECTED_IMAGE}; export it again.") from None


def _seek_largest(source: oiio.ImageInput) -> str:
    """Select the largest picture of a TIFF or icon file, the first one of several, wherever it is in the file.

    Returns:
        A note which picture that is, for the user; "" if it is the first and all others are smaller, as previews are.
    """
    if source.format_name() not in ("tiff", "ico"):
        return ""
    sizes: list[int] = []
    while len(sizes) < _MAX_PICTURES and source.seek_subimage(len(sizes), 0):
        spec = source.spec()
        sizes.append(spec.width * spec.height)
    last_oiio_error(source)  # drops the error of the picture after the last one
    largest = sizes.index(max(sizes)) if sizes else 0
    source.seek_subimage(largest, 0)
    spec = source.spec()
    if largest == 0 and sizes.count(max(sizes, default=0)) < 2:
        return ""
    return f"{len(sizes)} pictures, taken: number {largest + 1}, {spec.width}x{spec.height} px, the largest"


def shape_of(path: Path) -> tuple[int, int]:
    """Return height and width of an image in px.

    Raises:
        ValueError: there is no such file, or it is no image.
    """
    if is_heif(path):
        height, width, _ = read_pixels(path).values.shape
        return height, width
    with open_largest_picture(path) as source:
        return _display_window(source)[:2]


def export_advice(path: Path) -> str:
    """Return the line that tells the user how to export a camera raw or a HEIF or AVIF picture."""
    if path.suffix.lower() in camera_raws.RAW_SUFFIXES:
        return _develop_advice(path)
    remedy = "" if can_read_heif() or not is_heif(path) else f", or read it as it is: {INSTALL_HEIF}"
    return f"{path}: a picture in HEIF or AVIF, {EXPECTED_IMAGE}; export it as JPEG or PNG{remedy}."


def _develop_advice(path: Path) -> str:
    """Return the line that tells the user to develop a camera raw."""
    return f"{path}: raw values of a camera, {EXPECTED_IMAGE}; develop it and export it as JPEG or PNG."


def read_pixels(path: Path, layer: str = "", *, is_map: bool = False, lacks_blue: bool = False) -> Pixels:
    """Read the picture that a file shows, upright, as it is encoded.

    Args:
        path: the file.
        layer: the name of a layer of an EXR file, or the end of it; "" for the first one (see :func:`_find_layer`).
        is_map: whether the picture is a lat-long map, of whose solid angle 1 % may be missing; it is black there.
        lacks_blue: whether a file of red and green alone may be read, as normals are stored; blue is 0 then.

    Raises:
        ValueError: there is no such file, it is no image, or damaged; its name is not UTF-8; a side is below 32 px, or
            there are more than 2^28 px; pixels are deep, or missing; no channels or layers are those of a picture (see
            :func:`_find_layer`); floating-point values are in a space that is not known.
    """
    check_exists(path)
    if is_heif(path):
        return _read_heif(path)
    with open_largest_picture(path) as source:
        choice_note = _seek_largest(source)
        part, channels = _find_layer(source, layer, path, lacks_blue=lacks_blue)
        source.seek_subimage(part, 0)
        spec, first = source.spec(), min(channels)
        height, width, top, left = window = _display_window(source)
        check_size(width, height, path)
        check_memory(spec, path)
        _check_missing(spec, window, path, _MAX_MISSING_SHARE if is_map else 0.0)
        exposure, primaries = _read_radiance_header(path) if source.format_name() == "hdr" else (None, [])
        with warnings.catch_warnings(
            record=True
        ) as caught_warnings:  # shown below, outside the block that silences libraries
            space = space_of_file(spec, path, primaries, part)
        kind = str(spec.format) if str(spec.format) in ("uint8", "uint16") else "float"
        values = source.read_image(part, 0, first, max(channels) + 1, kind)
        problem = last_oiio_error(source)
        lens = _read_lens(source.spec(0, 0), (width, height))  # the EXIF of the file is in its first part
    for caught_warning in caught_warnings:
        warnings.warn(caught_warning.message, stacklevel=2)
    if choice_note:
        warnings.warn(f"{path}: {choice_note}.", stacklevel=2)
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
    return Pixels(upright, space, not spec.get_int_attribute("oiio:UnassociatedAlpha", 0), *lens)


def _read_lens(spec: oiio.ImageSpec, size: tuple[int, int]) -> ExifLens:
    """Return the lens that the EXIF of an open file states.

    Args:
        spec: the file's description by OpenImageIO.
        size: width and height in px, for a file whose EXIF states none.
    """
    across, down, focal_mm = (
        spec.get_float_attribute(f"Exif:{name}", 0.0)
        for name in ("FocalPlaneXResolution", "FocalPlaneYResolution", "FocalLength")
    )
    in_film_mm, unit, *stated_size = (
        spec.get_int_attribute(f"Exif:{name}", 0)
        for name in ("FocalLengthIn35mmFilm", "FocalPlaneResolutionUnit", "PixelXDimension", "PixelYDimension")
    )
    return lens_of_exif(in_film_mm, focal_mm, (across, down), unit, stated_size if min(stated_size) > 0 else size)


def _display_window(source: oiio.ImageInput) -> tuple[int, int, int, int]:
    """Return the display window of an open file.

    Returns:
        Height and width of the picture in px, and the row and column in it of the first pixel that the file holds.
    """
    spec = source.spec()
    if source.format_name() not in ("openexr", "tiff"):  # offsets in other formats are positions on a page
        return spec.height, spec.width, 0, 0
    return spec.full_height, spec.full_width, spec.y - spec.full_y, spec.x - spec.full_x


def _check_missing(spec: oiio.ImageSpec, window: tuple[int, int, int, int], path: Path, limit: float) -> None:
    """Raise ValueError for a file that lacks pixels of its display window.

    Args:
        spec: the file's description by OpenImageIO.
        window: its display window; see :func:`_display_window`.
        path: the file.
        limit: the share of the solid angle of a lat-long map that may be missing.
    """
    height, width, top, left = window
    weights = np.sin(np.pi * (np.arange(height) + 0.5) / height)
    rows = weights[max(0, top) : max(0, top + spec.height)].sum() / weights.sum()
    columns = max(0, min(width, left + spec.width) - max(0, left)) / width
    if rows * columns < 1 - max(limit, 1e-9):
        raise ValueError(
            f"{path}: a data window of {spec.width}x{spec.height} px at {spec.x},{spec.y}, expected all of the display "
            f"window, {width}x{height} px at {spec.full_x},{spec.full_y}; export it uncropped."
        )


def _read_radiance_header(path: Path) -> tuple[Floats, list[float]]:
    """Read the header of a Radiance picture.

    Returns:
        The factors [3] that the file's values were multiplied by, and its primaries, x, y of red, green, blue and
        white; [] if it states none.

    Raises:
        ValueError: colours are in XYZ, or factors are no positive numbers.
    """
    with open_regular(path) as stream:
        header = stream.read(_RADIANCE_HEADER_BYTES).partition(b"\n\n")[0].decode("latin-1")
    header_fields = re.findall(
        r"(?m)^(FORMAT|EXPOSURE|COLORCORR|PRIMARIES) *= *(.*)$", header if header[:2] == "#?" else ""
    )
    if ("FORMAT", "32-bit_rle_xyze") in header_fields:
        raise ValueError(f"{path}: colours in XYZ, expected RGB; convert it, such as by Radiance's ra_xyze -r.")
    try:
        factors = [
            np.resize(np.array(text.split(), np.float32), 3)
            for name, text in header_fields
            if name in ("EXPOSURE", "COLORCORR")
        ]
        exposure = np.prod([np.ones(3, np.float32), *factors], 0)
        if not (np.isfinite(exposure).all() and exposure.min() > 0):
            raise ValueError
    except ValueError:
        raise ValueError(f"{path}: {header_fields!a:.90}, expected positive numbers; export it again.") from None
    xy: list[float] = []
    with contextlib.suppress(ValueError):  # malformed primaries are ignored, as zeros are
        xy = [float(number) for number in dict(header_fields).get("PRIMARIES", "").split()]
    return exposure, xy


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
        across, down, focal_mm = (float(tags.get(tag, 0)) for tag in _RATIONAL_TAGS)
        in_film_mm, unit, *stated_size = (int(tags.get(tag, 0)) for tag in _WHOLE_TAGS)
        size = stated_size if min(stated_size) > 0 else values.shape[1::-1]
        lens = lens_of_exif(in_film_mm, focal_mm, (across, down), unit, size)
    return Pixels(values, space_of_info(info, subject, is_adobe) or SRGB_SPACE, False, *lens)


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


def _find_layer(source: oiio.ImageInput, layer: str, path: Path, *, lacks_blue: bool = False) -> tuple[int, list[int]]:
    """Find the part of a file that holds a picture, and its channels: red, green, blue (gray thrice) and any alpha.

    The RGB layer is taken whose channels have no prefix, else one of _BEAUTY_LAYERS, else the only one, in all parts of
    an EXR; without an RGB layer, the only gray one that is not depth.

    Args:
        source: an open file; its current part changes.
        layer: the layer to take, by its name or the end of its name; "": as above. A file without layers ignores it.
        path: the file, in errors.
        lacks_blue: whether red and green alone are a layer, too; green then takes the place of blue in the channels.

    Raises:
        ValueError: there is no such layer, none or several come first, or all are deep.
    """
    part_count = source.spec().get_int_attribute("oiio:subimages", 1) if source.format_name() == "openexr" else 0
    parts = range(part_count) if part_count else [max(0, source.current_subimage())]
    # order of preference, name, part, channels
    candidates: list[tuple[tuple[bool, bool, bool], str, int, list[int]]] = []
    is_deep, all_channels = False, list[str]()
    for part in parts:
        source.seek_subimage(part, 0)
        spec = source.spec()
        is_deep |= spec.deep
        # OpenImageIO calls the channels of CIELAB R, G, B
        names = ["L*", "a*", "b*"] if spec.get_string_attribute("tiff:ColorSpace") == "CIELAB" else spec.channelnames
        all_channels += names
        layers: dict[str, dict[str, int]] = {}
        for index, name in enumerate(() if spec.deep else names):
            prefix, _, channel = name.rpartition(".")
            layers.setdefault(prefix, {})[channel.upper()] = index
        for prefix, channel_indices in layers.items():
            name = prefix or (spec.get_string_attribute("oiio:subimagename") if part_count > 1 else "")
            colour_channels = sorted(channel_indices.keys() - {"A"})
            is_gray = len(colour_channels) == 1 and colour_channels[0] not in _DEPTH_CHANNELS
            if lacks_blue and channel_indices.keys() >= set("RG") and "B" not in channel_indices:
                channel_indices["B"] = channel_indices["G"]
            if is_gray or channel_indices.keys() >= set("RGB"):
                order = (is_gray, prefix != "", name.rpartition(".")[2].upper() not in _BEAUTY_LAYERS)
                letters = (*(colour_channels * 3 if is_gray else "RGB"), "A")
                channels = [channel_indices[letter] for letter in letters if letter in channel_indices]
                candidates.append((order, name, part, channels))
    layer_names = [name if name.isprintable() else ascii(name) for _, name, _, _ in candidates if name][:8]
    chosen = [candidate for candidate in candidates if candidate[0] == min(candidates)[0]]
    if layer and layer_names:
        layer_in_capitals = layer.upper()
        chosen = [candidate for candidate in candidates if candidate[1].upper() == layer_in_capitals] or [
            candidate for candidate in candidates if candidate[1].upper().endswith(f".{layer_in_capitals}")
        ]
    if len(chosen) == 1 and not (is_deep and chosen[0][0][0]):
        return chosen[0][2:]
    if is_deep:
        raise ValueError(f"{path}: a deep image, expected one colour a pixel; flatten it.")
    if layer_names:
        subject = f"no single layer {layer!a} among" if layer else "layers"
        found = f"{subject} {', '.join(layer_names)}"
        raise ValueError(f"{path}: {found}, expected one of them; choose it by --layer NAME, or export it alone.")
    shown = ", ".join(name if name.isprintable() else ascii(name) for name in all_channels[:8])
    raise ValueError(f"{path}: channels {shown}, expected R, G, B or a gray one; export it as RGB.")


def turn_upright(values: Array, orientation: int) -> Array:
    """Turn values [height, width, ...] upright by EXIF's orientation, 1 to 8; any other number counts as 1."""
    if orientation in (5, 6, 7, 8):
        values = values.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        values = values[::-1]
    if orientation in (2, 3, 6, 7):
        values = values[:, ::-1]
    return values


def is_heif(path: Path) -> bool:
    """Tell whether a file begins as HEIF pictures do, whatever its name."""
    try:
        with open_regular(path) as stream:
            start = stream.read(12)
    except (OSError, ValueError):
        return False
    return start[4:8] == b"ftyp" and start[8:12] in _HEIF_BRANDS


def can_read_heif() -> bool:
    """Tell whether pillow-heif is installed."""
    return importlib.util.find_spec("pillow_heif") is not None


@contextlib.contextmanager
def silence_libraries() -> Iterator[None]:
    """Keep messages that libraries such as libpng write to standard error off the user's screen."""
    try:
        standard_error = os.dup(2)
    except OSError:  # there is no standard error
        yield
        return
    null_device = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null_device, 2)
        yield
    finally:
        os.dup2(standard_error, 2)
        os.close(standard_error)
        os.close(null_device)


def check_memory(spec: oiio.ImageSpec, path: Path) -> None:
    """Raise ValueError for a small file that would take gigabytes, as its header is damaged, or made for that."""
    decoded_bytes = spec.image_bytes()
    if decoded_bytes > max(_MAX_UNCHECKED_BYTES, _MAX_PACKING_RATIO * path.stat().st_size):
        raise ValueError(
            f"{path}: {spec.width}x{spec.height} px of {spec.nchannels} channels in {path.stat().st_size:,} bytes, "
            "expected a whole image; copy or download it again."
        )


def last_oiio_error(source: oiio.ImageInput | ModuleType) -> str:
    """Return the last error message of OpenImageIO, or of one of its open files; "" for none."""
    try:
        return str(source.geterror())
    except UnicodeDecodeError as error:  # the message repeats bytes of the file
        return error.object.decode("ascii", "replace")


def shorten_oiio_error(message: str, path: Path) -> str:
    """Return the first sentence of a message of OpenImageIO, without the path, which the line names already."""
    without_path = re.sub(rf'( for( file)?)? ?["(]?{re.escape(str(path))}[")]?( is\b)?', "", message)
    first_sentence = next(iter(without_path.splitlines()), "").partition(". ")[0]
    return (
        "".join(character if character.isprintable() else "?" for character in first_sentence)[
            :_MAX_REASON_CHARACTERS
        ].strip(" :.")
        or "unknown reason"
    )
