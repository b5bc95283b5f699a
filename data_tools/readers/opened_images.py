"""Image files as OpenImageIO opens them: the largest picture of a file, its layers, and what its header states.

Messages say what is wrong with a file that cannot be opened, such as a camera raw or a HEIF picture, and what to do.
Nothing here decodes pixels; see :mod:`data_tools.readers.image_files`.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import OpenImageIO as oiio

from data_tools.readers.colours import Floats
from data_tools.readers.tiff_directories import read_tiff_directories
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
RAW_SUFFIXES = (  # of camera raws, in whose place image libraries would read the preview
    ".3fr", ".arw", ".cr2", ".cr3", ".crw", ".dcr", ".dng", ".erf", ".fff", ".iiq", ".kdc", ".mef", ".mos", ".mrw",
    ".nef", ".nrw", ".orf", ".pef", ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw", ".x3f",
)  # fmt: skip
_HEIF_SUFFIXES = (".avif", ".heic", ".heif", ".hif")  # few builds of OpenImageIO read these
ALL_PICTURE_SUFFIXES = (*IMAGE_SUFFIXES, *RAW_SUFFIXES, *_HEIF_SUFFIXES)
EXPECTED_IMAGE = "expected an image file, such as JPEG, PNG, TIFF or EXR"
INSTALL_HEIF = 'pip install "metapp[heic]"'

_BEAUTY_LAYERS = ("COMBINED", "BEAUTY", "RGBA")  # names that renderers give the layer of the picture itself
_DEPTH_CHANNELS = {"Z", "ZBACK", "DEPTH"}
_RADIANCE_HEADER_BYTES = 2**14  # bytes of a Radiance file that its header is looked for in
_MAX_PICTURES = 1000  # pictures of one file that are looked at
# A decoded picture of fewer bytes is always read, a larger one only if its file has a byte for each 2000 of them, as
# zlib packs at most 1032 to 1.
_MAX_UNCHECKED_BYTES, _MAX_PACKING_RATIO = 2**26, 2000
_MAX_REASON_CHARACTERS = 120  # of a library's message in ours
# Brands in the first bytes of files in HEIF (ISO/IEC 23008-12).
_HEIF_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1")


def check_exists(path: Path) -> None:
    """Raise ValueError for a folder and for a path that does not exist."""
    if not path.is_file():
        found = "a folder" if path.is_dir() else "no such file"
        raise ValueError(f"{path}: {found}, {EXPECTED_IMAGE}; check the path.")


def open_image(path: Path) -> oiio.ImageInput:
    """Open an image by OpenImageIO, which is told not to multiply colours by alpha.

    Raises:
        ValueError: the file is a camera raw or no image, or its name is not UTF-8.
    """
    check_readable(path)
    if path.suffix.lower() in RAW_SUFFIXES:
        raise ValueError(export_advice(path))
    settings = oiio.ImageSpec()
    settings.attribute("oiio:UnassociatedAlpha", 1)
    source = oiio.ImageInput.open(str(path), settings)
    if source is None:
        # read even where it is not shown: OpenImageIO prints an error that nobody read when Python ends
        reason = shorten_oiio_error(last_oiio_error(oiio), path)
        read_radiance_header(path)
        if path.suffix.lower() in _HEIF_SUFFIXES:
            raise ValueError(export_advice(path))
        raise ValueError(f"{path}: not an image ({reason}), {EXPECTED_IMAGE}; check the file or export it again.")
    if source.format_name() == "tiff" and any(directory.is_raw for directory in read_tiff_directories(path)):
        source.close()
        raise ValueError(export_advice(path, is_raw=True))
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
            seek_largest_picture(source)
            yield source
        except UnicodeDecodeError:
            raise ValueError(f"{path}: holds text that is not UTF-8, {EXPECTED_IMAGE}; export it again.") from None


def seek_largest_picture(source: oiio.ImageInput) -> str:
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


def display_window(source: oiio.ImageInput) -> tuple[int, int, int, int]:
    """Return the display window of an open file.

    Returns:
        Height and width of the picture in px, and the row and column in it of the first pixel that the file holds.
    """
    spec = source.spec()
    if source.format_name() not in ("openexr", "tiff"):  # offsets in other formats are positions on a page
        return spec.height, spec.width, 0, 0
    return spec.full_height, spec.full_width, spec.y - spec.full_y, spec.x - spec.full_x


def states_panorama(spec: oiio.ImageSpec) -> bool:
    """Tell whether XMP (GPano) states that a picture is a lat-long map, or a part of one."""
    return str(spec.getattribute("GPano:ProjectionType")).lower() == "equirectangular"


def panorama_window(spec: oiio.ImageSpec) -> tuple[int, int, int, int]:
    """Return the sphere around a part of a panorama, in px of the picture, as XMP (GPano) states it.

    A picture may have been scaled since. One that has not the part's ratio of sides counts as whole.

    Args:
        spec: the description by OpenImageIO of a picture that :func:`states_panorama` is true of.

    Returns:
        Height and width of the sphere, and the row and column in it of the picture's first pixel.
    """
    whole_width, whole_height, part_width, part_height, left, top = (
        spec.get_int_attribute(f"GPano:{name}", 0)
        for name in (
            "FullPanoWidthPixels", "FullPanoHeightPixels", "CroppedAreaImageWidthPixels",
            "CroppedAreaImageHeightPixels", "CroppedAreaLeftPixels", "CroppedAreaTopPixels",
        )
    )  # fmt: skip
    is_whole = (whole_width, whole_height) == (part_width, part_height)
    if is_whole or min(whole_width, whole_height, part_width, part_height) <= 0:
        return spec.height, spec.width, 0, 0
    across, down = spec.width / part_width, spec.height / part_height
    if abs(across / down - 1) > max(1 / part_width, 1 / part_height, 1 / spec.width, 1 / spec.height) * 2:
        return spec.height, spec.width, 0, 0
    height, width = max(spec.height, round(whole_height * down)), max(spec.width, round(whole_width * across))
    return height, width, round(top * down), round(left * across)


def find_layer(source: oiio.ImageInput, layer: str, path: Path, *, lacks_blue: bool = False) -> tuple[int, list[int]]:
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


def read_radiance_header(path: Path) -> tuple[Floats, list[float]]:
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


def check_memory(spec: oiio.ImageSpec, path: Path) -> None:
    """Raise ValueError for a small file that would take gigabytes, as its header is damaged, or made for that."""
    decoded_bytes = spec.image_bytes()
    if decoded_bytes > max(_MAX_UNCHECKED_BYTES, _MAX_PACKING_RATIO * path.stat().st_size):
        raise ValueError(
            f"{path}: {spec.width}x{spec.height} px of {spec.nchannels} channels in {path.stat().st_size:,} bytes, "
            "expected a whole image; copy or download it again."
        )


def export_advice(path: Path, *, is_raw: bool = False) -> str:
    """Return the line that tells the user how to export a camera raw or a HEIF or AVIF picture.

    Args:
        path: the file.
        is_raw: whether it is a camera raw, whatever its suffix.
    """
    if is_raw or path.suffix.lower() in RAW_SUFFIXES:
        return f"{path}: raw values of a camera, {EXPECTED_IMAGE}; develop it and export it as JPEG or PNG."
    remedy = "" if can_read_heif() or not is_heif(path) else f", or read it as it is: {INSTALL_HEIF}"
    return f"{path}: a picture in HEIF or AVIF, {EXPECTED_IMAGE}; export it as JPEG or PNG{remedy}."


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
