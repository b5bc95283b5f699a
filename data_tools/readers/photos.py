"""Photographs: find image files, and read any of them as a square sRGB picture.

OpenImageIO reads the files, pillow-heif those in HEIF. Integers are taken as sRGB and floating-point values (EXR,
Radiance HDR) as linear, unless the file states another space that OpenImageIO or its ICC profile's name tells, such as
Display P3 of many phones.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from data_tools.readers import heif, lens
from data_tools.readers.listing import files_below
from metapp.appearance.colour import linear_to_srgb, srgb_to_linear

if TYPE_CHECKING:
    import OpenImageIO as oiio

SUFFIXES = (
    ".bmp", ".dib", ".dpx", ".exr", ".gif", ".hdr", ".jfif", ".jif", ".jp2", ".jpe", ".jpeg", ".jpg", ".jxl", ".pbm",
    ".pfm", ".pgm", ".png", ".pnm", ".ppm", ".psd", ".rgbe", ".sgi", ".tga", ".tif", ".tiff", ".webp",
)  # fmt: skip
SIZE = 256  # px, of a task's picture unless another one is asked for

_MIN_SIDE = 32
_MAX_PIXELS = 2**28
_ALWAYS_BYTES, _MAX_RATIO = 2**26, 2000  # zlib packs 1032 to 1
_REASON = 120  # characters of a library's message
_MIN_DEVIATION = 1 / 255
_EXPECTED = "expected an image file, such as JPEG, PNG, TIFF or EXR"

# What may open as a TIFF, but as its thumbnail.
_RAW = (".arw", ".cr2", ".cr3", ".crw", ".dng", ".nef", ".nrw", ".orf", ".pef", ".raf", ".raw", ".rw2", ".srw")
_HEIF = (".avif", ".heic", ".heif", ".hif")  # few builds of OpenImageIO read these
_NAMED = (*SUFFIXES, *_RAW, *_HEIF)

_CONFIG = "ocio://default"  # a user's own, which the variable OCIO names, may know other spaces
_SRGB, LINEAR = "srgb_rec709_scene", "lin_rec709_scene"
_PROFILES = {"Display P3": "srgb_p3d65_scene", "Adobe RGB (1998)": "g22_adobergb_scene"}

_ROWS = 256  # decoded at a time: linear floats of a whole photograph take over a hundred megabytes

Array = NDArray[Any]
Floats = NDArray[np.floating]


class Pixels(NamedTuple):
    """A file's values.

    Attributes:
        values: [height, width, 3], or 4 with alpha last; uint8 or uint16, else float32.
        space: the name OpenColorIO has for the encoding of the first three channels.
        is_premultiplied: these are multiplied by alpha.
        focal_mm: focal length as of 35 mm film; 0 where the file does not say.
    """

    values: Array
    space: str
    is_premultiplied: bool
    focal_mm: float = 0.0


def find_photos(paths: Iterable[str | Path], expected: Collection[str] = ()) -> tuple[list[Path], list[str]]:
    """Find image files by their suffix, others by what OpenImageIO says of them; pixels are not looked at.

    Args:
        paths: files, and folders that are searched with all below them (hidden ones left out).
        expected: names of files that are no images but belong in such a folder.

    Returns:
        The files, each once, those of a folder sorted; and a line for each other file of a folder. A named file is
        returned as it is, if it exists: reading it says what is wrong with it.

    Raises:
        ValueError: a path that does not exist, a folder without any image that can be read.
    """
    files: dict[Path, Path] = {}
    skipped: list[str] = []
    for path in map(Path, paths):
        if not path.is_dir():
            check_exists(path)
            files.setdefault(path.resolve(), path)
            continue
        found = 0
        to_export = []
        for file in files_below(path):
            if file.suffix.lower() in SUFFIXES or _opens(file):
                files.setdefault(file.resolve(), file)
                found += 1
            elif file.suffix.lower() in _NAMED:
                to_export.append(_to_export(file))
            elif file.name not in expected:
                skipped.append(f"{file}: not an image that can be read, {_EXPECTED}.")
        if not found:
            nothing = f"{path}: no image in this folder, {_EXPECTED}; name the folder of the photographs."
            raise ValueError(to_export[0] if to_export else nothing)
        skipped += to_export
    return list(files.values()), skipped


def is_photo(path: str | Path) -> bool:
    """Whether a file is an image: by its suffix if that is a known one, else by whether OpenImageIO opens it.

    A camera's raw or a HEIF file is one too, though reading it may only say that it is to be exported.
    """
    path = Path(path)
    return path.is_file() and (path.suffix.lower() in _NAMED or _opens(path))


def holds_photos(path: str | Path) -> bool:
    """Whether a path is an image file, or a folder with one below it, known by its suffix."""
    path = Path(path)
    return any(file.suffix.lower() in _NAMED for file in files_below(path)) if path.is_dir() else is_photo(path)


def read_photo(
    path: str | Path, size: int = SIZE, *, fov_rad: float = 0.0, within_rad: float = 0.0, least: int = 0
) -> Tensor:
    """Read the central square of an image file.

    The picture is turned as its EXIF orientation says. Averages are taken over exact areas and in linear light, so
    that the mean radiance is kept; a smaller picture is interpolated. Values beyond [0, 1] are clamped before. Where
    the picture is transparent it gets the mean colour of the rest. A gray one gets three equal channels.

    Args:
        path: the file; of several pictures in it the first counts.
        fov_rad: the camera's field of view along the shorter side; 0: as the file's EXIF says, if it does.
        within_rad: of a camera with a wider field, only what is within this one counts; 0: all of it.
        size: side of the result in px.
        least: what smaller pictures than `size` are enlarged to, if at all; 0: to `size`.

    Returns:
        sRGB, uint8 [3, size, size], rows from the top.

    Raises:
        ValueError: no such file, no image, a damaged one; a name that is not UTF-8; a side below 32 px, more than
            2^28 px; channels other than gray or RGB; NaN; a picture of one colour.
    """
    path = Path(path)
    whole = read_pixels(path)
    pixels = central_square(whole, _share_within(whole, fov_rad, within_rad))
    linear = resample(pixels, min(size, max(least, len(pixels.values))) if least else size)
    if not np.isfinite(linear).all():
        raise ValueError(f"{path}: holds NaN, expected finite values; export the image again.")
    if linear.shape[-1] == 4:
        linear = _over_mean(linear, path)
    srgb = linear_to_srgb(torch.from_numpy(linear)).numpy()
    deviation = srgb.std(axis=(0, 1)).max()
    if deviation < _MIN_DEVIATION:
        colours = pixels.values[..., :3]
        if colours.dtype.kind == "f" and (colours > 1).mean() > 0.5:
            raise ValueError(
                f"{path}: values up to {colours.max():.4g}, most above 1, which is white, expected values in [0, 1]; "
                "scale them to it."
            )
        raise ValueError(
            f"{path}: one colour all over (standard deviation {deviation * 255:.2f} of 255), expected a picture with "
            "a visible structure; leave it out."
        )
    return torch.from_numpy((srgb * 255).round().astype(np.uint8)).permute(2, 0, 1).contiguous()


def _share_within(pixels: Pixels, fov_rad: float, within_rad: float) -> float:
    """The share of the shorter side that lies within a field of view; 1 where the camera's own is not known."""
    if not fov_rad and pixels.focal_mm:
        fov_rad = lens.field_of_view(pixels.focal_mm, *pixels.values.shape[:2])
    return lens.seen_share(fov_rad, within_rad) if fov_rad and within_rad else 1.0


