"""Several flash photographs of one flat material in a folder, rectified, with the places of camera and flash.

The layout is that of Guo et al. 2020, "MaterialGAN": images in the order of their names, beside them text files. Such a
folder is one task.
"""

from __future__ import annotations

import math
from pathlib import Path

import torch
from torch import Tensor

from data_tools.readers.image_files import shape_of
from data_tools.readers.input_source import PHOTO_COUNT_FACT, Source, Sources
from data_tools.readers.square_photos import SIZE as PX
from data_tools.readers.square_photos import SIZE_TEXT, folders_with_places, is_photo, read_photo
from data_tools.readers.svbrdf_task import correct_exposure
from metapp.learning.task import Task
from metapp.storage.files import read_text
from metapp.storage.folders import CAMERA_TEXT, LIGHT_TEXT, PathKind, list_folder, path_kind

MAX_PATCH_SIDE_CM = 1e5  # a side of a patch
MAX_DISTANCE_SIDES = 1000.0  # sides that camera and flash are away


def recognises(path: Path) -> bool:
    """Test whether a path is a folder with places of cameras or flashes, or has one below it."""
    return path.is_dir() and bool(folders_with_places(path))


def find(path: Path) -> Sources:
    """Find the folder and those below it that say so; no lines, as nothing else is looked at."""
    return [_source_of(folder) for folder in folders_with_places(path)], []


def _source_of(folder: Path) -> Source:
    photos = photos_in(folder)
    return Source(
        folder.resolve().name, folder, protocol="photo", facts={PHOTO_COUNT_FACT: len(photos)}, content=photos
    )


def photos_in(folder: Path) -> list[Path]:
    """Return the photographs right in a folder in the order of their names."""
    paths = sorted(Path(entry.path) for entry in list_folder(str(folder)) if not entry.name.startswith("."))
    return [path for path in paths if path_kind(path) is PathKind.FILE and is_photo(path)]


def read_task(
    folder: Path, size: int = PX, stops: float = 0.0, layer: str = "", content: list[Path] | None = None
) -> Task:
    """Turn a folder into a task of its name: `photo`, the first one, `others` and `places`.

    Args:
        folder: of photographs and text files.
        size: side in px; above 256 only of photographs as fine as that.
        stops: by how many stops all of them are too bright.
        layer: as of `read_photo`.
        content: its photographs, as `find` found them.

    Raises:
        ValueError: fewer than two photographs; one that is not square, or of another size; as `read_photo` and
            `read_places`.
    """
    paths = photos_in(folder) if content is None else content
    if len(paths) < 2:
        raise ValueError(
            f"{folder}: {'1 photo' if paths else 'no photos'} beside places of camera or flash, expected two or more; "
            "add some, or give one photo by its name."
        )
    places = read_places(folder, len(paths))
    shapes = {path: shape_of(path) for path in paths}
    for path, (height, width) in shapes.items():
        if width != height or (height, width) != shapes[paths[0]]:
            raise ValueError(
                f"{path}: {width} x {height} px, expected square photos of one size, all of the same part of the "
                "material; rectify them."
            )
    photo, *others = (correct_exposure(read_photo(path, size, min(size, PX), layer), stops) for path in paths)
    return Task(folder.resolve().name, {"photo": photo, "others": torch.stack(others), "places": places})


def read_places(folder: Path, photos: int) -> Tensor:
    """Places of camera and flash [photos, 2, 3] that a folder gives, in the order of the photos' names.

    In half sides of the patch: origin in its centre, x right, y up, z along its normal. CAMERA_TEXT and LIGHT_TEXT hold
    a line "x,y,z" in cm for each photo, SIZE_TEXT the patch's side in cm.

    Raises:
        ValueError: a file is missing, malformed or of another count; a place is not above the patch.
    """
    side = _rows(folder / SIZE_TEXT, 1, 1)[0][0]
    if not 1 / MAX_PATCH_SIDE_CM <= side <= MAX_PATCH_SIDE_CM:
        expected = f"the patch's side in cm, {1 / MAX_PATCH_SIDE_CM:g} to {MAX_PATCH_SIDE_CM:g}"
        raise ValueError(f"{folder / SIZE_TEXT}: {side:g}, expected {expected}; measure it.")
    places = [_above(folder / name, photos, MAX_DISTANCE_SIDES * side) for name in (CAMERA_TEXT, LIGHT_TEXT)]
    return torch.stack(places, 1) / (side / 2)


def _above(path: Path, photos: int, farthest: float) -> Tensor:
    """Places [photos, 3] in cm, all above the patch and no further from it than that."""
    places = torch.tensor(_rows(path, photos, 3), dtype=torch.float64)
    for number, place in enumerate(places.tolist(), 1):
        if not max(map(abs, place)) <= farthest:
            raise ValueError(
                f"{path}: place {number} is {max(map(abs, place)):g} cm away, expected {farthest:g} at most, "
                f"{MAX_DISTANCE_SIDES:g} sides of the patch; write cm."
            )
    places = places.float()
    for number, height in enumerate(places[:, 2].tolist(), 1):
        if height <= 0:
            raise ValueError(
                f"{path}: place {number} has z {height:g} cm, expected above 0; let z point at the camera."
            )
    return places


def _rows(path: Path, count: int, width: int) -> list[list[float]]:
    """So many lines of so many finite numbers, parted by commas; blank lines do not count."""
    try:
        lines = [line for line in read_text(path).splitlines() if line.strip()]
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"{path}: cannot be read as text, expected lines in cm: {count}; write it.") from error
    if len(lines) != count:
        raise ValueError(f"{path}: {len(lines)} lines, expected {count}; give one for each photo, or one side.")
    return [_numbers(path, line, width) for line in lines]


def _numbers(path: Path, line: str, width: int) -> list[float]:
    try:
        numbers = [float(word) for word in line.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != width or not all(map(math.isfinite, numbers)):
        raise ValueError(
            f"{path}: line {line!r}, expected {width} finite number{'s' * (width != 1)}, parted by commas; mend it."
        )
    return numbers
