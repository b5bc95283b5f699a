"""Photographs: find image files, and read any of them as a square sRGB picture, such as a texture's.

Readers of flash photographs take the part that the camera of fits sees; EXIF says how wide the field of view is.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from data_tools.readers.arrays import pixels_of
from data_tools.readers.ball_places import BALL_PLACES_SUFFIX
from data_tools.readers.colours import SRGB_SPACE, Array, Floats, integers_to_unit_range
from data_tools.readers.image_files import Pixels, is_readable_image, read_pixels
from data_tools.readers.input_source import DEFAULT_PHOTO_PX, Sources, sources_of_files
from data_tools.readers.lenses import FILM_DIAGONAL_MM
from data_tools.readers.light_directions import LIGHT_DIRECTIONS_SUFFIX
from data_tools.readers.listing import FoundFiles, files_below, find_files
from data_tools.readers.opened_images import (
    ALL_PICTURE_SUFFIXES,
    EXPECTED_IMAGE,
    IMAGE_SUFFIXES,
    check_exists,
    export_advice,
)
from data_tools.readers.picture_borders import crop_borders
from metapp.appearance.colour import linear_to_srgb
from metapp.appearance.flash import CAMERA_FOV_RAD
from metapp.appearance.surface import DESCRIPTION_FILE
from metapp.learning.task import Task
from metapp.storage.folders import list_folder

UNITS = {"image": "sRGB, uint8 0..255 [3, height, width], rows from the top"}

_LEAST_ALPHA = 0.02  # below it a px is transparent, and its colour is not known
_MAX_PARTIAL_SHARE = 0.05  # of px that are transparent in part, as those at the contour of a cut-out are
_MIN_DEVIATION = 1 / 255  # standard deviation of sRGB values below which a picture has one colour
_ROWS_AT_ONCE = 256  # rows decoded at a time: linear floats of a whole photograph take over 100 MB

# Text files beside rectified photographs of one flat material: places of camera and flash, one of which suffices, and
# the material's side in cm
CAMERA_TEXT, LIGHT_TEXT, SIZE_TEXT = "camera_pos.txt", "light_pos.txt", "image_size.txt"
# Texts that are no fault in folders of images; no fit reads the power of the light.
TEXTS_BESIDE_PHOTOS = ("metadata.json", DESCRIPTION_FILE, CAMERA_TEXT, LIGHT_TEXT, SIZE_TEXT, "light_power.txt")


def find(path: Path) -> Sources:
    """Find image files, each of which is a source; see :func:`find_images`."""
    return sources_of_files(find_images(path))


def find_images(path: Path) -> FoundFiles:
    """Find image files; see :func:`find_files`.

    A named file must exist; other faults of it are found when it is read.
    """
    nothing = f"no image in this folder, {EXPECTED_IMAGE}; name the folder of the photographs."
    return find_files(path, check_exists, photo_fault, nothing, ALL_PICTURE_SUFFIXES)


def photo_fault(file: Path) -> str | None:
    """Return the line why a file in a folder is no image; "" for an image, None for a file that needs no line.

    Files count as images by their suffix, or if they can be opened; TEXTS_BESIDE_PHOTOS and texts of lights and balls
    need no line.
    """
    suffix = file.suffix.lower()
    # only these are opened, since opening 50,000 files of any suffix takes a minute
    if suffix in IMAGE_SUFFIXES or (suffix in ("", *ALL_PICTURE_SUFFIXES) and is_readable_image(file)):
        return ""
    if suffix in ALL_PICTURE_SUFFIXES:
        return export_advice(file)
    is_text = file.name in TEXTS_BESIDE_PHOTOS or suffix in (LIGHT_DIRECTIONS_SUFFIX, BALL_PLACES_SUFFIX)
    return None if is_text else f"{file}: not an image that can be read, {EXPECTED_IMAGE}."


def is_photo(path: str | Path) -> bool:
    """Tell whether a file is an image: by its suffix, of a camera raw or a HEIF file, too, else by its content."""
    path = Path(path)
    return path.is_file() and (path.suffix.lower() in ALL_PICTURE_SUFFIXES or is_readable_image(path))


def recognises(path: str | Path) -> bool:
    """Tell whether a path is an image file, or a folder with one at any depth, by its suffix."""
    path = Path(path)
    return bool(files_below(path, ALL_PICTURE_SUFFIXES)) if path.is_dir() else is_photo(path)


def folders_with_places(folder: Path) -> list[Path]:
    """Return the folders that state positions of camera or flash, or directions of lights; see the next functions."""
    return sorted([*folders_with_flashes(folder), *folders_with_lights(folder)])


def folders_with_flashes(folder: Path) -> list[Path]:
    """Return the folders, from this one down, that state positions of camera or flash, sorted, without hidden ones.

    A text that is none, such as a folder or a pipe of its name, counts, too: reading it says what is wrong. Folders
    with directions of lights do not count.
    """
    folders = _folders_with(folder, lambda name: name in (CAMERA_TEXT, LIGHT_TEXT))
    with_lights = set(folders_with_lights(folder))
    return [folder for folder in folders if folder not in with_lights]


def folders_with_lights(folder: Path) -> list[Path]:
    """Return the folders, from this one down, with a text of light directions (RTI), sorted, without hidden ones."""
    return _folders_with(
        folder, lambda name: name.lower().endswith(LIGHT_DIRECTIONS_SUFFIX) and not name.startswith(".")
    )


def _folders_with(folder: Path, is_wanted: Callable[[str], bool]) -> list[Path]:
    """Return the folders, from this one down, that have an entry of a wanted name, sorted, without hidden ones."""
    folders = {file.parent for file in files_below(folder)}
    return sorted(folder for folder in folders if any(is_wanted(entry.name) for entry in list_folder(str(folder))))


def read_task(path: Path, size: int = DEFAULT_PHOTO_PX, least: int = 0, layer: str = "") -> Task:
    """Read an image file as a texture task named by the file's stem.

    Args:
        path: the file.
        size: the side of the result, in px.
        least: the least side of the result, in px, to which smaller pictures are enlarged; 0: pictures are enlarged to
            `size`.
        layer: the layer of an EXR file; see :func:`read_pixels`.

    Raises:
        ValueError: the file cannot be read; see :func:`read_pixels` and :func:`to_square_photo`.
    """
    whole = crop_borders(read_pixels(path, layer), str(path))
    return task_of_square("image", central_square(whole), whole, path, size, least)


def task_of_square(key: str, square: Pixels, whole: Pixels, path: Path, size: int, least: int) -> Task:
    """Make the task of a square part of a file, named by the file's stem.

    The task has a note that says how the picture was cut and scaled.

    Args:
        key: the name of the photograph in the task.
        square: the part to take.
        whole: the whole picture.
        path: the file.
        size: the side of the result, in px.
        least: the least side of the result, in px, to which smaller pictures are enlarged; 0: pictures are enlarged to
            `size`.

    Raises:
        ValueError: the square holds no usable picture; see :func:`to_square_photo`.
    """
    photo = to_square_photo(square, str(path), size, least)
    (height, width), square_side, side = whole.values.shape[:2], len(square.values), photo.shape[-1]
    crop_note = (
        f": the central {square_side:,} x {square_side:,} px" if (height, width) != (square_side, square_side) else ""
    )
    scale_note = f", scaled to {side:,} x {side:,}" if square_side != side else ""
    return Task(
        path.stem,
        {key: photo},
        note=f"{width:,} x {height:,} px{crop_note}{scale_note}" if crop_note or scale_note else "",
    )


def task_of_object(source: object, name: str, size: int = DEFAULT_PHOTO_PX, least: int = 0, **_: object) -> Task:
    """Make the texture task of a picture in memory.

    Args:
        source: a picture that :func:`pixels_of` reads.
        name: the name of the task.
        size: the side of the result, in px.
        least: the least side of the result, in px, to which smaller pictures are enlarged; 0: pictures are enlarged to
            `size`.

    Raises:
        ValueError: see :func:`pixels_of` and :func:`to_square_photo`.
    """
    return Task(name, {"image": to_square_photo(crop_borders(pixels_of(name, source), name), name, size, least)})


def read_photo(path: str | Path, size: int = DEFAULT_PHOTO_PX, least: int = 0, layer: str = "") -> Tensor:
    """Read the central square of an image file, sRGB, uint8 [3, S, S].

    Args:
        path: the file.
        size: the side S of the result, in px.
        least: the least side of the result, in px, to which smaller pictures are enlarged; 0: pictures are enlarged to
            `size`.
        layer: the layer of an EXR file; see :func:`read_pixels`.

    Raises:
        ValueError: the file cannot be read; see :func:`read_pixels` and :func:`to_square_photo`.
    """
    return to_square_photo(read_pixels(Path(path), layer), str(path), size, least)


def read_whole_photo(path: str | Path, longest: int, layer: str = "") -> Tensor:
    """Read an image file whole, sRGB, uint8 [3, H, W].

    Args:
        path: the file.
        longest: the longer side of the result at most, in px, to which larger pictures are averaged.
        layer: the layer of an EXR file; see :func:`read_pixels`.

    Raises:
        ValueError: the file cannot be read; see :func:`read_pixels` and :func:`to_square_photo`.
    """
    pixels = read_pixels(Path(path), layer)
    height, width = pixels.values.shape[:2]
    scale = min(1.0, longest / max(height, width))
    return _encode_photo(pixels, str(path), max(1, round(height * scale)), max(1, round(width * scale)))


def to_square_photo(whole: Pixels, name: str, size: int = DEFAULT_PHOTO_PX, least: int = 0) -> Tensor:
    """Return the central square of a picture in sRGB.

    Means are taken over exact areas in linear light, of values clamped to [0, 1]; a smaller picture is interpolated.
    Transparent px get the mean colour of the rest, those transparent in part their own. A gray picture gets three equal
    channels.

    Args:
        whole: the picture.
        name: the name of the picture in errors.
        size: the side of the result, in px.
        least: the least side of the result, in px, to which smaller pictures are enlarged; 0: pictures are enlarged to
            `size`.

    Returns:
        sRGB, uint8 [3, size, size], rows from the top.

    Raises:
        ValueError: the picture holds NaN, is transparent all over, or has one colour.
    """
    pixels = central_square(whole)
    side = reading_side_px(len(pixels.values), size, least)
    return _encode_photo(pixels, name, side, side)


def _encode_photo(pixels: Pixels, name: str, height: int, width: int) -> Tensor:
    """Return a picture in sRGB at another size, uint8 [3, height, width]; see :func:`to_square_photo`."""
    is_plain = pixels.values.dtype == np.uint8 and pixels.values.shape[-1] == 3 and pixels.space == SRGB_SPACE
    is_of_size = pixels.values.shape[:2] == (height, width)
    if is_plain and is_of_size and _deviation(pixels.values) >= _MIN_DEVIATION * 255:
        # these values, which the rest would compute again, in seconds of 12 megapixels
        return torch.from_numpy(pixels.values.copy()).permute(2, 0, 1).contiguous()
    linear = resample(pixels, height, width)
    if not np.isfinite(linear).all():
        raise ValueError(f"{name}: holds NaN, expected finite values; export the image again.")
    if linear.shape[-1] == 4:
        alpha = integers_to_unit_range(pixels.values[..., 3])
        partial_share = ((alpha > _LEAST_ALPHA) & (alpha < 1 - _LEAST_ALPHA)).mean()
        if partial_share > _MAX_PARTIAL_SHARE:
            warnings.warn(
                f"{name}: {partial_share:.0%} of the px are half-transparent (alpha {_LEAST_ALPHA:g} to "
                f"{1 - _LEAST_ALPHA:g}), expected opaque ones; their colours are taken, and alpha is left out: export "
                "the picture without alpha, or on its background.",
                stacklevel=2,
            )
        linear = _fill_transparent(linear, name)
    srgb = linear_to_srgb(torch.from_numpy(linear)).numpy()
    deviation = _deviation(srgb)
    if deviation < _MIN_DEVIATION:
        colours = pixels.values[..., :3]
        if colours.dtype.kind == "f" and (colours > 1).mean() > 0.5:
            raise ValueError(
                f"{name}: values up to {colours.max():.4g}, most above 1, which is white, expected values in [0, 1]; "
                "divide them so that white is 1."
            )
        raise ValueError(
            f"{name}: one colour all over (standard deviation {deviation * 255:.2f} of 255), expected a picture with "
            "a visible structure; leave it out."
        )
    return torch.from_numpy((srgb * 255).round().astype(np.uint8)).permute(2, 0, 1).contiguous()


def _deviation(values: Array) -> float:
    """Return the largest standard deviation of a channel of a picture [H, W, C], in the unit of its values."""
    return float(values.std(axis=(0, 1)).max())


def reading_side_px(native: int, size: int, least: int) -> int:
    """Return the side, in px, at which a picture is read: its own side, but from `least` to `size`.

    Args:
        native: the side of the picture, in px.
        size: the largest side, in px.
        least: the least side, in px; 0: every picture is read at `size`.
    """
    return min(size, max(least, native)) if least else size


def field_of_view_rad(focal_mm: float, height: int, width: int) -> float:
    """Return the field of view, in rad, along the shorter side of an uncropped picture.

    Args:
        focal_mm: the focal length in mm of an equal field of view on 35 mm film.
        height: the height of the picture in px.
        width: the width of the picture in px.
    """
    shorter = FILM_DIAGONAL_MM * min(height, width) / math.hypot(height, width)
    return 2 * math.atan(shorter / 2 / focal_mm)


def flash_view(whole: Pixels, fov_rad: float = 0.0, name: str = "photo") -> Pixels:
    """Return the square middle of a photograph under a flash that the camera of fits would see.

    Of a camera with a narrower field of view, or an unknown one, it is the whole central square. A warning is given
    where EXIF states a focal length otherwise than on 35 mm film, or one that may not hold for the picture.

    Args:
        whole: the photograph.
        fov_rad: the camera's field of view along the shorter side, in rad; 0: as EXIF says, if it does.
        name: the name of the photograph in the warning.
    """
    lens = whole.picture_lens()
    if not fov_rad and lens.note:
        narrow, wide = (math.degrees(field_rad) for field_rad in _possible_fields_rad(whole))
        taken = math.degrees(_known_field_rad(whole, 0.0) or CAMERA_FOV_RAD)
        assumption = ""
        if lens.focal_range > 1:
            assumption = f", {narrow:.0f} to {wide:.0f} degrees along the shorter side, taken for {taken:.0f}"
        elif lens.is_part or not lens.focal_mm:
            assumption = f", taken for {taken:.0f} degrees along the shorter side"
        warnings.warn(f"{name}: {lens.note}{assumption}; --fov sets another field of view.", stacklevel=2)
    fov_rad = _known_field_rad(whole, fov_rad)
    return central_square(whole, min(1.0, math.tan(CAMERA_FOV_RAD / 2) / math.tan(fov_rad / 2)) if fov_rad else 1.0)


def narrow_view_height(whole: Pixels, fov_rad: float = 0.0) -> float:
    """Return the camera's height in half sides of what `flash_view` shows; 0 unless its view is known to be narrower.

    Args:
        whole: the photograph.
        fov_rad: the camera's field of view along the shorter side, in rad; 0: as EXIF says, if it does.
    """
    fov_rad = _known_field_rad(whole, fov_rad)
    return 1 / math.tan(fov_rad / 2) if 0 < fov_rad < CAMERA_FOV_RAD else 0.0


def _known_field_rad(whole: Pixels, fov_rad: float) -> float:
    """Return the field of view along the shorter side, in rad: as it is given, else as EXIF says; 0 if unknown.

    Where EXIF leaves it open within a range, it is the one that is nearest to that of fits.
    """
    if fov_rad:
        return fov_rad
    narrow, wide = _possible_fields_rad(whole)
    return min(max(CAMERA_FOV_RAD, narrow), wide)


def _possible_fields_rad(whole: Pixels) -> tuple[float, float]:
    """Return the narrowest and the widest field of view along the shorter side, in rad, by EXIF; zeros if unknown."""
    lens, (height, width) = whole.picture_lens(), whole.values.shape[:2]
    if not lens.focal_mm:
        return 0.0, 0.0
    return field_of_view_rad(lens.focal_mm * lens.focal_range, height, width), field_of_view_rad(
        lens.focal_mm, height, width
    )


def central_square(pixels: Pixels, share: float = 1.0) -> Pixels:
    """Return the square middle of a picture, whose side is this share of the picture's shorter side."""
    height, width = pixels.values.shape[:2]
    side = max(1, round(min(height, width) * share))
    top, left = (height - side) // 2, (width - side) // 2
    return pixels._replace(values=pixels.values[top : top + side, left : left + side])