def check_exists(path: Path) -> None:
    """Refuse a path that is no file.

    Raises:
        ValueError: it is a folder, or nothing.
    """
    if not path.is_file():
        found = "a folder" if path.is_dir() else "no such file"
        raise ValueError(f"{path}: {found}, {_EXPECTED}; check the path.")


@contextlib.contextmanager
def silent() -> Iterator[None]:
    """Keep what libraries such as libpng write to standard error by themselves off the user's screen."""
    try:
        kept = os.dup(2)
    except OSError:  # there is none
        yield
        return
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def _opens(path: Path) -> bool:
    if heif.is_heif(path):
        return heif.can_read()
    try:
        with silent():
            open_image(path).close()
    except ValueError:
        return False
    return True


def open_image(path: Path) -> oiio.ImageInput:
    """An open OpenImageIO.ImageInput that does not multiply colours by alpha."""
    import OpenImageIO as oiio  # its import costs more than a command that reads no image should pay

    if path.suffix.lower() in _RAW:
        raise ValueError(_to_export(path))
    wanted = oiio.ImageSpec()
    wanted.attribute("oiio:UnassociatedAlpha", 1)
    try:
        source = oiio.ImageInput.open(str(path), wanted)
    except (UnicodeError, TypeError):  # which one depends on OpenImageIO's version
        raise ValueError(f"{str(path)!a}: a name that is not UTF-8, expected one that is; rename it.") from None
    if source is None:
        reason = reason_of(error_of(oiio), path)  # also told where it is not shown, else it appears as Python ends
        if path.suffix.lower() in _HEIF:
            raise ValueError(_to_export(path))
        raise ValueError(f"{path}: not an image ({reason}), {_EXPECTED}; check the file or export it again.")
    return source


