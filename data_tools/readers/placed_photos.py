"""Several flash photographs of one flat material in a folder, with the positions of camera and flash.

The layout is that of Guo et al. 2020, "MaterialGAN": rectified images in the order of their names, beside them text
files. Such a folder is one task.
"""

from __future__ import annotations

import math
import warnings
from pathlib import Path

import torch
from torch import Tensor

from data_tools.readers.image_files import shape_of
from data_tools.readers.input_source import (
    DAMAGED_FACT,
    DEFAULT_PHOTO_PX,
    PHOTO_COUNT_FACT,
    REFERENCE_FACT,
    Source,
    Sources,
)
from data_tools.readers.square_photos import (
    CAMERA_TEXT,
    LIGHT_TEXT,
    SIZE_TEXT,
    folders_with_flashes,
    is_photo,
    read_photo,
)
from data_tools.readers.svbrdf_task import correct_exposure
from metapp.learning.task import Task
from metapp.storage.files import read_text
from metapp.storage.folders import FAILED_PICTURE_SUFFIX, list_folder

MAX_PATCH_SIDE_CM = 1e5  # the longest side of a patch; the shortest is 1 over that
# Photographs that are read, at most. Time and memory of a fit grow with them: 10 took 16 s, 20 took 51 s and 2.1 GB.
MAX_PHOTOS = 9
MAX_DISTANCE_SIDES = 1000.0  # distance of camera and flash at most, in sides of the patch


def recognises(path: Path) -> bool:
    """Tell whether a path is a folder with positions of cameras or flashes at any depth."""
    return path.is_dir() and bool(folders_with_flashes(path))


def find(path: Path) -> Sources:
    """Find the folders with positions of cameras or flashes at any depth; other files are skipped without a line."""
    return [_make_source(folder) for folder in folders_with_flashes(path)], []


def _make_source(folder: Path) -> Source:
    """Return a folder as a source, with its photographs."""
    try:
        photos = photos_in(folder)
    except (ValueError, OSError):  # reading it says what is wrong
        return Source(folder.resolve().name, folder, facts={DAMAGED_FACT: True, REFERENCE_FACT: False})
    facts = {PHOTO_COUNT_FACT: len(photos), REFERENCE_FACT: False}
    return Source(folder.resolve().name, folder, facts=facts, content=photos)


def photos_in(folder: Path) -> list[Path]:
    """Return the photographs right in a folder, in the order of their names."""
    paths = sorted(Path(entry.path) for entry in list_folder(str(folder)) if not entry.name.startswith("."))
    return [path for path in paths if not path.name.endswith(FAILED_PICTURE_SUFFIX) and is_photo(path)]


def read_task(
    folder: Path, size: int = DEFAULT_PHOTO_PX, stops: float = 0.0, layer: str = "", content: list[Path] | None = None
) -> Task:
    """Read a folder as a task of its name.

    Args:
        folder: the folder of photographs and text files.
        size: the side of the result, in px; above 256 only for photographs that have as many.
        stops: the number of stops by which all photographs are too bright.
        layer: the layer of EXR files; see :func:`data_tools.readers.image_files.read_pixels`.
        content: the photographs, as :func:`find` found them; None to look for them.

    Returns:
        `photo`, the first photograph, sRGB uint8 [3, S, S], `others`, all further ones, [N - 1, 3, S, S], and `places`,
        positions of camera and flash [N, 2, 3] (see :func:`read_places`). Of more than MAX_PHOTOS these are the ones
        that :func:`choose_spread` chooses, and the task has a note on it.

    Raises:
        ValueError: there are fewer than two photographs; one is not square, or of another size; the folder cannot be
            read (see :func:`read_photo` and :func:`read_places`).
    """
    paths = photos_in(folder) if content is None else content
    if len(paths) < 2:
        raise ValueError(
            f"{folder}: {'1 photo' if paths else 'no photos'} beside places of camera or flash, expected two or more; "
            "add some, or give one photo by its name."
        )
    places = read_places(folder, len(paths))
    expected = "square photos of one size, all of the same part of the material; rectify them"
    shapes = {path: shape_of(path) for path in paths}
    for path, (height, width) in shapes.items():
        if (height, width) != shapes[paths[0]] or width != height:
            raise ValueError(f"{path}: {width} x {height} px, expected {expected}.")
    chosen = choose_spread(places, MAX_PHOTOS)
    photo, *others = (
        correct_exposure(read_photo(paths[index], size, min(size, DEFAULT_PHOTO_PX), layer), stops) for index in chosen
    )
    if len({picture.numpy().tobytes() for picture in (photo, *others)}) < len(chosen):
        warnings.warn(
            f"{folder}: some photos are equal, expected one from each place: relief is made up; remove repeats.",
            stacklevel=2,
        )
    places = places[chosen]
    data = {"photo": photo, "others": torch.stack(others), "places": places}
    names = ", ".join(paths[index].name for index in chosen)
    note = f"{len(paths)} photos, more than a fit sees; taken: {MAX_PHOTOS} of the most different directions: {names}"
    return Task(folder.resolve().name, data, note=note if len(chosen) < len(paths) else "")