def resample(pixels: Pixels, height: int, width: int) -> Floats:
    """Resample a picture in linear RGB.

    Means are taken over exact areas; an axis along which the picture is smaller is interpolated.

    Args:
        pixels: the picture.
        height: the height of the result, in px.
        width: the width of the result, in px.

    Returns:
        Linear RGB [height, width, 3], or 4 with alpha last and colours multiplied by it, float64 in [0, 1].
    """
    own_height, own_width = pixels.values.shape[:2]
    columns = min(own_width, width)
    rows = [
        _average_areas(pixels.linear(slice(row, row + _ROWS_AT_ONCE)).swapaxes(0, 1).copy(), columns).swapaxes(0, 1)
        for row in range(0, own_height, _ROWS_AT_ONCE)
    ]
    result = _average_areas(np.concatenate(rows), min(own_height, height))
    if own_height < height or own_width < width:
        planes = torch.from_numpy(result).permute(2, 0, 1)[None]
        result = functional.interpolate(planes, (height, width), mode="bilinear")[0].permute(1, 2, 0).numpy()
    return result


def _average_areas(values: Floats, count: int) -> Floats:
    """Average `count` equal intervals of the first axis, in float64; an entry on an edge counts with its share."""
    length = values.shape[0]
    edges = np.linspace(0, length, count + 1)
    first = edges[:-1].astype(np.int64)
    total: Floats = np.zeros((count, *values.shape[1:]))
    for step in range(int((np.ceil(edges[1:]) - first).max())):
        entry = np.minimum(first + step, length - 1)
        share = (np.minimum(edges[1:], first + step + 1) - np.maximum(edges[:-1], first + step)).clip(0)
        for row in range(count):  # row by row, so that a row of a large picture stays in the cache
            if share[row]:
                total[row] += values[entry[row]] * (share[row] * (count / length))
    return total


def _fill_transparent(linear: Floats, name: str) -> Floats:
    """Return the colours of a picture with premultiplied colours [H, W, 4], and their mean where it shows none.

    A px that is transparent in part has a colour, too. Some programs keep gloss or height in alpha.

    Raises:
        ValueError: the picture is transparent all over.
    """
    colours, alpha = linear[..., :3], linear[..., 3:]
    visible = alpha.sum()
    if visible <= 0:
        raise ValueError(f"{name}: transparent all over, expected a visible picture; leave it out.")
    mean = colours.sum(axis=(0, 1)) / visible
    result: Floats = np.where(alpha > _LEAST_ALPHA, colours / np.maximum(alpha, _LEAST_ALPHA), mean)
    return result