@contextlib.contextmanager
def opened(path: Path) -> Iterator[oiio.ImageInput]:
    """An image file as `open_image` gives it, closed at the end; libraries say nothing meanwhile.

    Raises:
        ValueError: no such file, no image, one whose text is not UTF-8.
    """
    check_exists(path)
    with silent(), contextlib.closing(open_image(path)) as source:
        try:
            yield source
        except UnicodeDecodeError:
            raise ValueError(f"{path}: holds text that is not UTF-8, {_EXPECTED}; export it again.") from None


def check_memory(spec: oiio.ImageSpec, path: Path) -> None:
    """Refuse a small file that would take gigabytes: its header is damaged, or made for that."""
    held = spec.image_bytes()
    if held > max(_ALWAYS_BYTES, _MAX_RATIO * path.stat().st_size):
        raise ValueError(
            f"{path}: {spec.width}x{spec.height} px of {spec.nchannels} channels in {path.stat().st_size:,} bytes, "
            "expected a whole image; copy or download it again."
        )


def error_of(source: oiio.ImageInput | ModuleType) -> str:
    """What OpenImageIO, or an open file of its, says went wrong; "" for nothing."""
    try:
        return str(source.geterror())
    except UnicodeDecodeError as error:  # it repeats bytes of the file
        return error.object.decode("ascii", "replace")


def _to_export(path: Path) -> str:
    """The line about a camera's or phone's own form of pictures."""
    kind = "raw values of a camera" if path.suffix.lower() in _RAW else "a picture in HEIF or AVIF"
    remedy = "" if heif.can_read() or not heif.is_heif(path) else f", or read it as it is: {heif.INSTALL}"
    return f"{path}: {kind}, {_EXPECTED}; export it as JPEG or PNG{remedy}."


def reason_of(message: str, path: Path) -> str:
    """The first sentence of OpenImageIO's message, without the path, which the line has already."""
    without = re.sub(rf'( for( file)?)? ?["(]?{re.escape(str(path))}[")]?( is\b)?', "", message)
    first = next(iter(without.splitlines()), "").partition(". ")[0]
    return "".join(c if c.isprintable() else "?" for c in first)[:_REASON].strip(" :.") or "unknown reason"


