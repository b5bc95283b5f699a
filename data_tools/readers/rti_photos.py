"""Photographs by a camera that stands still under many lamps, in a folder with a text of the lamps' directions (RTI).

Such a folder is one task. See `light_directions` for the text.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import torch
from torch import Tensor
from torch.nn.functional import adaptive_avg_pool2d, normalize

from data_tools.readers.ball_places import mask_of_balls
from data_tools.readers.image_files import shape_of
from data_tools.readers.input_source import (
    DAMAGED_FACT,
    DEFAULT_PHOTO_PX,
    LAMP_COUNT_FACT,
    PHOTO_COUNT_FACT,
    REFERENCE_FACT,
    Source,
    Sources,
)
from data_tools.readers.light_axes import find_axes
from data_tools.readers.light_directions import LIGHT_DIRECTIONS_SUFFIX, find_light_file, read_lights
from data_tools.readers.square_photos import folders_with_lights, read_whole_photo
from data_tools.readers.svbrdf_task import correct_exposure, encode_srgb
from metapp.appearance.colour import srgb_to_linear
from metapp.apps.svbrdf_nonstationary.maps import decode_photo
from metapp.learning.task import Task

COMPARED_PX = 128  # longer side of the photographs by which axes are compared


def recognises(path: Path) -> bool:
    """Tell whether a path is a text of lights, or a folder with one at any depth."""
    return bool(folders_with_lights(path)) if path.is_dir() else path.suffix.lower() == LIGHT_DIRECTIONS_SUFFIX


def find(path: Path) -> Sources:
    """Find the folders with a text of lights at any depth; other files are skipped without a line."""
    return [_make_source(folder) for folder in (folders_with_lights(path) if path.is_dir() else [path.parent])], []


def _make_source(folder: Path) -> Source:
    """Return a folder as a source, with the number of its photographs."""
    try:
        count = len(read_lights(_require_light_file(folder)).photos)
    except (ValueError, OSError):  # reading it says what is wrong
        return Source(folder.resolve().name, folder, facts={DAMAGED_FACT: True, REFERENCE_FACT: False})
    return Source(
        folder.resolve().name, folder, facts={PHOTO_COUNT_FACT: count, LAMP_COUNT_FACT: count, REFERENCE_FACT: False}
    )


def read_task(folder: Path, size: int = DEFAULT_PHOTO_PX, stops: float = 0.0, layer: str = "") -> Task:
    """Read a folder as a task of its name.

    Args:
        folder: the folder of photographs and the text.
        size: the longer side of the photographs in px, to which larger ones are averaged.
        stops: the number of stops by which all photographs are too bright.
        layer: the layer of EXR files; see :func:`data_tools.readers.image_files.read_pixels`.

    Returns:
        `photo`, the mean photograph, sRGB uint8 [3, H, W], `lit`, the photographs, [N, 3, H, W], and `lamps`, unit
        vectors towards their lamps, [N, 3].

    Raises:
        ValueError: the text cannot be read, see :func:`read_lights`, or photographs differ in size.
    """
    text = _require_light_file(folder)
    lights = read_lights(text)
    for note in lights.notes:
        warnings.warn(note, stacklevel=2)
    shapes = {path: shape_of(path) for path in lights.photos}
    first_shape = shapes[lights.photos[0]]
    for path, (height, width) in shapes.items():
        if (height, width) != first_shape:
            raise ValueError(
                f"{path}: {width} x {height} px, expected {first_shape[1]} x {first_shape[0]} as in "
                f"{lights.photos[0].name}, by a camera that stands still; leave others out."
            )
    photos = _read_photos(lights.photos, size, stops, layer)
    _leave_out_balls(text, photos)
    _warn_of_repeats(folder, photos)
    # one at a time, since as floats all photographs would take four times their memory
    scale = min(1.0, COMPARED_PX / max(photos.shape[-2:]))
    height, width = (max(2, round(side * scale)) for side in photos.shape[-2:])
    small = torch.stack([adaptive_avg_pool2d(photo.float() / 255, (height, width)) for photo in photos])
    lamps = _correct_axes(text, srgb_to_linear(small).mean(1), normalize(lights.directions, dim=1))
    return Task(folder.resolve().name, {"photo": _mean_photo(photos), "lit": photos, "lamps": lamps})


def _require_light_file(folder: Path) -> Path:
    """Return the text of light directions in a folder, or raise ValueError."""
    text = find_light_file(folder)
    if text is None:
        raise ValueError(f"{folder}: no text of light directions, expected a .lp; `metapp data lights` writes one.")
    return text


def _read_photos(paths: list[Path], size: int, stops: float, layer: str) -> Tensor:
    """Read photographs into one tensor, uint8 [N, 3, H, W], which may have gigabytes."""
    photos: Tensor | None = None
    for number, path in enumerate(paths):
        photo = correct_exposure(read_whole_photo(path, size, layer), stops)
        if photos is None:
            photos = torch.empty(len(paths), *photo.shape, dtype=torch.uint8)
        photos[number] = photo
    assert photos is not None  # `read_lights` refuses a text without photographs
    return photos


def _mean_photo(photos: Tensor) -> Tensor:
    """Return the mean of linear values of photographs, sRGB uint8 [N, 3, H, W], as one of them."""
    total = torch.zeros(photos.shape[1:])
    for photo in photos:
        total += decode_photo(photo)
    return encode_srgb(total / len(photos))


def _warn_of_repeats(folder: Path, photos: Tensor) -> None:
    """Warn of photographs that are equal in each pixel."""
    if len({photo.numpy().tobytes() for photo in photos[:, :, ::7, ::7]}) < len(photos):
        warnings.warn(f"{folder}: some photos are equal, expected one under each lamp; remove repeats.", stacklevel=3)


def _correct_axes(path: Path, photos: Tensor, directions: Tensor) -> Tensor:
    """Return directions with the axes that photographs tell; other axes than those of the text are said.

    Args:
        path: the text of light directions.
        photos: linear gray photographs [N, H, W].
        directions: unit vectors towards the lamps as the text states them, [N, 3].
    """
    found = find_axes(photos, directions)
    if found.name:
        warnings.warn(
            f"{path}: slopes by its directions are no surface's (curl {found.stated_curl:.2f}, expected about 0), "
            f"taken: {found.name} (curl {found.curl:.2f}); correct the text, and negate x and y if dents are bumps.",
            stacklevel=3,
        )
    return directions @ found.axes.T


def _leave_out_balls(light_text: Path, photos: Tensor) -> None:
    """Make photographs [N, 3, H, W] black where balls are, whose places stand beside the text of lights."""
    height, width = photos.shape[-2:]
    is_ball = torch.from_numpy(mask_of_balls(light_text, height, width))
    if bool(is_ball.any()):
        photos[:, :, is_ball] = 0
        warnings.warn(
            f"{light_text.parent}: a ball covers {float(is_ball.float().mean()):.1%} of the photos: left out, black in "
            "pictures.",
            stacklevel=3,
        )