def choose_spread(places: Tensor, count: int) -> list[int]:
    """Choose photographs whose cameras and flashes lie in directions as different as possible.

    The first one is the one from straightest above. Each further one is the farthest from those that are chosen.

    Args:
        places: positions of camera and flash [N, 2, 3].
        count: the number of photographs to choose, at most.

    Returns:
        Their indices, sorted.

    >>> places = torch.tensor([[0.0, 0, 1], [0.1, 0, 1], [1, 0, 1], [-1, 0, 1]])[:, None].expand(-1, 2, -1)
    >>> choose_spread(places, 3)
    [0, 2, 3]
    """
    if len(places) <= count:
        return list(range(len(places)))
    directions = torch.nn.functional.normalize(places.double(), dim=-1).flatten(1)
    distances = torch.cdist(directions, directions)
    chosen = [int(directions[:, [2, 5]].sum(1).argmax())]
    while len(chosen) < count:
        nearest = distances[chosen].amin(0)
        nearest[chosen] = -1  # photographs from one place count once, whatever their number
        chosen.append(int(nearest.argmax()))
    return sorted(chosen)


def read_places(folder: Path, photos: int) -> Tensor:
    """Return the positions of camera and flash, [photos, 2, 3], that a folder states, in the order of its photos.

    They are in half sides of the patch: origin in its centre, x right, y up, z along its normal. CAMERA_TEXT and
    LIGHT_TEXT hold a line "x,y,z" in cm for each photo, SIZE_TEXT the patch's side in cm.

    Raises:
        ValueError: a file is missing, malformed or has another number of lines; a position is not above the patch.
    """
    side_cm = _read_rows(folder / SIZE_TEXT, 1, 1)[0][0]
    if not 1 / MAX_PATCH_SIDE_CM <= side_cm <= MAX_PATCH_SIDE_CM:
        expected = f"the patch's side in cm, {1 / MAX_PATCH_SIDE_CM:g} to {MAX_PATCH_SIDE_CM:g}"
        raise ValueError(f"{folder / SIZE_TEXT}: {side_cm:g}, expected {expected}; measure it.")
    places = [
        _read_places_above(folder / name, photos, MAX_DISTANCE_SIDES * side_cm) for name in (CAMERA_TEXT, LIGHT_TEXT)
    ]
    return torch.stack(places, 1) / (side_cm / 2)


def _read_places_above(path: Path, photos: int, farthest_cm: float) -> Tensor:
    """Read the positions [photos, 3], in cm, of a text file.

    Raises:
        ValueError: a position is not above the patch, or further from its centre than `farthest_cm` along an axis.
    """
    places = torch.tensor(_read_rows(path, photos, 3), dtype=torch.float64)
    for number, place in enumerate(places.tolist(), 1):
        if not max(map(abs, place)) <= farthest_cm:
            raise ValueError(
                f"{path}: place {number} is {max(map(abs, place)):g} cm away, expected {farthest_cm:g} at most, "
                f"{MAX_DISTANCE_SIDES:g} sides of the patch; give places in cm."
            )
    places = places.float()
    for number, z_cm in enumerate(places[:, 2].tolist(), 1):
        if z_cm <= 0:
            raise ValueError(f"{path}: place {number} has z {z_cm:g} cm, expected above 0; let z point at the camera.")
    return places


def _read_rows(path: Path, count: int, width: int) -> list[list[float]]:
    """Read `count` lines of `width` finite numbers each, separated by commas; blank lines do not count.

    Raises:
        ValueError: the file cannot be read, or has other lines.
    """
    try:
        lines = [line for line in read_text(path).splitlines() if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: cannot be read as text, expected lines in cm: {count}; write them.") from error
    if len(lines) != count:
        raise ValueError(f"{path}: {len(lines)} lines, expected {count}; give one for each photo, or one side.")
    return [_parse_numbers(path, line, width) for line in lines]


def _parse_numbers(path: Path, line: str, width: int) -> list[float]:
    """Return the `width` finite numbers of a line, or raise ValueError if it holds anything else."""
    try:
        numbers = [float(word) for word in line.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != width or not all(map(math.isfinite, numbers)):
        raise ValueError(
            f"{path}: line {line!r}, expected {width} finite number{'s' * (width != 1)}, separated by "
            "commas; correct the line."
        )
    return numbers