def read_pixels(path: Path) -> Pixels:
    """A whole file, upright, as it is encoded.

    Raises:
        ValueError: as `read_photo`, but for NaN and a picture of one colour.
    """
    check_exists(path)
    if heif.is_heif(path):
        return _read_heif(path)
    with opened(path) as source:
        spec = source.spec()
        _check_size(spec.width, spec.height, path)
        check_memory(spec, path)
        channels = _channels(spec, path)
        kind = str(spec.format)
        values = source.read_image(kind if kind in ("uint8", "uint16") else "float")
        problem = error_of(source)
        space, focal_mm = _space(spec), lens.focal_length(spec)
    if values is None or problem:
        raise ValueError(
            f"{path}: damaged or incomplete ({reason_of(problem, path)}), expected a whole image; copy or download it "
            "again."
        )
    upright = turn_upright(values, spec.get_int_attribute("Orientation", 1))
    is_premultiplied = not spec.get_int_attribute("oiio:UnassociatedAlpha", 0)
    return Pixels(upright[..., channels], space, is_premultiplied, focal_mm)


def _read_heif(path: Path) -> Pixels:
    if not heif.can_read():
        raise ValueError(_to_export(path))
    with silent():
        source = heif.open_heif(path)
        width, height = source.size
        _check_size(width, height, path)
        values, profile = heif.decode(source, path)
    focal_mm = lens.focal_length_of(source.info.get("exif"))
    return Pixels(values, _PROFILES.get(profile, _SRGB), False, focal_mm)


def _check_size(width: int, height: int, path: Path) -> None:
    found = f"{width}x{height} px"
    if width * height > _MAX_PIXELS:
        raise ValueError(f"{path}: {found}, expected {_MAX_PIXELS:,} px or fewer; scale it down.")
    if min(width, height) < _MIN_SIDE:
        raise ValueError(f"{path}: {found}, expected {_MIN_SIDE} px or more on the short side; take a larger image.")


def _channels(spec: oiio.ImageSpec, path: Path) -> list[int]:
    """Indices of red, green, blue (a gray channel three times) and, if there is one, alpha."""
    names = [name.upper() for name in spec.channelnames]
    if spec.get_string_attribute("tiff:ColorSpace") == "CIELAB":
        names = ["L*", "a*", "b*"]  # called R, G, B
    if {"R", "G", "B"} <= set(names):
        found = [names.index(name) for name in "RGB"]
    elif spec.nchannels == 1 or (spec.nchannels == 2 and "A" in names):
        found = [next(index for index, name in enumerate(names) if name != "A" or spec.nchannels == 1)] * 3
    else:
        shown = ", ".join(name if name.isprintable() else ascii(name) for name in names[:8])
        raise ValueError(f"{path}: channels {shown}, expected R, G, B or a gray one; export it as RGB.")
    return found + ([names.index("A")] if "A" in names and spec.nchannels > 1 else [])


def _space(spec: oiio.ImageSpec) -> str:
    """The encoding of a file's colours."""
    import OpenImageIO as oiio

    profile = spec.get_string_attribute("ICCProfile:profile_description")
    if profile in _PROFILES:
        return _PROFILES[profile]
    stated = spec.get_string_attribute("oiio:ColorSpace")
    if stated in (_SRGB, LINEAR) or (stated and oiio.ColorConfig(_CONFIG).getColorSpaceIndex(stated) >= 0):
        result: str = stated
        return result
    return LINEAR if str(spec.format) in ("half", "float", "double") else _SRGB


def turn_upright(values: Array, orientation: int) -> Array:
    """Turn [height, width, ...] as EXIF's orientation 1 to 8 says; anything else counts as 1."""
    if orientation in (5, 6, 7, 8):
        values = values.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        values = values[::-1]
    if orientation in (2, 3, 6, 7):
        values = values[:, ::-1]
    return values


def central_square(pixels: Pixels, share: float = 1.0) -> Pixels:
    """The middle of a picture, as large as its shorter side, or as such a share of it."""
    height, width = pixels.values.shape[:2]
    side = max(1, round(min(height, width) * share))
    top, left = (height - side) // 2, (width - side) // 2
    return pixels._replace(values=pixels.values[top : top + side, left : left + side])


def resample(pixels: Pixels, size: int) -> Floats:
    """A square as linear RGB [size, size, 3], or 4 with alpha last and colours multiplied by it, float64 in [0, 1].

    Means are taken over exact areas; a smaller picture is interpolated.
    """
    side = pixels.values.shape[0]
    columns = min(side, size)
    rows = [
        _area(_linear(pixels, slice(row, row + _ROWS)).swapaxes(0, 1), columns).swapaxes(0, 1)
        for row in range(0, side, _ROWS)
    ]
    result = _area(np.concatenate(rows), columns)
    if side < size:
        planes = torch.from_numpy(result).permute(2, 0, 1)[None]
        result = functional.interpolate(planes, (size, size), mode="bilinear")[0].permute(1, 2, 0).numpy()
    return result


def _area(values: Floats, count: int) -> Floats:
    """Means over `count` equal intervals of the first axis; an entry on an edge counts with its share."""
    length = values.shape[0]
    edges = np.linspace(0, length, count + 1)
    entry = np.minimum(edges.astype(np.int64), length - 1)
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0, dtype=np.float64)])
    at_edges = total[entry] + (edges - entry)[:, None, None] * values[entry]
    result: Floats = np.diff(at_edges, axis=0) * (count / length)
    return result


def _linear(pixels: Pixels, rows: slice) -> Floats:
    """Some rows in linear light, in [0, 1], float32; with alpha, colours are multiplied by it."""
    stored = pixels.values[rows]
    if stored.shape[-1] == 3:
        return _decode(stored, pixels.space)
    values = fraction(stored)
    colours, alpha = values[..., :3], values[..., 3:].clip(0, 1)
    if pixels.is_premultiplied:  # in the file's encoding, which does not commute with it
        colours = colours / np.maximum(alpha, 1e-6)
    return np.concatenate([_decode(colours, pixels.space) * alpha, alpha], axis=-1)


def _decode(values: Array, space: str) -> Floats:
    """Stored colours, uint8, uint16 or float [rows, columns, 3], as linear RGB in [0, 1], float32."""
    if values.dtype.kind == "u" and space == _SRGB:
        levels = torch.linspace(0, 1, np.iinfo(values.dtype).max + 1, dtype=torch.float64)
        return srgb_to_linear(levels).float().numpy()[values]
    floats = fraction(values)
    if space == _SRGB:
        floats = srgb_to_linear(torch.from_numpy(floats)).numpy()
    elif space != LINEAR:
        floats = _converted(floats, space)
    return floats.clip(0, 1).astype(np.float32)


def fraction(values: Array) -> Floats:
    """Integers over their greatest value, floats as they are; float32."""
    return values.astype(np.float32) / (np.iinfo(values.dtype).max if values.dtype.kind == "u" else 1)


def _converted(values: Floats, space: str) -> Floats:
    """Colours of another space, float32 [rows, columns, 3], as linear RGB, which may leave [0, 1]."""
    import OpenImageIO as oiio

    image = oiio.ImageBuf(np.ascontiguousarray(values))
    done = oiio.ImageBufAlgo.colorconvert(image, space, LINEAR, colorconfig=_CONFIG)
    linear = done.get_pixels(oiio.FLOAT)
    assert linear is not None, done.geterror()  # `_space` names known ones only
    return linear


def _over_mean(linear: Floats, path: Path) -> Floats:
    """Put premultiplied colours over their own mean: [.., 4] to [.., 3]."""
    colours, alpha = linear[..., :3], linear[..., 3:]
    seen = alpha.sum()
    if seen <= 0:
        raise ValueError(f"{path}: transparent all over, expected a visible picture; leave it out.")
    result: Floats = colours + (1 - alpha) * (colours.sum(axis=(0, 1)) / seen)
    return result
